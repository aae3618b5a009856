"""One environment with the interface of several, at a tenth of what Gymnasium's own way costs."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from deep_curiosity_envs.clock import clock_stopped


class SingleEnvironment(VectorEnv):
    """A vector environment of one, without autoreset.

    Args:
        environment: What is stepped.
    """

    def __init__(self, environment: gymnasium.Env) -> None:
        self.environment = environment
        self.num_envs = 1
        self.metadata = environment.metadata | {"autoreset_mode": AutoresetMode.DISABLED}
        self.single_observation_space = environment.observation_space
        self.single_action_space = environment.action_space
        self.observation_space = batch_space(environment.observation_space, 1)
        self.action_space = batch_space(environment.action_space, 1)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode."""
        first = seed[0] if isinstance(seed, list) else seed
        observation, info = self.environment.reset(seed=first)
        return np.array(observation)[None], _batched(info)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step the environment."""
        with clock_stopped():
            # a copy, of which the environment may make what it likes
            observation, reward, terminated, truncated, info = self.environment.step(
                np.array(actions[0])
            )
        return (
            np.array(observation)[None],
            np.array([reward], dtype=np.float64),
            np.array([terminated], dtype=bool),
            np.array([truncated], dtype=bool),
            _batched(info),
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment."""
        self.environment.close()


def _batched(info: dict[str, Any]) -> dict[str, Any]:
    """Each entry with a leading axis."""
    return {name: _with_axis(value) for name, value in info.items()}


def _with_axis(value: Any) -> np.ndarray:
    if isinstance(value, np.ndarray | np.generic | bool | int | float):
        return np.array(value)[None]
    entry = np.empty(1, dtype=object)  # whose shape numpy does not guess
    entry[0] = value
    return entry
