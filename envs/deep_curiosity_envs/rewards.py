"""What a task pays and when it counts as solved: functions and memory free of the simulator."""

import math


def tolerance(
    value: float,
    bounds: tuple[float, float],
    margin: float = 0.0,
    value_at_margin: float = 0.1,
) -> float:
    r"""Degree in [0, 1] to which a value lies within its bounds.

    With :math:`d` the distance to the nearest bound, the degree is one inside and outside

    .. math:: v_{margin}^{(d / margin)^2}

    so it falls like a Gaussian. A margin of zero makes the edge sharp.

    Args:
        value: The measured quantity.
        bounds: Lowest and highest value that earn the full degree, both included.
        margin: Distance from the bounds, in units of the value, where `value_at_margin` is left.
        value_at_margin: Degree at one margin from the bounds.

    Raises:
        ValueError: If the bounds are out of order, the margin is negative, or
            `value_at_margin` does not lie strictly between zero and one.

    Example:
        >>> tolerance(1.5, bounds=(-1.0, 1.0), margin=0.5)
        0.1
    """
    _check_tolerance(bounds, margin, value_at_margin)
    distance = max(bounds[0] - value, value - bounds[1], 0.0)
    if margin == 0.0:
        return float(distance == 0.0)
    return float(value_at_margin ** ((distance / margin) ** 2))


def _check_tolerance(bounds: tuple[float, float], margin: float, value_at_margin: float) -> None:
    if not bounds[0] <= bounds[1]:
        raise ValueError(f"`bounds` must be ordered from low to high, got {bounds}.")
    if not 0.0 <= margin < math.inf:
        raise ValueError(f"`margin` must be finite and not negative, got {margin}.")
    if not 0.0 < value_at_margin < 1.0:
        raise ValueError(f"`value_at_margin` must lie between 0 and 1, got {value_at_margin}.")


class Hold:
    """Remembers whether a condition has ever lasted a number of steps in a row.

    Args:
        num_steps: Steps in a row that the condition has to last.
    """

    def __init__(self, num_steps: int) -> None:
        if num_steps < 1:
            raise ValueError(f"`num_steps` must be at least 1, got {num_steps}.")
        self.num_steps = num_steps
        self.reset()

    def reset(self) -> None:
        """Forget everything, as at the start of an episode."""
        self._streak = 0
        self.achieved = False

    def update(self, condition: bool) -> None:
        """Count one more step, or start again from zero when the condition fails."""
        self._streak = self._streak + 1 if condition else 0
        self.achieved = self.achieved or self._streak >= self.num_steps
