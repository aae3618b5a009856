"""Many environments of one task: stepped by MuJoCo in one call, or by Gymnasium one by one."""

import math
import time
from collections.abc import Sequence

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from deep_curiosity.benchmark.agents import Row

NUM_ENVS = (1, 4, 16, 64, 256)


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
