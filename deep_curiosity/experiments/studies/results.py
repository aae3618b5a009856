"""What is reported: tasks on which nothing was chosen, ten seeds; docs/results/protocol.md."""

from typing import Any

from deep_curiosity.experiments.runs import measure_run_and_area
from deep_curiosity.experiments.studies.comparisons import CURIOSITY, PLAIN
from deep_curiosity.experiments.studies.development import DENSE
from deep_curiosity.experiments.study import Agents, Study, Task
from deep_curiosity.training.config import Config

NARROW, WIDE = 64, 256
MOST_ENTRIES = 12
"""Of an observation for which networks of the narrow kind are used."""
NUM_EVALUATIONS = 20

BASELINES: Agents = {
    "nearest-neighbours": {"bonus": "nearest-neighbours"},
    "information gain": {"bonus": "information-gain"},
}
OTHERS: Agents = {
    "rnd": {"bonus": "rnd"},
    "disagreement": {"bonus": "disagreement"},
    "gSDE": {"bonus": "none", "exploration": "gsde"},
}


def sparse(
    name: str,
    total_steps: int,
    entries: int,
    solved_return: float,
    env_id: str | None = None,
    env_kwargs: dict[str, Any] | None = None,
    is_shown_apart: bool = False,
) -> Task:
    """A task whose reward is sparse, with the settings that the protocol states.

    Args:
        name: In tables.
        total_steps: Its budget.
        entries: Length of its observation, which says how wide networks are.
        solved_return: Evaluation return from which it counts as solved.
        env_id: Of the task; its name where it is left out.
        env_kwargs: Arguments of the task.
        is_shown_apart: Whether the default was chosen on it.
    """
    config = Config.of(
        env_id=name if env_id is None else env_id,
        env_kwargs={} if env_kwargs is None else env_kwargs,
        total_steps=total_steps,
        evaluation_interval=total_steps // NUM_EVALUATIONS,
        log_interval=1_000,
        hidden_dim=NARROW if entries <= MOST_ENTRIES else WIDE,
    )
    return Task(name, config, solved_return, is_shown_apart)


CAR = "MountainCarContinuous-v0"
SWITCH, COST = "deep_curiosity/NoiseSwitch-v0", "deep_curiosity/ActionCost-v0"
PENDULUM = "deep_curiosity/PendulumSwingup-v0"
SPARSE_TASKS = [
    sparse("dm_control/pendulum-swingup-v0", 20_000, 3, 500.0),
    sparse("dm_control/ball_in_cup-catch-v0", 20_000, 8, 500.0),
    sparse("dm_control/finger-turn_hard-v0", 50_000, 12, 500.0),
    sparse("dm_control/reacher-hard-v0", 50_000, 6, 500.0),
    sparse("PointMaze_UMaze-v3", 30_000, 8, 100.0),
    sparse("PointMaze_Medium-v3", 50_000, 8, 200.0),
    sparse("AdroitHandDoorSparse-v1", 50_000, 39, 100.0),
    sparse("ReacherSparse", 100_000, 10, 50.0),
    sparse(CAR, 16_000, 2, 90.0, is_shown_apart=True),
    sparse(f"{CAR}, dear actions", 16_000, 2, 85.0, COST, {"env_id": CAR, "action_cost": 0.1}),
    sparse(f"{CAR}, noise switch", 16_000, 4, 90.0, SWITCH, {"env_id": CAR}),
    sparse("PendulumSwingup, noise switch", 16_000, 5, 100.0, SWITCH, {"env_id": PENDULUM}),
]
DENSE_TASKS = [
    Task(env_id, DENSE.override(env_id=env_id))
    for env_id in ("HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5")
]

MEASURED: dict[str, Any] = {
    "columns": ("evaluation_return", "area", "solved_step"),
    "measure": measure_run_and_area,
    "curves": True,
}
STUDIES = {
    "results": Study(SPARSE_TASKS, CURIOSITY | PLAIN | BASELINES, seeds=10, **MEASURED),
    "results_others": Study(SPARSE_TASKS, CURIOSITY | OTHERS, seeds=5, **MEASURED),
    "results_dense": Study(DENSE_TASKS, CURIOSITY | PLAIN, seeds=10, **MEASURED),
}
