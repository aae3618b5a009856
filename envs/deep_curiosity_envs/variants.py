"""Any task of continuous actions, made harder: dear actions, or noise that they switch."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space, Tuple
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import FlattenObservation

from deep_curiosity_envs.checks import check_action_cost, check_count, finite_action
from deep_curiosity_envs.ids import registered_id

Step = tuple[Any, float, bool, bool, dict[str, Any]]

RENDER_MODES = ("human", "rgb_array", "depth_array", "rgbd_tuple")
NOISE_STREAM = 1  # of a seed, apart from the stream that the task itself draws from


class Metadata:
    """Of a wrapper that is an entry point: a dictionary of the class too, as of a task.

    Gymnasium before 1.4 reads it there, where a wrapper has a property.
    """

    def __get__(self, wrapper: gymnasium.Wrapper | None, kind: type) -> dict[str, Any]:
        """What the task inside has; of the class, all that any task may render."""
        if wrapper is None:
            return {"render_modes": list(RENDER_MODES)}
        metadata: dict[str, Any] = gymnasium.Wrapper.metadata.fget(wrapper)  # type: ignore[attr-defined]
        return metadata

    def __set__(self, wrapper: gymnasium.Wrapper, value: dict[str, Any]) -> None:
        """As of any wrapper."""
        gymnasium.Wrapper.metadata.fset(wrapper, value)  # type: ignore[attr-defined]


class ActionCost(gymnasium.Wrapper, RecordConstructorArgs):
    """A task whose actions cost reward, so that doing nothing is a local optimum.

    Args:
        env_id: Name of the task, such as the trainer takes, whose actions are vectors within
            bounds.
        action_cost: Reward lost per step at full action: it counts the mean over dimensions of the
            squared action, in units of its bounds.
        render_mode: As for the task.
        env: The task itself, as Gymnasium gives it where it makes a variant anew from its spec;
            the arguments that make one are then left alone.
        **env_kwargs: Further arguments of the task.

    Raises:
        ValueError: If the cost is no finite number or negative, there is no such task, or its
            actions are no vectors with room between their bounds.
        ImportError: If the task is one of another package that is missing.
    """

    metadata = Metadata()  # type: ignore[assignment]

    def __init__(
        self,
        env_id: str = "MountainCarContinuous-v0",
        action_cost: float = 0.1,
        render_mode: str | None = None,
        *,
        env: gymnasium.Env | None = None,
        **env_kwargs: Any,
    ) -> None:
        self.action_cost = check_action_cost(action_cost)
        RecordConstructorArgs.__init__(self, action_cost=self.action_cost)
        gymnasium.Wrapper.__init__(self, _make(env_id, render_mode, env_kwargs, env))
        self._middle, self._half_range = _middle_and_half_range(self.env.action_space)

    def step(self, action: Any) -> Step:
        """Take a step and charge it.

        Raises:
            ValueError: If the action holds no real numbers, has another shape than the action
                space, or is not finite.
        """
        checked = finite_action(action, self.action_space)
        observation, reward, terminated, truncated, info = self.env.step(action)
        unit = (checked - self._middle) / self._half_range
        cost = self.action_cost * float(np.mean(np.clip(unit, -1, 1) ** 2))
        return observation, float(reward) - cost, terminated, truncated, info


class NoiseSwitch(gymnasium.Wrapper, RecordConstructorArgs):
    """A task with a television: one more action switches noise on, in channels that say nothing.

    The channels are zero, but independent and uniform in [-1, 1) at every step whose last action
    is positive. What they show is a function of the seed and of the steps taken. Every `info`
    holds `noisy`, whether they flicker.

    Observation: that of the task, a dictionary's entries one after the other, and behind it the
    channels, which make real numbers of whole ones.

    Args:
        env_id: Name of the task, such as the trainer takes, whose observations are vectors, and
            actions vectors of real numbers within bounds.
        num_channels: How many there are.
        render_mode: As for the task.
        env: The task itself, as Gymnasium gives it where it makes a variant anew from its spec;
            the arguments that make one are then left alone.
        **env_kwargs: Further arguments of the task.

    Raises:
        ValueError: If there is no whole number of channels, there is no such task, its
            observations are no vectors, or its actions are no vectors with room between their
            bounds, or whole numbers.
        ImportError: If the task is one of another package that is missing.
    """

    metadata = Metadata()  # type: ignore[assignment]

    def __init__(
        self,
        env_id: str = "MountainCarContinuous-v0",
        num_channels: int = 2,
        render_mode: str | None = None,
        *,
        env: gymnasium.Env | None = None,
        **env_kwargs: Any,
    ) -> None:
        self.num_channels = check_count("num_channels", num_channels)
        RecordConstructorArgs.__init__(self, num_channels=self.num_channels)
        gymnasium.Wrapper.__init__(self, _flattened(_make(env_id, render_mode, env_kwargs, env)))
        own, actions = self.env.observation_space, self.env.action_space
        _middle_and_half_range(actions)
        if not np.issubdtype(actions.dtype, np.floating):
            raise ValueError(f"`env_id` must have actions of real numbers, got {actions}.")
        self.observation_space = _extended(own, self.num_channels)
        self.action_space = _extended(actions, 1)
        self._generator = np.random.default_rng()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode, with the noise off."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            own = np.random.SeedSequence(seed, spawn_key=(NOISE_STREAM,))
            self._generator = np.random.default_rng(own)
        return self._with_channels(observation, noisy=False), info | {"noisy": False}

    def step(self, action: Any) -> Step:
        """Take a step, and set the channels by the last action.

        Raises:
            ValueError: If the action holds no real numbers, has another shape than the action
                space, or is not finite.
        """
        finite_action(action, self.action_space)
        observation, reward, terminated, truncated, info = self.env.step(action[:-1])
        noisy = bool(action[-1] > 0)
        shown = self._with_channels(observation, noisy=noisy)
        return shown, float(reward), terminated, truncated, info | {"noisy": noisy}

    def _with_channels(self, observation: Any, *, noisy: bool) -> np.ndarray:
        channels = self._generator.uniform(-1, 1, self.num_channels) * noisy
        return np.concatenate([observation, channels]).astype(self.observation_space.dtype)


def _make(
    env_id: str, render_mode: str | None, env_kwargs: dict[str, Any], env: gymnasium.Env | None
) -> gymnasium.Env:
    """The task, where it is not given; one that has no render mode is asked for none."""
    if env is not None:
        return env
    if render_mode is not None:
        env_kwargs = env_kwargs | {"render_mode": render_mode}
    return gymnasium.make(registered_id(env_id), **env_kwargs)


def _flattened(task: gymnasium.Env) -> gymnasium.Env:
    """The task with observations of one vector.

    Raises:
        ValueError: If they are of another shape.
    """
    space = task.observation_space
    if isinstance(space, Dict | Tuple) and _is_of_vectors(space):
        task = FlattenObservation(task)
    elif not (isinstance(space, Box) and len(space.shape) == 1):
        raise ValueError(
            f"`env_id` must have observations of one flat array, or vectors by name, got {space}."
        )
    return task


def _is_of_vectors(space: Space) -> bool:
    """Whether a space is of numbers and vectors, by name or in their order."""
    if isinstance(space, Dict | Tuple):
        entries = space.values() if isinstance(space, Dict) else space
        return all(map(_is_of_vectors, entries))
    if isinstance(space, Box | MultiBinary):
        return len(space.shape) <= 1
    return isinstance(space, Discrete | MultiDiscrete)


def _extended(space: Space, num_entries: int) -> Box:
    """The space with entries in [-1, 1] behind its own, all of them real numbers."""
    assert isinstance(space, Box)
    dtype = space.dtype if space.dtype.kind == "f" else np.result_type(space.dtype, np.float32)
    ones = np.ones(num_entries)
    low, high = np.concatenate([space.low, -ones]), np.concatenate([space.high, ones])
    return Box(low.astype(dtype), high.astype(dtype), dtype=dtype.type)


def _middle_and_half_range(space: Space) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half width of the actions in every dimension.

    Raises:
        ValueError: If they are no vectors with room between their bounds.
    """
    if not (
        isinstance(space, Box)
        and space.is_bounded()
        and len(space.shape) == 1
        and space.shape[0] > 0
        and (space.low < space.high).all()
    ):
        raise ValueError(
            "`env_id` must have actions in a bounded box that is flat, not empty and has low < "
            f"high everywhere, got {space}."
        )
    low, high = space.low.astype(float), space.high.astype(float)
    return (low + high) / 2, (high - low) / 2
