import numpy as np
import pytest

from deep_curiosity_envs import NoisyRoom, PointMaze
from deep_curiosity_envs.mujoco_task import check_flag, count_physics_steps


@pytest.mark.parametrize(("control", "physics", "expected"), [(0.05, 0.01, 5), (0.3, 0.1, 3)])
def test_whole_multiples_are_counted(control, physics, expected):
    assert count_physics_steps(control, physics) == expected


@pytest.mark.parametrize(("control", "physics"), [(0.05, 0.02), (0.01, 0.05)])
def test_a_fraction_of_a_physics_step_is_rejected(control, physics):
    with pytest.raises(ValueError, match=f"whole multiple .* got {control} s and {physics} s"):
        count_physics_steps(control, physics)


@pytest.mark.parametrize("value", ["no", "False", "", None, 2, 0.5, np.zeros(2)], ids=repr)
@pytest.mark.parametrize(("task", "name"), [(NoisyRoom, "switch"), (PointMaze, "goal_terminates")])
def test_what_is_neither_true_nor_false_is_refused_by_name(task, name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be True or False, got "):
        task(**{name: value})


@pytest.mark.parametrize("value", [True, False, 1, 0.0, np.True_, np.int64(0)], ids=repr)
def test_a_flag_has_one_form(value):
    assert check_flag("switch", value) is bool(value)
