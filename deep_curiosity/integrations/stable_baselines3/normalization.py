"""Raw observations under `VecNormalize`, also of the ends of episodes, which it clips."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize

RAW_END = "raw_terminal_observation"
"""Entry of an info dictionary: the end of an episode before `VecNormalize` has changed it."""


def keep_raw_ends(env: VecEnv) -> None:
    """Let `VecNormalize`, if there is one, leave the raw end of each episode in `info`."""
    for normalize in _normalizations(env):
        below = normalize.venv
        if not hasattr(below.step_wait, "keeps_raw_ends"):
            vars(below)["step_wait"] = _RawEnds(below.step_wait)


def end_of(info: dict[str, Any]) -> Any:
    """The last observation of an episode, raw where that is known.

    Args:
        info: Of the step that ended it.

    Raises:
        ValueError: If the environment has not left it there.
    """
    end = info.get(RAW_END, info.get("terminal_observation"))
    if end is None:
        raise ValueError(
            "`info` must hold `terminal_observation` where an episode ended, as the vector "
            "environments of the library give it, or the start of the next episode would be "
            f"learned as the end of this one, got {sorted(info)}."
        )
    return end


def check_order(env: VecEnv, key: str | None) -> None:
    """Reject wrappers in whose order raw and normalised observations do not belong together.

    Args:
        env: Of the agent.
        key: Entry of a dictionary observation that the bonus is about.

    Raises:
        ValueError: If `VecNormalize` is there twice, or what is above it changes the observation.
    """
    found = [*_normalizations(env)]
    if len(found) > 1:
        raise ValueError(f"`env` must hold VecNormalize at most once, got {_described(env)}.")
    if found and _shape_of(env, key) != _shape_of(found[0], key):
        raise ValueError(
            "`env` must have VecNormalize above all that changes observations, as in "
            f"VecNormalize(VecFrameStack(...)), got {_described(env)}."
        )


def is_clipped(largest: float, normalize: VecNormalize, key: str | None) -> bool:
    """Whether the end of an episode touches the bounds within which `VecNormalize` keeps it.

    Args:
        largest: Its largest entry, whatever the sign.
        normalize: What has normalised it.
        key: Entry of a dictionary observation that it is about.
    """
    keys = normalize.norm_obs_keys
    is_normalized = normalize.norm_obs and (key is None or keys is None or key in keys)
    return is_normalized and bool(largest >= np.float32(normalize.clip_obs))


def raw_part(env: VecEnv) -> VecEnv:
    """The part of an environment that gives what is stored: all that is below `VecNormalize`."""
    normalize = next(_normalizations(env), None)
    return env if normalize is None else normalize.venv


class _RawEnds:
    """`step_wait` of a vector environment, with a second reference to each end of an episode.

    The environment is not wrapped, since the library compares the wrappers of two environments
    one by one.
    """

    keeps_raw_ends = True

    def __init__(self, step_wait: Any) -> None:
        self.step_wait = step_wait

    def __call__(self) -> Any:
        observation, reward, done, infos = self.step_wait()
        for index in np.flatnonzero(done):
            if "terminal_observation" in infos[index]:
                infos[index][RAW_END] = infos[index]["terminal_observation"]
        return observation, reward, done, infos


def _wrappers(env: VecEnv) -> Iterator[VecEnv]:
    """An environment and all within it, from the outermost."""
    yield env
    while isinstance(env, VecEnvWrapper):
        env = env.venv
        yield env


def _normalizations(env: VecEnv) -> Iterator[VecNormalize]:
    return (each for each in _wrappers(env) if isinstance(each, VecNormalize))


def _shape_of(env: VecEnv, key: str | None) -> tuple[int, ...] | None:
    space: Any = env.observation_space
    if key is None:
        return space.shape
    return space[key].shape if key in getattr(space, "spaces", {}) else None


def _described(env: VecEnv) -> str:
    names = [type(each).__name__ for each in _wrappers(env)]
    return "(".join(names) + ")" * (len(names) - 1)
