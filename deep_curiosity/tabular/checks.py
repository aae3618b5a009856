"""Argument checks: each error names the argument, the rule and the value received."""

import numpy as np
from jaxtyping import Float

SUM_TOLERANCE = 1e-8  # sums of a thousand float64 probabilities stray by about 1e-13


def check_positive(name: str, value: float) -> None:
    """Raises unless `value` is positive and finite."""
    if not 0 < value < np.inf:
        raise ValueError(f"`{name}` must be positive and finite, got {value}.")


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raises unless `value` lies in the closed interval from `low` to `high`."""
    if not low <= value <= high:
        raise ValueError(f"`{name}` must lie in [{low}, {high}], got {value}.")


def check_at_least(name: str, value: int, least: int) -> None:
    """Raises unless the count `value` is `least` or more."""
    if value < least:
        raise ValueError(f"`{name}` must be at least {least}, got {value}.")


def check_shape(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raises unless `array` has the given shape."""
    if array.shape != shape:
        raise ValueError(f"`{name}` must have shape {shape}, got {array.shape}.")


def check_finite(name: str, array: np.ndarray) -> None:
    """Raises unless every entry of `array` is finite."""
    if not np.isfinite(array).all():
        raise ValueError(f"`{name}` must be finite, got {array[~np.isfinite(array)][0]}.")


def check_distribution(name: str, probability: Float[np.ndarray, "*batch outcomes"]) -> None:
    """Raises unless `probability` is non-negative and sums to one along its last axis."""
    check_finite(name, probability)
    if probability.min() < 0:
        raise ValueError(f"`{name}` must not be negative, got {probability.min()}.")
    total = probability.sum(-1)
    worst = total.flat[np.abs(total - 1).argmax()]
    if abs(worst - 1) > SUM_TOLERANCE:
        raise ValueError(f"`{name}` must sum to 1 along its last axis, got {worst}.")
