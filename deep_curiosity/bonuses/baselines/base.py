"""What all baselines share: checks at the door, whitened observations, a standardised bonus."""

from abc import abstractmethod
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy, ask_policy, check_policy
from deep_curiosity.nn.statistics import WHITENINGS, Every, Standardization, replaced_by_mean
from deep_curiosity.transitions import (
    Transition,
    check_counts,
    check_inputs,
    check_transition,
    check_transition_kind,
    every_second,
)

SCORE_FLOOR = 1e-6  # of squared errors in whitened units, below which they are all alike


def log_of_score(value: Float[Tensor, " batch"]) -> Float[Tensor, " batch"]:
    """Log of a squared error or a variance, whose few largest values would drown all others.

    Half the variance of a disagreement lies in a hundredth of its rows, and more of an error's.
    """
    return torch.log(value + SCORE_FLOOR)


class BaselineBonus(Bonus):
    """A score of pairs, or of their outcomes, in units of its own, then standardised.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        weight: Factor of the standardised score.
        center: Subtract the score's running mean.
        scale: Divide by the score's running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.

    Raises:
        ValueError: If a size or the weight is out of range.
    """

    follows_visits: ClassVar[bool] = False
    """Whether `update_statistics` is given what was visited of late instead of the batch."""
    asks_policy: bool = False
    """Whether `update_statistics` is given actions of the policy of now, where there is one."""

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        weight: float,
        center: bool,
        scale: bool,
        refresh_interval: int,
    ) -> None:
        super().__init__()
        check_counts(
            observation_dim=observation_dim,
            action_dim=action_dim,
            refresh_interval=refresh_interval,
        )
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.standardization = Standardization(weight=weight, center=center, scale=scale)
        self.observation_moments = WHITENINGS["moments"](observation_dim)
        self.every = Every(refresh_interval)

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """Weighted, standardised score of each pair; changes no state.

        Raises:
            TypeError: If an argument has the wrong kind.
            ValueError: If `next_observation` is missing where outcomes are scored, or an argument
                has the wrong shape, another batch size, or a value that is not finite or beyond
                1e14, an action beyond 1e3.
        """
        inputs = {
            "observation": (observation, self.observation_dim),
            "action": (action, self.action_dim),
            "next_observation": (next_observation, self.observation_dim),
        }
        if next_observation is None:
            del inputs["next_observation"]
        check_inputs(self._dtype, **inputs)
        if next_observation is None and self.scores_outcomes:
            raise ValueError(
                f"`next_observation` must be given to a {type(self).__name__}, which scores what "
                "has happened, got None."
            )
        return self.standardization(self.score(observation, action, next_observation))

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Loss of what the bonus learns.

        Raises:
            TypeError: If a field has the wrong kind.
            ValueError: If a field has the wrong shape or holds NaN or infinity.
        """
        self._check(transition)
        return self.network_loss(transition)

    @torch.no_grad()
    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        """Update the statistics from a batch, at every `refresh_interval`-th call.

        Raises:
            TypeError: If a field, the policy or what it returns has the wrong kind.
            ValueError: If a field, or what the policy returns, has the wrong shape or holds NaN or
                infinity. The statistics are then as before.
        """
        if self.should_skip:
            self.skip()
            return
        self._check(transition)
        scored, late = transition, transition
        if visited is not None and self.follows_visits:
            check_transition_kind(visited, "visited")
            late = visited
            has_none = isinstance(late.action, Tensor) and late.action.shape[:1] == (0,)
            if not has_none:  # nothing new may have been visited
                self._check(late, "visited")
        fresh_action = self._ask_policy(late, policy)
        self.observation_moments.update(transition.observation)
        if not self.ready:  # half of the first batch is remembered, the other half is scored
            self.update_statistics(every_second(late, 0), None)
            scored, late = every_second(transition, 1), every_second(late, 1)
            fresh_action = None if fresh_action is None else fresh_action[1::2]
        if len(scored.action):  # none of a first batch of one: the next is then due at once
            self.every.count()
            observation, action, _, next_observation, *_ = scored
            score = self.score(observation, action, next_observation)
            is_far = self.observation_moments.is_far
            is_absurd = is_far(observation) | is_far(next_observation)
            self.standardization.update(replaced_by_mean(score, is_absurd))
        if len(late.action):  # only now: what is scored is not remembered yet
            self.update_statistics(late, fresh_action)

    @property
    def should_skip(self) -> bool:
        """Whether the next batch would only be counted."""
        return self.every.should_skip

    def skip(self) -> None:
        """Count a batch that is not shown."""
        self.every.count()

    def metrics(self) -> dict[str, Tensor]:
        """Running mean and standard deviation of the score, in its own unit."""
        moments = self.standardization.moments
        return {"score": moments.mean[0].clone(), "score_std": moments.scale[0].clone()}

    @abstractmethod
    def score(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None,
    ) -> Float[Tensor, " batch"]:
        """Score of each pair in its own unit, with all networks held fixed."""

    def network_loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Loss of the networks; zero where there are none."""
        return transition.reward.new_zeros((), requires_grad=True)

    def update_statistics(self, transition: Transition, fresh_action: Tensor | None) -> None:
        """Whatever else is kept of a batch, or of what was visited of late; nothing by default.

        Args:
            transition: The batch, or what was visited.
            fresh_action: `(batch, action_dim)`, what the policy of now would do there; `None`
                where it is not known or `asks_policy` is False.
        """

    def pair_features(self, observation: Tensor, action: Tensor) -> Tensor:
        """Whitened observation and action, as networks of pairs take them."""
        return torch.cat([self.observation_moments.normalize(observation), action], dim=-1)

    @property
    def _dtype(self) -> torch.dtype:
        return self.observation_moments.mean.dtype

    def _ask_policy(self, transition: Transition, policy: Policy | None) -> Tensor | None:
        """Actions of the policy of now, if any are wanted, checked as those of the batch are."""
        if policy is None:
            return None
        check_policy(policy)
        if not self.asks_policy:
            return None
        return ask_policy(policy, transition.observation, self.action_dim)

    def _check(self, transition: Transition, name: str = "transition") -> None:
        check_transition(transition, self.observation_dim, self.action_dim, self._dtype, name)
