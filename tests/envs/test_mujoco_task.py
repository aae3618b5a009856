import pytest

from deep_curiosity_envs.mujoco_task import count_physics_steps


@pytest.mark.parametrize(("control", "physics", "expected"), [(0.05, 0.01, 5), (0.3, 0.1, 3)])
def test_whole_multiples_are_counted(control, physics, expected):
    assert count_physics_steps(control, physics) == expected


@pytest.mark.parametrize(("control", "physics"), [(0.05, 0.02), (0.01, 0.05)])
def test_a_fraction_of_a_physics_step_is_rejected(control, physics):
    with pytest.raises(ValueError, match=f"whole multiple .* got {control} s and {physics} s"):
        count_physics_steps(control, physics)
