"""Collection: one environment, stepped with full knowledge of how to get back to any step."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from torch import Tensor


class Episode(NamedTuple):
    """What is left of an episode once it is over, or how it stands so far."""

    episode_return: float = 0.0
    length: int = 0
    success: float = math.nan
    """1 once the task said `is_success`, 0 while it says not; NaN where it never speaks of it."""

    def after(self, reward: float, info: dict[str, Any]) -> "Episode":
        """The episode one step later."""
        success = self.success
        if "is_success" in info:
            success = float(success == 1.0 or bool(info["is_success"]))
        return Episode(self.episode_return + float(reward), self.length + 1, success)


class EnvironmentStep(NamedTuple):
    """One step as the environment gave it, in the order in which replay takes it."""

    observation: np.ndarray
    action: np.ndarray
    reward: float
    next_observation: np.ndarray
    terminated: bool
    truncated: bool


class Collector:
    """Steps an environment from episode to episode.

    Every episode is reset with a seed of its own, so that the state of the world at any step is a
    function of that seed and the actions since: enough to come back to it in any environment.

    Args:
        environment: Takes actions in [-1, 1].
        seed: Together with the number of the episode it seeds every reset.
    """

    def __init__(self, environment: gymnasium.Env, seed: int) -> None:
        self.environment = environment
        self.seed = seed
        self.num_episodes = 0
        self.observation: np.ndarray
        self.actions: list[np.ndarray]
        self.episode: Episode
        self.info: dict[str, Any] = {}
        """What the environment said of the newest step."""
        self._start()

    def step(self, action: np.ndarray) -> tuple[EnvironmentStep, Episode | None]:
        """Step the environment; return the step, and the episode where this step ended it."""
        next_observation, reward, terminated, truncated, self.info = self.environment.step(action)
        step = EnvironmentStep(
            self.observation, action, float(reward), next_observation, terminated, truncated
        )
        self.actions.append(np.array(action))
        self.episode = self.episode.after(step.reward, self.info)
        self.observation = next_observation
        if not (terminated or truncated):
            return step, None
        finished = self.episode
        self.num_episodes += 1
        self._start()
        return step, finished

    def state_dict(self) -> dict[str, Any]:
        """Number of the episode and the actions taken in it."""
        return {
            "num_episodes": self.num_episodes,
            "actions": [torch.from_numpy(action) for action in self.actions],
            "observation": torch.from_numpy(np.array(self.observation)),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Come back to a step by acting again what was acted since the reset.

        Raises:
            RuntimeError: If the environment does not come back to the same observation.
        """
        self.num_episodes = state["num_episodes"]
        self._start()
        for action in state["actions"]:
            self.step(action.numpy())
        expected = state["observation"].numpy()
        if not np.array_equal(self.observation, expected):
            raise RuntimeError(
                "the environment must repeat an episode from its seed and actions to be resumed; "
                f"after {len(self.actions)} steps it gave {self.observation.tolist()}, before "
                f"{expected.tolist()}."
            )

    def _start(self) -> None:
        seed = np.random.SeedSequence((self.seed, self.num_episodes)).generate_state(1)[0]
        self.observation, _ = self.environment.reset(seed=int(seed))
        self.actions = []
        self.episode = Episode()


def evaluate(
    act: Callable[[Tensor], Tensor], environment: gymnasium.Env, *, episodes: int, seed: int
) -> list[Episode]:
    """Run whole episodes of a policy, the same ones at every call.

    Args:
        act: Observations `(1, observation_dim)` to actions `(1, action_dim)`.
        environment: Apart from the one that is trained on.
        episodes: How many.
        seed: Of their resets.
    """
    collector = Collector(environment, seed)
    finished: list[Episode] = []
    while len(finished) < episodes:
        action = act(as_batch(collector.observation))[0].numpy()
        _, episode = collector.step(action)
        if episode is not None:
            finished.append(episode)
    return finished


def as_batch(observation: np.ndarray) -> Tensor:
    """One observation as a float32 batch of one."""
    return torch.from_numpy(np.asarray(observation, dtype=np.float32)).unsqueeze(0)
