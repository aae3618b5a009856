"""Environments that the agent can act in: found by id, checked, brought to one form."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import difflib
import multiprocessing
import signal
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import FlattenObservation, RescaleAction

import deep_curiosity_envs
from deep_curiosity.requirements import require
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.frame_stack import FrameStack, VectorFrameStack
from deep_curiosity.training.spaces import Entry, TaskSpaces

GOAL_ENDS_EPISODE = frozenset({"MountainCarContinuous-v0"})
"""Tasks that say nothing of success, but terminate at the goal and nowhere else."""


def make_environment(
    config: EnvironmentConfig, *, render_mode: str | None = None
) -> gymnasium.Env[np.ndarray, np.ndarray]:
    """Make an environment with vector observations and actions in [-1, 1].

    Args:
        config: Its `env_id` is a registered one; `PendulumSwingup` is short for
            `deep_curiosity/PendulumSwingup-v0`; `dm_control/DOMAIN-TASK-v0` needs the `dmc` extra.
        render_mode: Passed on.

    Raises:
        ValueError: If the id is unknown, or the spaces are not continuous, bounded vectors.
        ImportError: If a dm_control id is wanted without its extra.
    """
    env_id = registered_id(config.env_id)
    env_kwargs: dict[str, Any] = dict(config.env_kwargs)
    if render_mode is not None:
        env_kwargs["render_mode"] = render_mode
    try:
        environment = gymnasium.make(env_id, disable_env_checker=True, **env_kwargs)
    except TypeError as error:
        raise ValueError(
            f"`env_kwargs` must be arguments of {env_id}, got {env_kwargs}: {error}"
        ) from error
    if env_id.startswith("dm_control/"):
        environment = gymnasium.wrappers.FlattenObservation(environment)
    check_spaces(environment.observation_space, environment.action_space)
    if env_id in GOAL_ENDS_EPISODE:
        environment = _TerminationIsSuccess(environment)
    low, high = np.array([-1.0, 1.0], environment.action_space.dtype)
    environment = gymnasium.wrappers.RescaleAction(environment, low, high)
    return environment if config.frame_stack == 1 else FrameStack(environment, config.frame_stack)


def make_vector_environment(
    config: EnvironmentConfig,
) -> VectorEnv[np.ndarray, np.ndarray, np.ndarray]:
    """Make several environments as `make_environment` does, without autoreset.

    Raises:
        ValueError: If a native environment is wanted where there is none, or `make_environment`
            raises it.
    """
    environment = _make_vector(replace(config, frame_stack=1))
    if config.frame_stack == 1:
        return environment
    return VectorFrameStack(environment, config.frame_stack)


def _make_vector(config: EnvironmentConfig) -> VectorEnv[np.ndarray, np.ndarray, np.ndarray]:
    """Step by one call of MuJoCo, one after another, or each in a process of its own."""
    env_id = registered_id(config.env_id)
    has_native = env_id in deep_curiosity_envs.TASK_IDS
    if config.vectorization == "native" and not has_native:
        raise ValueError(
            f"`vectorization` must be 'auto', 'sync' or 'async' for {env_id}, got 'native', which "
            f"is for {', '.join(deep_curiosity_envs.TASK_IDS)}."
        )
    if config.vectorization == "async":
        workers = [partial(_make_in_worker, config)] * config.num_envs
        return AsyncVectorEnv(workers, autoreset_mode=AutoresetMode.DISABLED)
    if config.vectorization == "sync" or not has_native:
        makers = [partial(make_environment, config)] * config.num_envs
        return SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED)
    env_kwargs: dict[str, Any] = dict(config.env_kwargs)
    try:
        return gymnasium.make_vec(
            env_id,
            config.num_envs,
            "vector_entry_point",
            autoreset_mode=AutoresetMode.DISABLED,
            **env_kwargs,
        )
    except TypeError as error:
        raise ValueError(
            f"`env_kwargs` must be arguments of {env_id}, got {config.env_kwargs}: {error}"
        ) from error


def check_spaces(observation_space: spaces.Space, action_space: spaces.Space) -> None:
    """Reject spaces that the agent cannot take.

    Raises:
        ValueError: Naming the space, the rule and the space received.
    """
    if not isinstance(action_space, spaces.Box) or len(action_space.shape) != 1:
        raise ValueError(
            f"`action_space` must be a Box of continuous vectors, got {action_space}."
        )
    if not action_space.is_bounded():
        raise ValueError(f"`action_space` must be bounded on both sides, got {action_space}.")
    if not isinstance(observation_space, spaces.Box) or len(observation_space.shape) != 1:
        raise ValueError(
            "`observation_space` must be a Box of vectors (flatten dictionaries with "
            f"gymnasium.wrappers.FlattenObservation; images need an encoder), got "
            f"{observation_space}."
        )


def num_cells(environment: gymnasium.Env) -> int | None:
    """Number of cells a task divides its space into, or `None` where it has none."""
    return getattr(environment.unwrapped, "num_cells", None)


def picture_features(config: EnvironmentConfig) -> tuple[int, int]:
    """Two entries of the observation that say most when plotted against each other.

    Tasks name them in `metadata["picture_features"]`; otherwise the first and the last are taken.
    With a frame stack they are entries of its newest observation, the last of the stack.
    """
    environment = make_environment(replace(config, frame_stack=1))
    size = observation_dim(environment)
    before_newest = (config.frame_stack - 1) * (size + action_dim(environment))
    first, second = environment.metadata.get("picture_features", (0, size - 1))
    environment.close()
    return before_newest + first, before_newest + second


def observation_dim(environment: gymnasium.Env) -> int:
    """Length of an observation of an environment made here."""
    return int(np.prod(environment.observation_space.shape or ()))


def action_dim(environment: gymnasium.Env) -> int:
    """Length of an action of an environment made here."""
    return int(np.prod(environment.action_space.shape or ()))


def task_spaces(environment: gymnasium.Env) -> TaskSpaces:
    """Spaces of the task below the wrappers of an environment made here."""
    layers = [environment]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    (rescaled,) = (each for each in layers if isinstance(each, RescaleAction))
    flattened = [each for each in layers if isinstance(each, FlattenObservation)]
    actions = rescaled.env.action_space
    assert isinstance(actions, spaces.Box)
    return TaskSpaces(
        observation_dim(rescaled),
        tuple(actions.low.tolist()),
        tuple(actions.high.tolist()),
        str(actions.dtype),
        tuple(entry for each in flattened for entry in _entries(each.env.observation_space)),
    )


def _entries(space: spaces.Space, path: tuple[str, ...] = ()) -> list[Entry]:
    """Entries of a dictionary space in the order in which it is flattened; none of another."""
    if not isinstance(space, spaces.Dict):
        return [Entry(path, space.shape)] if path and isinstance(space, spaces.Box) else []
    below = [_entries(each, (*path, key)) for key, each in space.spaces.items()]
    return [entry for each in below for entry in each] if all(below) else []


def _make_in_worker(config: EnvironmentConfig) -> gymnasium.Env:
    """Make an environment; a process of its own leaves Ctrl-C to the one that steps it."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return make_environment(config)


def registered_id(env_id: str) -> str:
    """Id by which gymnasium knows a task of this package or another.

    Raises:
        ValueError: If it knows none of this name.
        ImportError: If a dm_control id is wanted without its extra.
    """
    if env_id.startswith("dm_control/"):
        require("shimmy", extra="dmc")
        import_module("shimmy")  # which registers them
    known = list(gymnasium.registry)
    for candidate in (env_id, f"deep_curiosity/{env_id}", f"deep_curiosity/{env_id}-v0"):
        if candidate in known:
            return candidate
    nearest = difflib.get_close_matches(env_id, known, n=3, cutoff=0.4)
    raise ValueError(
        f"`env_id` must be a registered id such as {', '.join(nearest or known[-3:])}; "
        f"got {env_id!r}. Tasks of this package: {', '.join(deep_curiosity_envs.TASK_IDS)}."
    )


class _TerminationIsSuccess(gymnasium.Wrapper):
    """Reports in `info["is_success"]` that the goal was reached."""

    def step(self, action: np.ndarray) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, info | {"is_success": terminated}
