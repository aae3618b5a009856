import math

import numpy as np
import pytest
from gymnasium.spaces import Box

from deep_curiosity_envs import NoisyRoom, PointMaze
from deep_curiosity_envs.checks import (
    check_action,
    check_action_cost,
    check_count,
    check_flag,
    finite_action,
)

TWO = Box(-1.0, 1.0, (2,))


@pytest.mark.parametrize("kind", ["?", "int8", "uint64", "float16", "float32", "longdouble"])
def test_any_real_numbers_are_an_action(kind):
    action = finite_action(np.array([1, 0], kind), TWO)
    assert action.dtype == np.float64
    assert action.tolist() == [1.0, 0.0]


def test_an_action_is_clipped_only_where_that_is_asked_for():
    assert finite_action([-3, 0.5], TWO).tolist() == [-3.0, 0.5]
    assert check_action([-3, 0.5], TWO).tolist() == [-1.0, 0.5]


@pytest.mark.parametrize(
    ("action", "rule"),
    [
        (["0.1", "0.2"], r"`action` must hold real numbers, got \['0.1', '0.2'\]\."),
        ([0.1, None], r"`action` must hold real numbers, got \[0.1, None\]\."),
        ([0.1, 1j], r"`action` must hold real numbers, got \[0.1, 1j\]\."),
        ([[0.1], [0.1, 0.2]], r"`action` must have shape \(2,\), got \[\[0.1\], \[0.1, 0.2\]\]\."),
        (0.1, r"`action` must have shape \(2,\), got shape \(\)\."),
        ([[0.1, 0.2]], r"`action` must have shape \(2,\), got shape \(1, 2\)\."),
        ([0.1, math.nan], r"`action` must be finite, got \[0.1, nan\]\."),
    ],
    ids=str,
)
@pytest.mark.parametrize("check", [finite_action, check_action])
def test_what_is_no_action_is_refused_with_the_rule(check, action, rule):
    with pytest.raises(ValueError, match=rule):
        check(action, TWO)


@pytest.mark.parametrize("value", [0, 2, 0.5, np.float32(0.5), np.int64(1)], ids=repr)
def test_a_cost_is_kept_as_a_float(value):
    assert type(check_action_cost(value)) is float
    assert check_action_cost(value) == value


@pytest.mark.parametrize(
    "value",
    ["0.1", None, [0.1], np.array([0.1]), True, 1j, -0.1, math.nan, math.inf, 10**400],
    ids=lambda value: repr(value)[:12],
)
def test_what_is_no_cost_is_refused_by_name(value):
    with pytest.raises(
        ValueError, match="`action_cost` must be a finite number and not negative, got "
    ) as error:
        check_action_cost(value)
    assert str(error.value).endswith(f"got {value!r}.")


@pytest.mark.parametrize("value", [1, 3, np.int64(2)], ids=repr)
def test_a_count_is_kept_as_an_int(value):
    assert type(check_count("num_envs", value)) is int
    assert check_count("num_envs", value) == value


@pytest.mark.parametrize("value", ["2", None, 2.5, 2.0, True, 0, -1, [2]], ids=repr)
def test_what_is_no_count_is_refused_by_name(value):
    with pytest.raises(
        ValueError, match="`num_envs` must be a whole number of at least 1, got "
    ) as error:
        check_count("num_envs", value)
    assert str(error.value).endswith(f"got {value!r}.")


@pytest.mark.parametrize("value", ["no", "False", "", None, 2, 0.5, np.zeros(2)], ids=repr)
@pytest.mark.parametrize(("task", "name"), [(NoisyRoom, "switch"), (PointMaze, "goal_terminates")])
def test_what_is_neither_true_nor_false_is_refused_by_name(task, name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be True or False, got "):
        task(**{name: value})


@pytest.mark.parametrize("value", [True, False, 1, 0.0, np.True_, np.int64(0)], ids=repr)
def test_a_flag_has_one_form(value):
    assert check_flag("switch", value) is bool(value)
