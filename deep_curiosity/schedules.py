"""Numbers that go with time: the price of information lambda(t) and the hunger alpha(t)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Shape = Literal["linear", "exponential", "annealing"]
NUM_PLATEAUS = 10  # temperatures at which annealing waits


@dataclass(frozen=True)
class Schedule:
    """A positive number that goes from `first` to `last`, and stays there.

    Args:
        first: Value at step 0.
        last: Value from `num_steps` on.
        num_steps: Length of the way, in environment steps.
        shape: `"linear"`; `"exponential"`, by the same factor at every step; or `"annealing"`,
            the same in ten plateaus, so that the policy settles at each temperature before the
            next: deterministic annealing, as the paper's section 4 lowers lambda.

    Raises:
        ValueError: If an end is not finite and positive, or `num_steps` is below 1.
    """

    first: float
    last: float
    num_steps: int
    shape: Shape = "exponential"

    def __post_init__(self) -> None:
        """Reject a way that leads nowhere."""
        for name in ("first", "last"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ValueError(f"`{name}` must be finite and positive, got {value}.")
        if self.num_steps < 1:
            raise ValueError(f"`num_steps` must be at least 1, got {self.num_steps}.")
        if self.shape not in _PROGRESS:
            raise ValueError(f"`shape` must be one of {tuple(_PROGRESS)}, got {self.shape!r}.")

    def __call__(self, step: int) -> float:
        """Value at an environment step."""
        progress = _PROGRESS[self.shape](min(step / self.num_steps, 1.0))
        if self.shape == "linear":
            return self.first + progress * (self.last - self.first)
        return self.first * (self.last / self.first) ** progress


def _in_plateaus(progress: float) -> float:
    return math.floor(progress * NUM_PLATEAUS) / NUM_PLATEAUS


_PROGRESS: dict[str, Callable[[float], float]] = {
    "linear": float,
    "exponential": float,
    "annealing": _in_plateaus,
}
