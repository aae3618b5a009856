"""A bonus that has learned what it will, as a bonus."""

from copy import deepcopy

from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.transitions import Transition, check_kind, check_transition_kind


class FrozenBonus(Bonus):
    """Answers as another bonus does now, and never changes: it neither learns nor observes.

    Args:
        bonus: Is copied as it now is, and may learn on.

    Raises:
        TypeError: If it is no `Bonus`.
    """

    def __init__(self, bonus: Bonus) -> None:
        super().__init__()
        check_kind("bonus", bonus, Bonus)
        self.bonus = deepcopy(bonus).requires_grad_(False)
        self.eval()
        self.scores_outcomes = bonus.scores_outcomes  # type: ignore[misc]  # as the other does

    def train(self, mode: bool = True) -> "FrozenBonus":
        """Stay in evaluation, whatever the mode."""
        return super().train(False)

    @property
    def ready(self) -> bool:
        """Whether the other bonus could be computed."""
        return self.bonus.ready

    @property
    def should_skip(self) -> bool:
        """It observes no batch."""
        return True

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """Bonus of each pair, actions in [-1, 1]."""
        value: Tensor = self.bonus(observation, action, next_observation)
        return value

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Zero: there is nothing to learn."""
        check_transition_kind(transition)
        return transition.reward.new_zeros((), requires_grad=True)

    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        """Do nothing."""

    def metrics(self) -> dict[str, Tensor]:
        """What the other bonus logs."""
        return self.bonus.metrics()
