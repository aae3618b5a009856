"""Wrappers that bring what a task says, in whatever form, to the one form that is trained on."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import inspect
import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv

from deep_curiosity.training.failure import RAISED
from deep_curiosity.training.infos import is_told, joined
from deep_curiosity.training.interfaces import Info

SUCCESS_NAMES = ("is_success", "success")
"""Entries of an info by which tasks report success."""
CROSSED = "cells_crossed"
"""Entry of an info that holds every cell that was entered while an action was held."""


class PlainSteps(gymnasium.Wrapper):
    """Makes reward and flags plain numbers, and success an entry `is_success` of the info.

    What is no step by gymnasium's rules is refused by name.

    Args:
        env: A task as its author left it.
        termination_is_success: The task says nothing of success, but terminates at its goal and
            nowhere else.
        terminate_on_success: End an episode once the task reports success.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        *,
        termination_is_success: bool = False,
        terminate_on_success: bool = False,
    ) -> None:
        super().__init__(env)
        self.termination_is_success = termination_is_success
        self.terminate_on_success = terminate_on_success

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode.

        Raises:
            ValueError: If the task does not take seed and options, or does not return observation
                and info.
        """
        observation, info = _unpacked("reset", ("observation", "info"), self._reset(seed, options))
        return observation, _with_success(info)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the task.

        Raises:
            ValueError: If the task does not take an action, or does not return observation,
                reward, two flags that are true or false, and info.
        """
        names = ("observation", "reward", "terminated", "truncated", "info")
        observation, *values, info = _unpacked("step", names, self._step(action))
        reward = _one_number("reward", values[0])
        terminated, truncated = map(_flag, names[2:4], values[1:])
        info = _with_success(info)
        if self.termination_is_success:
            info["is_success"] = terminated
        succeeded = self.terminate_on_success and info.get("is_success", False)
        return observation, reward, terminated or succeeded, truncated, info

    def close(self) -> None:
        """Close the task; one that raises undoes nothing of what was done in it."""
        try:
            self.env.close()
        except RAISED as error:
            warnings.warn(
                "`close` of the environment should raise no error, got "
                f"{type(error).__name__}: {error}.",
                stacklevel=2,
            )

    def _reset(self, seed: int | None, options: dict[str, Any] | None) -> Any:
        """What the task returns, which may be anything."""
        try:
            return self.env.reset(seed=seed, options=options)
        except TypeError as error:
            _check_taken(self.env, "reset", error, seed=seed, options=options)
            raise

    def _step(self, action: np.ndarray) -> Any:
        """What the task returns, which may be anything."""
        try:
            return self.env.step(action)
        except TypeError as error:
            _check_taken(self.env, "step", error, action)
            raise


class VectorObservation(gymnasium.Wrapper):
    """Gives every observation as a new vector of real numbers, of the shape that was promised.

    Args:
        env: Its observations are vectors, of whole numbers too.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        space = env.observation_space
        assert isinstance(space, spaces.Box)
        dtype = real_dtype(space.dtype)
        low, high = space.low.astype(dtype), space.high.astype(dtype)
        self.observation_space = spaces.Box(low, high, dtype=dtype)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode.

        Raises:
            ValueError: If the observation has another shape than its space.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        return self._copied(observation), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, Any, bool, bool, dict[str, Any]]:
        """Step the task.

        Raises:
            ValueError: If the observation has another shape than its space.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._copied(observation), reward, terminated, truncated, info

    def _copied(self, observation: Any) -> np.ndarray:
        """The observation in an array of its own, whatever the task does with its array."""
        space = self.observation_space
        with np.errstate(over="ignore"):  # what is too large becomes infinite, and is seen as that
            copy: np.ndarray = np.array(observation, dtype=space.dtype)
        if copy.shape != space.shape:
            raise ValueError(
                f"`observation` must have the shape {space.shape} of its `observation_space`, "
                f"got {copy.shape}."
            )
        return copy


class ActionRepeat(gymnasium.Wrapper):
    """Holds every action for several steps of the task, of which it shows the last observation.

    Rewards are summed, a success on the way is one, `cells_crossed` in the info are the cells on
    the way where the task tells any, and the end of the episode, or what is not finite, ends the
    holding.

    Args:
        env: Its observations are vectors.
        num_steps: For which an action is held.
    """

    def __init__(self, env: gymnasium.Env, num_steps: int) -> None:
        super().__init__(env)
        self.num_steps = num_steps

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Step the task as often as the action is held."""
        total, succeeded = 0.0, False
        cells = []
        for _ in range(self.num_steps):
            held = np.array(action)  # a task may change it in place
            observation, reward, terminated, truncated, info = self.env.step(held)
            total += float(reward)
            succeeded |= info.get("is_success", False)
            cells += [info["cell"]] if isinstance(info.get("cell"), int | np.integer) else []
            sound = np.isfinite(total) and np.isfinite(observation).all()
            if terminated or truncated or not sound:
                break
        if succeeded or "is_success" in info:  # it may be told at the step alone where it happens
            info["is_success"] = succeeded
        if cells:
            info[CROSSED] = np.array(cells)
        return observation, total, terminated, truncated, info


class JoinedInfos(VectorEnv):
    """Joins the infos of its environments by `joined`, which takes whatever an info may hold."""

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes."""
        observation, infos = super().reset(seed=seed, options=options)
        return observation, self._joined(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every environment."""
        *outcome, infos = super().step(actions)
        observation, reward, terminated, truncated = outcome
        return observation, reward, terminated, truncated, self._joined(infos)

    def _add_info(self, vector_infos: Any, env_info: dict[str, Any], env_num: int) -> Any:
        """Keep the infos apart until all are there."""
        vector_infos[env_num] = env_info
        return vector_infos

    def _joined(self, infos: Any) -> dict[str, Any]:
        return joined([infos.get(index, {}) for index in range(self.num_envs)])


class SyncEnvironments(JoinedInfos, SyncVectorEnv):
    """Environments that are stepped one after another."""


class AsyncEnvironments(JoinedInfos, AsyncVectorEnv):
    """Environments that step in a process of their own each."""


def with_crossed_cells(info: Info) -> Info:
    """Infos of environments, their `cell` all that were entered while an action was held."""
    if CROSSED not in info:
        return info
    return {**info, "cell": info[CROSSED], "_cell": is_told(info, CROSSED)}


def real_dtype(dtype: Any) -> type[np.floating]:
    """Type in which observations are kept: float32, or float64 where they come in it."""
    kind = np.dtype(dtype)
    return np.float64 if kind.kind == "f" and kind.itemsize >= 8 else np.float32


def _check_taken(
    task: gymnasium.Env, name: str, error: TypeError, *arguments: Any, **options: Any
) -> None:
    """Say so where a task, or a wrapper of it, does not take what a method is given.

    Raises:
        ValueError: If it does not.
    """
    layers = [task]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    for layer in layers:
        try:
            signature = inspect.signature(getattr(layer, name))
        except ValueError:  # of what is compiled
            continue
        try:
            signature.bind(*arguments, **options)
        except TypeError:
            taken = ", ".join(options) or "action"
            raise ValueError(
                f"`{name}` of the environment must take ({taken}), as gymnasium defines it, got "
                f"{type(layer).__name__}.{name}{signature}."
            ) from error


def _unpacked(name: str, parts: tuple[str, ...], returned: Any) -> tuple[Any, ...]:
    if isinstance(returned, tuple) and len(returned) == len(parts):
        return returned
    got = f"{len(returned)} values" if isinstance(returned, tuple) else type(returned).__name__
    raise ValueError(
        f"`{name}` of the environment must return ({', '.join(parts)}), as gymnasium defines it, "
        f"got {got}."
    )


def _one_number(name: str, value: Any) -> float:
    """A number, or the one entry of an array."""
    if isinstance(value, float | bool | int):
        return float(value)
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "fbiu":
        raise ValueError(f"`{name}` must be one number, got {value!r}.")
    return float(array.item())


def _flag(name: str, value: Any) -> bool:
    """A number that is true or false."""
    number = _one_number(name, value)
    if number not in (0.0, 1.0):
        raise ValueError(f"`{name}` must be True or False, got {value!r}.")
    return bool(number)


def _with_success(info: Any) -> dict[str, Any]:
    """The info, with success under one name if the task speaks of it at all."""
    if not isinstance(info, dict):
        raise ValueError(f"`info` must be a dictionary, got {info!r}.")
    reported = [info[name] for name in SUCCESS_NAMES if name in info]
    return info | {"is_success": any(map(_is_true, reported))} if reported else dict(info)


def _is_true(value: Any) -> bool:
    try:
        return bool((np.asarray(value, dtype=float) > 0).any())
    except (TypeError, ValueError):  # text or an object: no word of success
        return False
