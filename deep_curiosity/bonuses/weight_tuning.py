"""Weights of a bonus that tune themselves by what the policy of now earns."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.transitions import check_number_kind, check_positive, is_number

PAST_DECAY = 0.995  # of the remembered earning, for each update: that of usual target networks
LOG_RANGE = math.log(1e3)  # the factor stays within a thousand of one, either way


class TunedWeight(nn.Module):
    r"""A factor that rises while the policy of now earns less bonus than it should.

    .. math:: \log w \leftarrow \log w - \eta \, (earned - goal)

    The goal is what the policies of the recent past have earned, so that curiosity is pressed for
    while it loses ground; or an absolute number.

    Args:
        goal: In the unit of what is earned; `None` for that of the recent past.
        learning_rate: Step size of the log weight, for each update of the agent.

    Raises:
        TypeError: If a number is none.
        ValueError: If the goal is not finite, or the learning rate not positive and finite.

    Reference: Sukhija et al., "MaxInfoRL: Boosting exploration in reinforcement learning through
    information gain maximization" (2024), https://arxiv.org/abs/2412.12098, whose slowly moving
    copy of the policy is replaced here by a slowly moving average, so that any policy will do.
    """

    log_factor: Tensor
    past: Tensor

    def __init__(self, *, goal: float | None = None, learning_rate: float = 3e-4) -> None:
        super().__init__()
        if goal is not None and not is_number(goal):
            check_number_kind(goal=goal)
            raise ValueError(f"`goal` must be finite, got {goal!r}.")
        check_positive(learning_rate=learning_rate)
        self.goal = None if goal is None else float(goal)  # torch takes no large whole number
        self.learning_rate = float(learning_rate)
        self.register_buffer("log_factor", torch.zeros(()))
        self.register_buffer("past", torch.tensor(math.nan))

    @property
    def factor(self) -> Float[Tensor, ""]:
        """By which the bonus is multiplied, at first one."""
        return self.log_factor.exp()

    @torch.no_grad()
    def follow(self, earned: Float[Tensor, ""], num_updates: int = 1) -> None:
        """Take a step for what the policy of now earns on average; none where that is not finite.

        Args:
            earned: Mean score of its actions.
            num_updates: Of the agent, for which this look stands.
        """
        past = torch.where(self.past.isnan(), earned, self.past)
        earned = torch.where(earned.isfinite(), earned, past)
        goal = past if self.goal is None else self.goal
        step = (num_updates * self.learning_rate * (earned - goal)).nan_to_num(nan=0.0)
        self.log_factor.sub_(step).clamp_(-LOG_RANGE, LOG_RANGE)
        self.past.copy_(torch.lerp(earned, past, PAST_DECAY**num_updates))
