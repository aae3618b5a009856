"""Schedules of the temperature lambda(t) and the hunger alpha(t)."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from deep_curiosity.tabular.checks import check_positive, check_range, checked, fixed_copy

Setting = TypeVar("Setting", float, np.ndarray)


def fixed(setting: Setting) -> Callable[[int], Setting]:
    """A constant schedule: a number, or an array with one entry for each state."""
    kept = fixed_copy(setting) if isinstance(setting, np.ndarray) else setting
    return lambda step: kept


@checked
def decreasing(first: float, factor: float, least: float = 0.0) -> Callable[[int], float]:
    """Geometric decrease to a lower bound: lambda(t) down to lambda_min.

    Args:
        first: Value at step 0.
        factor: Factor of each step, at most one.
        least: Lower bound.
    """
    check_positive("first", first)
    check_range("factor", factor, 0.0, 1.0)
    return lambda step: max(least, first * factor**step)
