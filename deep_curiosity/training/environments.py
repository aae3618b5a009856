"""Environments the agent can live in: found by id, checked at the door, brought to one form."""

import difflib
import multiprocessing
import signal
from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

import deep_curiosity_envs
from deep_curiosity.training.frame_stack import FrameStack, VectorFrameStack

GOAL_ENDS_EPISODE = frozenset({"MountainCarContinuous-v0"})
"""Tasks that say nothing of success, but terminate at the goal and nowhere else."""


def make_environment(
    env_id: str,
    env_kwargs: Mapping[str, Any] | None = None,
    *,
    history: int = 1,
    render_mode: str | None = None,
) -> gymnasium.Env[np.ndarray, np.ndarray]:
    """Make an environment with vector observations and actions in [-1, 1].

    Args:
        env_id: Registered id; `PendulumSwingup` is short for `deep_curiosity/PendulumSwingup-v0`;
            `dm_control/DOMAIN-TASK-v0` needs the `dmc` extra.
        env_kwargs: Keyword arguments of the environment.
        history: Observations shown together, with the actions between them; see `FrameStack`.
        render_mode: Passed on.

    Raises:
        ValueError: If the id is unknown, the spaces are not continuous, bounded vectors, or
            `history` is below one.
        ImportError: If a dm_control id is asked for without its extra.
    """
    env_id = _registered_id(env_id)
    env_kwargs = dict(env_kwargs or {})
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
    return environment if history == 1 else FrameStack(environment, history)


def make_vector_environment(
    env_id: str,
    env_kwargs: Mapping[str, Any] | None = None,
    *,
    num_envs: int,
    vectorization: Literal["auto", "native", "sync", "async"] = "auto",
    history: int = 1,
) -> VectorEnv[np.ndarray, np.ndarray, np.ndarray]:
    """Make several worlds of what `make_environment` makes, which reset only when they are told.

    Args:
        env_id: As in `make_environment`.
        env_kwargs: As in `make_environment`.
        num_envs: How many worlds.
        vectorization: `"native"` steps the MuJoCo tasks of this package in one call of MuJoCo;
            `"sync"` steps any task world by world, `"async"` each in a process of its own;
            `"auto"` is native where it can be, else sync.
        history: As in `make_environment`.

    Raises:
        ValueError: If a native environment is asked for where there is none, or
            `make_environment` raises it.
    """
    worlds = _make_worlds(_registered_id(env_id), env_kwargs, num_envs, vectorization)
    return worlds if history == 1 else VectorFrameStack(worlds, history)


def _make_worlds(
    env_id: str, env_kwargs: Mapping[str, Any] | None, num_envs: int, vectorization: str
) -> VectorEnv[np.ndarray, np.ndarray, np.ndarray]:
    has_native = env_id in deep_curiosity_envs.TASK_IDS
    if vectorization == "native" and not has_native:
        raise ValueError(
            f"`vectorization` must be 'auto', 'sync' or 'async' for {env_id}, got 'native', which "
            f"is for {', '.join(deep_curiosity_envs.TASK_IDS)}."
        )
    make_one = partial(make_environment, env_id, env_kwargs)
    if vectorization == "async":
        make_worker = partial(_make_in_worker, env_id, env_kwargs)
        return AsyncVectorEnv([make_worker] * num_envs, autoreset_mode=AutoresetMode.DISABLED)
    if vectorization == "sync" or not has_native:
        return SyncVectorEnv([make_one] * num_envs, autoreset_mode=AutoresetMode.DISABLED)
    return gymnasium.make_vec(
        env_id,
        num_envs,
        "vector_entry_point",
        autoreset_mode=AutoresetMode.DISABLED,
        **(env_kwargs or {}),
    )


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


def picture_features(
    env_id: str, env_kwargs: Mapping[str, Any], history: int = 1
) -> tuple[int, int]:
    """Two entries of the observation that tell most when drawn against each other.

    Tasks name them in `metadata["picture_features"]`; otherwise the first and the last are taken.
    With a history they are entries of its newest observation, the last of the window.
    """
    environment = make_environment(env_id, env_kwargs)
    size = observation_dim(environment)
    before_newest = (history - 1) * (size + action_dim(environment))
    first, second = environment.metadata.get("picture_features", (0, size - 1))
    environment.close()
    return before_newest + first, before_newest + second


def observation_dim(environment: gymnasium.Env) -> int:
    """Length of an observation of an environment made here."""
    return int(np.prod(environment.observation_space.shape or ()))


def action_dim(environment: gymnasium.Env) -> int:
    """Length of an action of an environment made here."""
    return int(np.prod(environment.action_space.shape or ()))


def _make_in_worker(env_id: str, env_kwargs: Mapping[str, Any] | None) -> gymnasium.Env:
    """Make an environment; a process of its own leaves Ctrl-C to the one that steps it."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return make_environment(env_id, env_kwargs)


def _registered_id(env_id: str) -> str:
    if env_id.startswith("dm_control/"):
        _require_shimmy()
    known = list(gymnasium.registry)
    for candidate in (env_id, f"deep_curiosity/{env_id}", f"deep_curiosity/{env_id}-v0"):
        if candidate in known:
            return candidate
    nearest = difflib.get_close_matches(env_id, known, n=3, cutoff=0.4)
    raise ValueError(
        f"`env_id` must be a registered id such as {', '.join(nearest or known[-3:])}; "
        f"got {env_id!r}. Tasks of this package: {', '.join(deep_curiosity_envs.TASK_IDS)}."
    )


def _require_shimmy() -> None:
    try:
        import shimmy  # noqa: F401
    except ImportError as error:
        raise ImportError("shimmy is missing: pip install 'deep-curiosity[dmc]'") from error


class _TerminationIsSuccess(gymnasium.Wrapper):
    """Says in `info["is_success"]` that the goal was reached."""

    def step(self, action: np.ndarray) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, info | {"is_success": terminated}
