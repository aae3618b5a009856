import numpy as np
import pytest

from deep_curiosity.tabular.schedules import decreasing, fixed


def test_fixed_holds_a_number_or_a_number_for_each_state():
    assert fixed(0.3)(0) == fixed(0.3)(10_000) == 0.3
    np.testing.assert_array_equal(fixed(np.array([0.0, 1.0]))(5), [0, 1])


def test_decreasing_falls_by_its_factor_down_to_its_least():
    schedule = decreasing(2.0, 0.5, 0.3)
    assert [schedule(step) for step in range(5)] == [2, 1, 0.5, 0.3, 0.3]


def test_decreasing_approaches_zero_when_nothing_holds_it():
    assert decreasing(1.0, 0.9)(200) < 1e-9


def test_bad_parameters_are_rejected():
    with pytest.raises(ValueError, match="`first` must be positive"):
        decreasing(0.0, 0.5)
    with pytest.raises(ValueError, match="`factor` must lie in"):
        decreasing(1.0, 1.5)


def test_fixed_stays_when_the_array_it_was_made_of_changes():
    hunger = np.array([0.0, 1.0])
    schedule = fixed(hunger)
    hunger[:] = 7
    np.testing.assert_array_equal(schedule(0), [0, 1])
