"""The control: a bonus without information."""

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.transitions import Transition


class ConstantBonus(Bonus):
    """The same bonus for every pair: the control that shows what a bonus is worth by its pattern.

    Args:
        value: Bonus of each pair.
    """

    value: Tensor

    def __init__(self, value: float) -> None:
        super().__init__()
        self.register_buffer("value", torch.tensor(value))

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """The value, whatever the pair."""
        return self.value.expand(observation.shape[0])

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Zero: there is nothing to learn."""
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
