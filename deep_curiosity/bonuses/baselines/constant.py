"""The control: a bonus without information."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.nn.statistics import MOST_WEIGHT
from deep_curiosity.transitions import Transition, check_inputs, check_transition_kind, is_number


class ConstantBonus(Bonus):
    """The same bonus for every pair: the control that shows what a bonus is worth by its pattern.

    Args:
        value: Bonus of each pair.

    Raises:
        ValueError: If it is no number, or its size beyond 1e37.
    """

    value: Tensor

    def __init__(self, value: float) -> None:
        super().__init__()
        if not (is_number(value) and abs(value) <= MOST_WEIGHT):
            raise ValueError(
                f"`value` must be a number of a size up to {MOST_WEIGHT:g}, got {value!r}."
            )
        self.register_buffer("value", torch.tensor(float(value)))

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """The value, whatever the pair."""
        pair = {"observation": observation, "action": action}
        check_inputs(
            self.value.dtype, **{key: (value, _length(value)) for key, value in pair.items()}
        )
        return self.value.expand(observation.shape[0]).clone()  # which anyone may change in place

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Zero: there is nothing to learn."""
        check_transition_kind(transition)
        return self.value.new_zeros((), requires_grad=True)

    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        """Keep nothing."""

    @property
    def should_skip(self) -> bool:
        """Always: there is nothing to look at."""
        return True

    def metrics(self) -> dict[str, Tensor]:
        """Nothing to log."""
        return {}


def _length(value: Any) -> int:
    """Length of the vectors of a batch, whatever it is: a constant has none of its own."""
    return value.shape[-1] if isinstance(value, Tensor) and value.ndim else 0
