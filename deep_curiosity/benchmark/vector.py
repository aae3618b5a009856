"""Many worlds of one task: stepped by MuJoCo in one call, or by Gymnasium in turn."""

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
    """Environment steps per second, over all worlds, in turns.

    Args:
        task_ids: Tasks that have a vector environment of their own.
        num_envs: Numbers of worlds.
        repeats: Turns of each.
        steps: Of all worlds together in a turn, rounded up to whole steps of each.
    """
    rows = []
    for task_id in task_ids:
        for num in num_envs:
            native, in_turn = make_both(task_id, num)
            for repeat in range(repeats):
                rows.append(
                    {
                        "task": task_id,
                        "num_envs": num,
                        "repeat": repeat,
                        "native_steps_per_second": steps_per_second(native, steps),
                        "sync_steps_per_second": steps_per_second(in_turn, steps),
                    }
                )
            native.close()
            in_turn.close()
    return rows


def make_both(task_id: str, num_envs: int) -> tuple[VectorEnv, VectorEnv]:
    """The task's own vector environment, and Gymnasium's without its checks of the first step."""
    native = gymnasium.make_vec(task_id, num_envs, "vector_entry_point")
    in_turn = gymnasium.make_vec(
        task_id,
        num_envs,
        "sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        disable_env_checker=True,
    )
    return native, in_turn


def steps_per_second(worlds: VectorEnv, steps: int) -> float:
    """Rate of all worlds together under random actions, from the first step of their episodes."""
    calls = math.ceil(steps / worlds.num_envs)
    worlds.action_space.seed(0)
    actions: list[np.ndarray] = [worlds.action_space.sample() for _ in range(calls)]
    worlds.reset(seed=0)
    started = time.perf_counter()
    for action in actions:
        worlds.step(action)
    return calls * worlds.num_envs / (time.perf_counter() - started)
