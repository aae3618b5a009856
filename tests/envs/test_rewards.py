import math

import numpy as np
import pytest

from deep_curiosity_envs.rewards import SuccessStreak, tolerance, wrap_angle


@pytest.mark.parametrize(("value", "expected"), [(-1.1, 0), (-1, 1), (0, 1), (1, 1), (1.1, 0)])
def test_tolerance_without_margin_is_a_sharp_window(value, expected):
    assert tolerance(value, bounds=(-1.0, 1.0)) == expected


def test_tolerance_leaves_the_stated_value_at_the_margin():
    assert tolerance(3.0, bounds=(0.0, 1.0), margin=2.0) == pytest.approx(0.1)
    assert tolerance(-2.0, bounds=(0.0, 1.0), margin=2.0, value_at_margin=0.5) == 0.5


def test_tolerance_falls_like_a_gaussian():
    near = tolerance(2.0, bounds=(0.0, 1.0), margin=2.0)
    far = tolerance(3.0, bounds=(0.0, 1.0), margin=2.0)
    assert math.log(far) == pytest.approx(4 * math.log(near))


@pytest.mark.parametrize(
    ("kwargs", "name"),
    [
        ({"bounds": (1.0, 0.0)}, "bounds"),
        ({"bounds": (0.0, math.nan)}, "bounds"),
        ({"bounds": (0.0, 1.0), "margin": -1.0}, "margin"),
        ({"bounds": (0.0, 1.0), "margin": math.inf}, "margin"),
        ({"bounds": (0.0, 1.0), "margin": 1.0, "value_at_margin": 1.0}, "value_at_margin"),
    ],
)
def test_tolerance_rejects_what_has_no_meaning(kwargs, name):
    with pytest.raises(ValueError, match=f"`{name}` must"):
        tolerance(0.0, **kwargs)


def test_tolerance_takes_every_shape():
    value = np.array([[-2.0, 0.0], [0.5, 3.0]])
    assert tolerance(value, bounds=(-1.0, 1.0)).tolist() == [[0, 1], [1, 0]]
    assert tolerance(value, bounds=(-1.0, 1.0), margin=1.0)[0] == pytest.approx([0.1, 1.0])


def test_wrapped_angles_are_remainders_of_the_circle():
    angle = np.linspace(-20.0, 20.0, 81)
    expected = [math.remainder(value, math.tau) for value in angle]
    assert wrap_angle(angle) == pytest.approx(expected, abs=1e-14)


def test_streak_needs_the_steps_in_a_row():
    streak = SuccessStreak(3)
    for condition in (True, True, False, True, True):
        streak.update(condition)
    assert not streak.achieved
    streak.update(True)
    assert streak.achieved


def test_success_stays_achieved_until_reset():
    streak = SuccessStreak(1)
    streak.update(True)
    streak.update(False)
    assert streak.achieved
    streak.reset()
    assert not streak.achieved


def test_streaks_of_many_envs_are_independent():
    streak = SuccessStreak(2, num_envs=3)
    for condition in ([True, True, False], [True, False, False], [False, False, True]):
        streak.update(np.array(condition))
    assert streak.achieved.tolist() == [True, False, False]
    streak.reset(np.array([True, True, False]))
    streak.update(np.array([True, True, True]))
    assert streak.achieved.tolist() == [False, False, True]


def test_streak_rejects_zero_steps():
    with pytest.raises(ValueError, match="`num_steps` must be at least 1, got 0"):
        SuccessStreak(0)
