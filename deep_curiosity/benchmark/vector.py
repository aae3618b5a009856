"""Many environments of one task: in one call of MuJoCo, one by one, or each in a process."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from deep_curiosity.benchmark.agents import Row
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import MADE_BY_FUNCTION, make_vector_environment

NUM_ENVS = (1, 4, 16, 64, 256)
NUM_PROCESSES = (1, 2, 4, 8, 16)


def measure_vector_environments(
    task_ids: Sequence[str], num_envs: Sequence[int] = NUM_ENVS, *, repeats: int, steps: int
) -> list[Row]:
    """Environment steps per second, over all environments, measured alternately.

    Args:
        task_ids: Tasks that have a vector environment of their own.
        num_envs: Numbers of environments.
        repeats: Rounds of measurement.
        steps: Of all environments together in a round, rounded up to whole steps of each.
    """
    rows = []
    for task_id in task_ids:
        for num in num_envs:
            native, sync = make_both(task_id, num)
            for repeat in range(repeats):
                rows.append(
                    {
                        "task": task_id,
                        "num_envs": num,
                        "repeat": repeat,
                        "native_steps_per_second": steps_per_second(native, steps),
                        "sync_steps_per_second": steps_per_second(sync, steps),
                    }
                )
            native.close()
            sync.close()
    return rows


def make_both(task_id: str, num_envs: int) -> tuple[VectorEnv, VectorEnv]:
    """The task's own vector environment, and Gymnasium's without its checks of the first step."""
    native = gymnasium.make_vec(task_id, num_envs, "vector_entry_point")
    sync = gymnasium.make_vec(
        task_id,
        num_envs,
        "sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        disable_env_checker=True,
    )
    return native, sync


class Slow(gymnasium.Wrapper):
    """A task whose step waits, as for a simulator in another process or on another machine.

    Args:
        env: The task.
        seconds: Of waiting, in every step.
    """

    def __init__(self, env: gymnasium.Env, seconds: float) -> None:
        super().__init__(env)
        self._seconds = seconds

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Wait, and take the step."""
        time.sleep(self._seconds)
        return super().step(action)


def make_slow(task_id: str, seconds: float) -> gymnasium.Env:
    """A task whose step waits."""
    return Slow(gymnasium.make(task_id, disable_env_checker=True), seconds)


def measure_slow_environments(
    task_id: str,
    seconds: float,
    num_envs: Sequence[int] = NUM_PROCESSES,
    *,
    repeats: int,
    steps: int,
) -> list[Row]:
    """Steps per second of a slow task, each environment in a process, and one after another.

    Args:
        task_id: The task.
        seconds: What every step waits.
        num_envs: Numbers of environments.
        repeats: Rounds of measurement.
        steps: Of all environments together in a round, rounded up to whole steps of each; those
            of an environment must fit into an episode.
    """
    config = EnvironmentConfig(env_id=MADE_BY_FUNCTION)
    make_env = partial(make_slow, task_id, seconds)
    rows = []
    for num in num_envs:
        processes, sync = (
            make_vector_environment(
                replace(config, num_envs=num, vectorization=how), make_env=make_env
            )
            for how in ("async", "sync")
        )
        for repeat in range(repeats):
            rows.append(
                {
                    "sleep_ms": 1e3 * seconds,
                    "num_envs": num,
                    "repeat": repeat,
                    "async_steps_per_second": steps_per_second(processes, steps),
                    "sync_steps_per_second": steps_per_second(sync, steps),
                }
            )
        processes.close()
        sync.close()
    return rows


def steps_per_second(envs: VectorEnv, steps: int) -> float:
    """Rate of all environments together under random actions, from the start of episodes."""
    calls = math.ceil(steps / envs.num_envs)
    envs.action_space.seed(0)
    actions: list[np.ndarray] = [envs.action_space.sample() for _ in range(calls)]
    envs.reset(seed=0)
    started = time.perf_counter()
    for action in actions:
        envs.step(action)
    return calls * envs.num_envs / (time.perf_counter() - started)
