"""Checks of what a caller gives to an environment: actions and arguments."""

import math
import numbers
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from numpy.typing import NDArray

Array64 = NDArray[np.float64]


def finite_action(action: Any, space: Space) -> Array64:
    """The action in double precision, within the bounds of its space or beyond.

    Raises:
        ValueError: If it holds no real numbers, has another shape than the space, or is not
            finite.
    """
    try:
        given = np.asarray(action)
    except ValueError as error:  # its rows differ in length
        raise ValueError(f"`action` must have shape {space.shape}, got {action!r}.") from error
    if not np.can_cast(given.dtype, np.float64, "same_kind"):  # as text and complex numbers
        raise ValueError(f"`action` must hold real numbers, got {action!r}.")
    if given.shape != space.shape:
        raise ValueError(f"`action` must have shape {space.shape}, got shape {given.shape}.")
    control = given.astype(np.float64, copy=False)
    if not np.isfinite(control).all():
        raise ValueError(f"`action` must be finite, got {action}.")
    return control


def check_action(action: Any, space: Space) -> Array64:
    """The action clipped to [-1, 1], in the precision of the simulator.

    Raises:
        ValueError: If it holds no real numbers, has another shape than the space, or is not
            finite.
    """
    return np.minimum(np.maximum(finite_action(action, space), -1.0), 1.0)


def check_action_cost(value: Any) -> float:
    """An `action_cost`.

    Raises:
        ValueError: If it is no number, not finite, or negative.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    try:
        cost = float(value) if is_number else math.nan
    except OverflowError:  # a whole number beyond all floats
        cost = math.inf
    if not 0.0 <= cost < math.inf:
        raise ValueError(f"`action_cost` must be a finite number and not negative, got {value!r}.")
    return cost


def check_count(name: str, value: Any) -> int:
    """An argument that counts something.

    Raises:
        ValueError: If it is no whole number of at least one.
    """
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not (is_whole and value >= 1):
        raise ValueError(f"`{name}` must be a whole number of at least 1, got {value!r}.")
    return int(value)


def check_flag(name: str, value: Any) -> bool:
    """An argument that is true or false.

    Raises:
        ValueError: If it is neither, as text is.
    """
    if not (isinstance(value, int | float | np.generic) and value in (0, 1)):
        raise ValueError(f"`{name}` must be True or False, got {value!r}.")
    return bool(value)
