"""Rewards and success of a task, independent of the simulator."""

import math

import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]


def wrap_angle(angle: Array64) -> Array64:
    """The same angle in [-pi, pi], in rad."""
    return angle - math.tau * np.rint(angle / math.tau)


def tolerance(
    value: Array64,
    bounds: tuple[float, float],
    margin: float = 0.0,
    value_at_margin: float = 0.1,
) -> Array64:
    r"""Degree in [0, 1] to which a value lies within its bounds.

    With :math:`d` the distance to the nearest bound, the degree is one inside and outside

    .. math:: v_{margin}^{(d / margin)^2}

    so it falls like a Gaussian. A margin of zero makes the edge sharp.

    Args:
        value: The measured quantity, of any shape.
        bounds: Lowest and highest value of full degree, both included.
        margin: Distance from the bounds, in units of the value, where `value_at_margin` is left.
        value_at_margin: Degree at one margin from the bounds.

    Raises:
        ValueError: If the bounds are out of order, the margin is negative, or
            `value_at_margin` does not lie strictly between zero and one.

    Example:
        >>> tolerance(np.array([0.0, 1.5]), bounds=(-1.0, 1.0), margin=0.5)
        array([1. , 0.1])
    """
    _check_tolerance(bounds, margin, value_at_margin)
    if margin == 0.0:
        return np.where((bounds[0] <= value) & (value <= bounds[1]), 1.0, 0.0)
    distance = np.maximum(np.maximum(bounds[0] - value, value - bounds[1]), 0.0)
    return value_at_margin ** np.square(distance / margin)


def _check_tolerance(bounds: tuple[float, float], margin: float, value_at_margin: float) -> None:
    if not bounds[0] <= bounds[1]:
        raise ValueError(f"`bounds` must be ordered from low to high, got {bounds}.")
    if not 0.0 <= margin < math.inf:
        raise ValueError(f"`margin` must be finite and not negative, got {margin}.")
    if not 0.0 < value_at_margin < 1.0:
        raise ValueError(f"`value_at_margin` must lie between 0 and 1, got {value_at_margin}.")


class SuccessStreak:
    """Remembers whether a condition has ever lasted a number of steps in a row.

    Args:
        num_steps: Steps in a row that the condition has to last.
        num_envs: Number of environments, one condition each; None for a single one, whose arrays
            have no axis.
    """

    def __init__(self, num_steps: int, num_envs: int | None = None) -> None:
        if num_steps < 1:
            raise ValueError(f"`num_steps` must be at least 1, got {num_steps}.")
        shape = () if num_envs is None else (num_envs,)
        self.num_steps = num_steps
        self.achieved = np.zeros(shape, dtype=bool)
        self._streak = np.zeros(shape, dtype=int)

    def reset(self, mask: NDArray[np.bool_] | bool = True) -> None:
        """Forget everything in all environments, or in those of the mask, as an episode starts."""
        self._streak = self._streak * np.logical_not(mask)
        self.achieved = self.achieved & np.logical_not(mask)

    def update(self, condition: NDArray[np.bool_]) -> None:
        """Count one more step, or start again from zero where the condition fails."""
        self._streak = (self._streak + 1) * condition
        self.achieved = self.achieved | (self._streak >= self.num_steps)
