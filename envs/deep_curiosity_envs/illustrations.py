"""The paper's two illustrations as environments with one continuous action and no reward."""

from abc import ABC, abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from deep_curiosity_envs.checks import finite_action


class TwoStates(gym.Env[np.ndarray, np.ndarray], ABC):
    """Two states, observed as 0 and 1, between which an action in [0, 1] may flip.

    There is no reward and no end; a time limit belongs to the registration.
    """

    metadata = {"render_modes": []}  # noqa: RUF012, gymnasium's own convention

    def __init__(self) -> None:
        self.observation_space = spaces.Box(0.0, 1.0, (1,), np.float32)
        self.action_space = spaces.Box(0.0, 1.0, (1,), np.float32)
        self.state = 0

    @abstractmethod
    def flip_probability(self, state: int, action: float) -> float:
        """Probability that the next state is the other one."""

    def get_observation(self) -> np.ndarray:
        """The state as a vector of one number."""
        return np.array([self.state], np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts in either state with one half."""
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(2))
        return self.get_observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Flips the state or not; actions outside [0, 1] are clipped.

        Raises:
            ValueError: If the action holds no real numbers, has another shape than the action
                space, or is not finite.
        """
        (chance,) = np.clip(finite_action(action, self.action_space), 0, 1)
        flip = self.flip_probability(self.state, float(chance))
        if self.np_random.random() < flip:
            self.state = 1 - self.state
        return self.get_observation(), 0.0, False, False, {}


class CleverRandom(TwoStates):
    """First illustration: the action is the probability to flip, in both states."""

    def flip_probability(self, state: int, action: float) -> float:
        """The action itself."""
        return action


class ReliableUnreliable(TwoStates):
    """Second illustration: state 0 obeys the action, state 1 leads anywhere with one half.

    The paper's STAY and FLIP are the actions 0 and 1; an action between them flips state 0 with
    that probability, so the policy's mean in state 0 is its chance to leave: pi(STAY | 0) is one
    minus the mean action there. No curious policy gains by an action between the two.
    """

    def flip_probability(self, state: int, action: float) -> float:
        """The action in state 0, one half in state 1."""
        return action if state == 0 else 0.5
