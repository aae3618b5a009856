"""Numbers that go with time, each as one value: the price of information, the hunger."""

import math
import sys
from dataclasses import dataclass
from typing import Literal, get_args

from deep_curiosity.transitions import check_number_kind, is_number

Shape = Literal["constant", "linear", "exponential", "plateaus"]
NUM_PLATEAUS = 10  # values at which annealing waits, the first and the last among them


@dataclass(frozen=True)
class Schedule:
    """A positive number that goes from `first` to `last` in the course of a run.

    As text, on a command line or in a file, it is `shape:first:last`, such as `linear:1:10`, or
    `constant:0.05`.

    Args:
        first: Value at the beginning.
        last: Value at the end; `first` when `None`.
        shape: `"constant"`; `"linear"`; `"exponential"`, by the same factor at every step; or
            `"plateaus"`, at ten values for a tenth of the way each, from the first to the last by
            the same factor, so that the policy settles at each value before the next:
            deterministic annealing, as the paper's section 4 lowers lambda.

    Raises:
        TypeError: If an end is no number.
        ValueError: If an end is not finite and positive, the shape is unknown, or a constant is to
            end elsewhere than it begins.
    """

    first: float
    last: float | None = None
    shape: Shape = "exponential"

    def __post_init__(self) -> None:
        """Reject a way that leads nowhere."""
        if self.shape not in get_args(Shape):
            raise ValueError(f"`shape` must be one of {get_args(Shape)}, got {self.shape!r}.")
        for name in ("first", "last"):
            value = getattr(self, name)
            if value is None and name == "last":
                continue
            if not (is_number(value) and value > 0):
                check_number_kind(**{name: value})
                raise ValueError(f"`{name}` must be finite and positive, got {value!r}.")
            object.__setattr__(self, name, float(value))  # NumPy's are written otherwise
        if (self.shape == "constant") != (self.last is None):
            raise ValueError(
                "`last` must be left out where the shape is 'constant', and nowhere else, "
                f"got {self.last} for {self.shape!r}."
            )

    @classmethod
    def parse(cls, text: str) -> "Schedule":
        """Read `shape:first:last`.

        Raises:
            ValueError: If the text is no schedule.
        """
        if not isinstance(text, str):
            raise TypeError(f"`text` must be written as shape:first:last, got {text!r}.")
        shape, *numbers = text.split(":")
        try:
            values = [float(number) for number in numbers]
        except ValueError:
            values = []
        if shape not in get_args(Shape) or not 1 <= len(values) <= 2:
            raise ValueError(
                "`schedule` must be written as shape:first:last, its shape one of "
                f"{', '.join(get_args(Shape))}, got {text!r}."
            )
        last = values[1] if len(values) > 1 else None
        return cls(values[0], last, shape)  # type: ignore[arg-type]  # one of the shapes

    def __str__(self) -> str:
        """As `parse` reads it."""
        ends = [self.first] if self.last is None else [self.first, self.last]
        return ":".join([self.shape, *(f"{end!r}" for end in ends)])

    def __call__(self, progress: float) -> float:
        """Value at a share of the way, from 0 to 1; it stays where it ends."""
        if not (is_number(progress) and progress >= 0):
            check_number_kind(progress=progress)
            raise ValueError(f"`progress` must be finite and not negative, got {progress!r}.")
        progress = min(progress, 1.0)
        if self.last is None:
            return self.first
        if self.shape == "plateaus":
            plateau = min(math.floor(progress * NUM_PLATEAUS), NUM_PLATEAUS - 1)
            progress = plateau / (NUM_PLATEAUS - 1)
        if progress == 1:
            return self.last
        least, most = sorted((self.first, self.last))
        return min(max(self._between(self.first, self.last, progress), least), most)

    def _between(self, first: float, last: float, progress: float) -> float:
        """Value between both ends, but for rounding."""
        if self.shape == "linear":
            return first + progress * (last - first)
        ratio = last / first
        if sys.float_info.min <= ratio < math.inf:
            return first * ratio**progress
        return first ** (1 - progress) * last**progress  # of ends too far apart
