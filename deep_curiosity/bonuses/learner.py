"""The small learner that a bonus needs beside an agent."""

import warnings

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.bonuses.base import Bonus, Policy, check_policy
from deep_curiosity.nn.networks import Adam
from deep_curiosity.nn.statistics import Every
from deep_curiosity.transitions import (
    Transition,
    check_counts,
    check_kind,
    check_positive,
    check_transition_kind,
)

MOST_ACTION = 1.001  # beyond which no rounding leads
MOST_LEARNING_RATE = 1.0  # Adam's first step is as long, and weights are about a tenth of it


class BonusLearner(nn.Module):
    """A bonus with its optimiser and its pace: what an adapter keeps beside an agent.

    Args:
        bonus: What learns and is computed.
        learning_rate: Learning rate of Adam, for the networks of the bonus.
        update_interval: Calls of `learn` from one gradient step to the next.

    Raises:
        TypeError: If the bonus is none, or the interval no whole number.
        ValueError: If the learning rate is not positive or the interval below 1.
    """

    optimizer: Adam | None

    def __init__(
        self, bonus: Bonus, *, learning_rate: float = 1e-3, update_interval: int = 1
    ) -> None:
        super().__init__()
        check_kind("bonus", bonus, Bonus)
        check_positive(learning_rate=learning_rate)
        if learning_rate > MOST_LEARNING_RATE:
            raise ValueError(
                f"`learning_rate` must be at most {MOST_LEARNING_RATE}, got {learning_rate}."
            )
        self.bonus = bonus
        self._has_warned = False  # of actions in another unit
        check_counts(update_interval=update_interval)
        self.every = Every(update_interval)
        parameters = self._trained_parameters()
        self.optimizer = Adam(parameters, learning_rate) if parameters else None
        self.register_load_state_dict_post_hook(_step_what_was_loaded)

    def learn(self, transition: Transition, policy: Policy | None = None) -> None:
        """Show the bonus a batch, and at every `update_interval`-th call take a gradient step.

        A warning says so, once, where actions are beyond [-1, 1].

        Args:
            transition: A batch from replay, or the newest rollout.
            policy: Samples fresh actions at the batch's observations.

        Raises:
            TypeError: If it is no `Transition`, or the policy cannot be called.
            RuntimeError: In inference mode, if there is something to learn.
        """
        self.show(transition, policy)
        self.train_on(transition)

    def show(self, transition: Transition, policy: Policy | None = None) -> None:
        """Show the bonus a batch, of which its networks learn nothing; otherwise as `learn`."""
        check_transition_kind(transition)
        self._check_mode()
        observes = not self.bonus.should_skip
        watched = None if policy is None else _WatchedPolicy(policy)
        self.bonus.observe(transition, watched)
        if observes and not self._has_warned:
            fresh = [] if watched is None else watched.actions
            self._look_at_unit(transition.action, *fresh)

    def train_on(self, transition: Transition) -> None:
        """Take a gradient step at every `update_interval`-th call, and show the bonus nothing.

        Args:
            transition: A batch that was shown before, or will be, such as a part of a rollout.

        Raises:
            RuntimeError: In inference mode, if there is something to learn.
        """
        if not self.every.should_skip:
            self.step(transition)
        self.every.count()

    def _look_at_unit(self, *actions: Tensor) -> None:
        """Warn of actions beyond [-1, 1], among which the models tell little apart."""
        farthest = max(action.abs().max().item() for action in actions)
        if farthest <= MOST_ACTION:
            return
        self._has_warned = True
        warnings.warn(
            f"`action` should lie in [-1, 1], got {farthest:g}: bring actions there, those of "
            "`policy` too, by the adapter's range of actions or gymnasium.wrappers.RescaleAction.",
            stacklevel=3,
        )

    def _check_mode(self) -> None:
        """Reject learning where torch keeps no gradients and cannot be told to."""
        if self.optimizer is not None and torch.is_inference_mode_enabled():
            raise RuntimeError(
                "`learn` must be called outside of torch.inference_mode, in which there are no "
                "gradients, got it switched on: torch.no_grad may take its place."
            )

    def step(self, transition: Transition) -> Float[Tensor, ""]:
        """Take a gradient step on the networks of the bonus; return the loss before it.

        Raises:
            RuntimeError: In inference mode, if there is something to learn.
        """
        self._check_mode()
        with torch.enable_grad():
            loss = self.bonus.loss(transition)
            if self.optimizer is not None:
                self.optimizer.step(loss)
        return loss.detach()

    @torch.no_grad()
    def compute(self, transition: Transition) -> Float[Tensor, " batch"]:
        """Bonus of each transition as the networks now stand; the reward is not in it."""
        check_transition_kind(transition)
        observation, action, _, next_observation, *_ = transition
        return self.bonus(observation, action, next_observation)

    def _trained_parameters(self) -> list[nn.Parameter]:
        return [part for part in self.bonus.parameters() if part.requires_grad]


class _WatchedPolicy:
    """A policy, and the actions it was asked for."""

    def __init__(self, policy: Policy) -> None:
        check_policy(policy)
        self.policy = policy
        self.actions: list[Tensor] = []

    def __call__(self, observation: Tensor) -> Tensor:
        action = self.policy(observation)
        self.actions.append(action)
        return action


def _step_what_was_loaded(learner: BonusLearner, _: object) -> None:
    """Give the optimiser the parameters of now: with `assign`, loading puts others there."""
    if learner.optimizer is not None:
        learner.optimizer.replace_targets(learner._trained_parameters())
