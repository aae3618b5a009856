"""Environments that show a window of their latest observations and actions, see `windows`."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from deep_curiosity.training.windows import first_window, next_window
from deep_curiosity.training.wrappers import real_dtype


class FrameStack(gymnasium.Wrapper):
    """Shows a window in the place of the observation.

    What a run has learned is of windows with actions in [-1, 1]: of a task with another box they
    come from `FrameStack(RescaleAction(env, -1, 1), num_frames)`.

    Args:
        env: Its observations and actions are vectors.
        num_frames: Observations in a window; actions are one fewer.

    Raises:
        ValueError: If `num_frames` is below one, or a space no box of vectors.
    """

    def __init__(self, env: gymnasium.Env, num_frames: int) -> None:
        super().__init__(env)
        self.num_frames = num_frames
        self.observation_space = window_space(env.observation_space, env.action_space, num_frames)
        self._window: np.ndarray

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode, and forget the one before."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._window = first_window(_real(observation), _size(self.action_space), self.num_frames)
        return self._window, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, Any, bool, bool, dict[str, Any]]:
        """Move the window by one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        taken = _clipped(action, self.action_space)
        self._window = next_window(self._window, taken, observation)
        return self._window, reward, terminated, truncated, info


class VectorFrameStack(VectorWrapper):
    """Shows a window of every environment, each as `FrameStack` would.

    Args:
        env: Its autoreset is disabled, so that episodes begin only when it is reset.
        num_frames: Observations in a window; actions are one fewer.

    Raises:
        ValueError: If `num_frames` is below one, or the environments reset by themselves.
    """

    def __init__(self, env: VectorEnv, num_frames: int) -> None:
        super().__init__(env)
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.DISABLED:
            raise ValueError(f"`env` must have its autoreset disabled, got {mode}.")
        self.num_frames = num_frames
        space = window_space(env.single_observation_space, env.single_action_space, num_frames)
        self.single_observation_space = space
        self.observation_space = batch_space(space, env.num_envs)
        self._window = np.zeros((env.num_envs, *space.shape), space.dtype)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every environment, or in those of `options["reset_mask"]`."""
        everywhere = np.ones(self.num_envs, dtype=bool)
        mask = (options or {}).get("reset_mask", everywhere)  # before Gymnasium takes it out
        observation, info = self.env.reset(seed=seed, options=options)
        first = first_window(_real(observation), _size(self.single_action_space), self.num_frames)
        self._window = np.where(mask[:, None], first, self._window)
        return self._window, info

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Move every window by one step."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        taken = _clipped(actions, self.single_action_space)
        self._window = next_window(self._window, taken, observation)
        return self._window, reward, terminated, truncated, info


def window_space(
    observation_space: spaces.Space, action_space: spaces.Space, num_frames: int
) -> spaces.Box:
    """Space of the windows over both spaces, which are boxes of vectors.

    Raises:
        ValueError: If `num_frames` is below one, or a space no box of vectors.
    """
    if num_frames < 1:
        raise ValueError(f"`num_frames` must be at least 1, got {num_frames}.")
    observation_space, action_space = _vectors(observation_space), _vectors(action_space)
    low, high = (
        np.concatenate([*[observation, action] * (num_frames - 1), observation])
        for observation, action in (
            (observation_space.low, action_space.low),
            (observation_space.high, action_space.high),
        )
    )
    dtype = real_dtype(observation_space.dtype)  # whole numbers have no room for an action
    return spaces.Box(low.astype(dtype), high.astype(dtype), dtype=dtype)


def _vectors(space: spaces.Space) -> spaces.Box:
    if not (isinstance(space, spaces.Box) and len(space.shape) == 1):
        raise ValueError(
            "`env` must have boxes of vectors as its spaces, as FlattenObservation makes them of "
            f"dictionaries, got {space}."
        )
    return space


def _size(space: spaces.Space) -> int:
    (size,) = space.shape or ()
    return size


def _real(observation: np.ndarray) -> np.ndarray:
    """Observations as real numbers: whole ones have no room for an action."""
    return observation.astype(real_dtype(observation.dtype))


def _clipped(action: np.ndarray, space: spaces.Space) -> np.ndarray:
    """An action as the space clips it."""
    assert isinstance(space, spaces.Box)
    clipped: np.ndarray = np.clip(action, space.low, space.high)
    return clipped
