"""The quantities that the algorithm of section 4 needs, exact or estimated from samples."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import (
    check_at_least,
    check_distribution,
    check_index,
    check_number,
    check_positive,
    check_range,
    checked,
    fixed_copy,
)
from deep_curiosity.tabular.environments import LARGEST_DISCOUNT, FiniteMDP
from deep_curiosity.tabular.markov import action_values, propagate


class Experience(NamedTuple):
    """One transition of one environment."""

    state: int
    action: int
    reward: float
    next_state: int


def check_experience(experience: Experience, num_states: int, num_actions: int) -> None:
    """Raises unless states and action are among those there are, and the reward is finite."""
    if not isinstance(experience, Experience):
        raise TypeError(f"`experience` must be an Experience, got {experience!r}.")
    check_index("state", experience.state, num_states)
    check_index("action", experience.action, num_actions)
    check_index("next_state", experience.next_state, num_states)
    check_number("reward", experience.reward)
    if not np.isfinite(experience.reward):
        raise ValueError(f"`reward` must be finite, got {experience.reward}.")


class Model(ABC):
    """Model of the transitions and rewards of an environment."""

    @property
    @abstractmethod
    def transition(self) -> Float[np.ndarray, "states actions next_states"]:
        """Probability of the next state for every state and action."""

    @property
    @abstractmethod
    def reward(self) -> Float[np.ndarray, "states actions"]:
        """Expected reward of every state and action."""

    @abstractmethod
    def observe(self, experience: Experience) -> None:
        """Learns from one transition."""


class ExactModel(Model):
    """The true transitions and rewards, with nothing to learn."""

    @checked
    def __init__(self, mdp: FiniteMDP) -> None:
        self.mdp = mdp

    @property
    def transition(self) -> Float[np.ndarray, "states actions next_states"]:
        """The true transitions."""
        return self.mdp.transition

    @property
    def reward(self) -> Float[np.ndarray, "states actions"]:
        """The true rewards."""
        return self.mdp.reward

    def observe(self, experience: Experience) -> None:
        """Learns nothing."""


class CountedModel(Model):
    """Frequencies of next states and mean rewards, uniform before an action is tried.

    An action that was never tried therefore looks unpredictable and attracts no curiosity: (18)
    rewards what the model can predict, not what it would learn. Collect a batch first, or begin
    at a high temperature.

    Args:
        num_states: Number of states.
        num_actions: Number of actions.
        pseudo_count: Imagined visits to every next state, each with reward zero.
    """

    @checked
    def __init__(self, num_states: int, num_actions: int, *, pseudo_count: float = 0.01) -> None:
        check_at_least("num_states", num_states, 1)
        check_at_least("num_actions", num_actions, 1)
        check_positive("pseudo_count", pseudo_count)
        self.counts = np.full((num_states, num_actions, num_states), pseudo_count)
        self.reward_sum = np.zeros((num_states, num_actions))

    @property
    def transition(self) -> Float[np.ndarray, "states actions next_states"]:
        """Frequencies of next states."""
        return self.counts / self.counts.sum(-1, keepdims=True)

    @property
    def reward(self) -> Float[np.ndarray, "states actions"]:
        """Mean rewards."""
        return self.reward_sum / self.counts.sum(-1)

    def observe(self, experience: Experience) -> None:
        """Counts one transition."""
        check_experience(experience, *self.counts.shape[:2])
        state, action, reward, next_state = experience
        self.counts[state, action, next_state] += 1
        self.reward_sum[state, action] += reward


class StateEstimate(ABC):
    """Estimate of the distribution p_t(x) of the state at this time step."""

    @property
    @abstractmethod
    def distribution(self) -> Float[np.ndarray, " states"]:
        """The current estimate."""

    @abstractmethod
    def observe(
        self,
        experience: Experience,
        transition: Float[np.ndarray, "states actions next_states"],
        policy: Float[np.ndarray, "states actions"],
    ) -> None:
        """Updates the estimate by one time step."""


class PropagatedStates(StateEstimate):
    """Carries p_t(x) forward through the model and all policies so far (8): step 2(a), exact.

    Args:
        start: Distribution of the first state.
    """

    @checked
    def __init__(self, start: Float[np.ndarray, " states"]) -> None:
        check_distribution("start", start)
        self.present = fixed_copy(start)

    @property
    def distribution(self) -> Float[np.ndarray, " states"]:
        """The distribution propagated so far."""
        return self.present

    def observe(
        self,
        experience: Experience,
        transition: Float[np.ndarray, "states actions next_states"],
        policy: Float[np.ndarray, "states actions"],
    ) -> None:
        """Propagates the distribution; the experience is not used."""
        self.present = propagate(self.present, transition, policy)


class VisitedStates(StateEstimate):
    """Share of visits of every state, counting one pseudo-visit divided over all states.

    Args:
        num_states: Number of states.
    """

    @checked
    def __init__(self, num_states: int) -> None:
        check_at_least("num_states", num_states, 1)
        self.visits = np.full(num_states, 1 / num_states)

    @property
    def distribution(self) -> Float[np.ndarray, " states"]:
        """Share of visits."""
        return self.visits / self.visits.sum()

    def observe(
        self,
        experience: Experience,
        transition: Float[np.ndarray, "states actions next_states"],
        policy: Float[np.ndarray, "states actions"],
    ) -> None:
        """Counts the state that was left; model and policy are not used."""
        check_index("state", experience.state, len(self.visits))
        self.visits[experience.state] += 1


class ActionValues(ABC):
    """Estimate of the action values Q(x, a) of the reward alone."""

    @abstractmethod
    def estimate(self, model: Model, policy: Float[np.ndarray, "states actions"]) -> np.ndarray:
        """Action values under a policy."""

    @abstractmethod
    def observe(self, experience: Experience) -> None:
        """Learns from one transition."""


class ExactValues(ActionValues):
    """Solves (1) for the current model and policy.

    Args:
        discount: Discount of the return.
    """

    @checked
    def __init__(self, discount: float) -> None:
        check_range("discount", discount, 0.0, LARGEST_DISCOUNT)
        self.discount = discount

    def estimate(self, model: Model, policy: Float[np.ndarray, "states actions"]) -> np.ndarray:
        """Action values of the policy in the model."""
        return action_values(model.transition, model.reward, policy, self.discount)

    def observe(self, experience: Experience) -> None:
        """Learns nothing; the model does."""


class TemporalDifference(ActionValues):
    """A table of action values, learned with step sizes n^-0.7 at the n-th visit.

    Args:
        num_states: Number of states.
        num_actions: Number of actions.
        discount: Discount of the return.
    """

    @checked
    def __init__(self, num_states: int, num_actions: int, discount: float) -> None:
        check_at_least("num_states", num_states, 1)
        check_at_least("num_actions", num_actions, 1)
        check_range("discount", discount, 0.0, LARGEST_DISCOUNT)
        self.discount = discount
        self.action_value = np.zeros((num_states, num_actions))
        self.visits = np.zeros((num_states, num_actions))

    def estimate(self, model: Model, policy: Float[np.ndarray, "states actions"]) -> np.ndarray:
        """The table as it is now."""
        return self.action_value.copy()

    def learn(self, state: int, action: int, target: float) -> None:
        """Moves one entry of the table towards its target."""
        self.visits[state, action] += 1
        step_size = self.visits[state, action] ** -0.7  # sum diverges, sum of squares does not
        self.action_value[state, action] += step_size * (target - self.action_value[state, action])


class Sarsa(TemporalDifference):
    """Values of the policy that acts: each transition is used once the next action is known."""

    unfinished: Experience | None = None

    def observe(self, experience: Experience) -> None:
        """Learns from the previous transition with this action, and keeps this transition."""
        check_experience(experience, *self.action_value.shape)
        if self.unfinished is not None:
            state, action, reward, _ = self.unfinished
            next_value = self.action_value[experience.state, experience.action]
            self.learn(state, action, reward + self.discount * next_value)
        self.unfinished = experience


class QLearning(TemporalDifference):
    """Values of the best policy: learns from the best next action."""

    def observe(self, experience: Experience) -> None:
        """Learns from one transition."""
        check_experience(experience, *self.action_value.shape)
        state, action, reward, next_state = experience
        self.learn(state, action, reward + self.discount * self.action_value[next_state].max())
