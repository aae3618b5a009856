"""The tasks on which defaults are chosen, on seeds that are reported nowhere else."""

from dataclasses import replace
from typing import Any

from deep_curiosity.experiments.fixed_data import run_on_fixed_data
from deep_curiosity.experiments.runs import measure_area
from deep_curiosity.experiments.studies.comparisons import (
    CARTPOLE,
    CARTPOLE_SPARSE,
    CURIOSITY,
    MAZE,
    MAZE_THAT_ENDS,
    MOUNTAIN_CAR,
    PENDULUM,
    PLAIN,
    SMALL,
    UNIFORM,
)
from deep_curiosity.experiments.study import Agents, Study, Task
from deep_curiosity.training.config import Config

HALF: dict[str, Any] = {"update_to_data": 0.5, "evaluation_interval": 2_000}
LENGTHS = [
    (PENDULUM, 16_000),
    (MAZE, 16_000),
    (MAZE_THAT_ENDS, 16_000),
    (MOUNTAIN_CAR, 12_000),
    (CARTPOLE, 20_000),
    (CARTPOLE_SPARSE, 20_000),
]
TASKS = [
    replace(task, config=task.config.override(**HALF, total_steps=length))
    for task, length in LENGTHS
]
DEFAULT: Agents = {"default": {}}
NORMALIZED: Agents = {"normalised observations": {"normalize_observations": True}}
AGENTS: Agents = {
    **DEFAULT,
    "no greedy policy": {"greedy_share": 0.0},
    "half of the steps greedy": {"greedy_share": 0.5},
    "one step ahead": {"reward_steps": 1, "curiosity_steps": 1},
    "moments": {"whitening": "moments"},
    "256 components": {"components": 256},
    "nothing forgotten": {"marginal_half_life": None},
    "soft backup": {"soft_backup": True},
    "layer norm": {"critic_layer_norm": True},
    **NORMALIZED,
    **UNIFORM,
}
OTHER_UNITS = [
    *(task for task in TASKS if task.name == MOUNTAIN_CAR.name),
    *(
        Task(
            f"dm_control {name}",
            SMALL.override(env_id=f"dm_control/{name}-v0", total_steps=20_000, **HALF),
            solved_return=500.0,
        )
        for name in ("finger-spin", "point_mass-easy", "cartpole-balance_sparse")
    ),
]

FIXED = SMALL.override(total_steps=1_600, evaluation_interval=400, replay_capacity=4_000)
FIXED_TASKS = [
    Task(env_id, FIXED.override(env_id=env_id))
    for env_id in (
        "PendulumSwingup",
        "PointMaze",
        "ReacherSparse",
        "Hopper-v5",
        "HalfCheetah-v5",
        "Walker2d-v5",
        "Swimmer-v5",
        "Ant-v5",
    )
]

DENSE = Config.of(total_steps=30_000, log_interval=2_000, evaluation_interval=3_000)
DENSE_TASKS = [
    Task(env_id, DENSE.override(env_id=env_id)) for env_id in ("HalfCheetah-v5", "Hopper-v5")
]

STUDIES = {
    "harm": Study(
        DENSE_TASKS,
        CURIOSITY | PLAIN,
        seeds=8,
        first_seed=100,
        columns=("area", "evaluation_return"),
        measure=measure_area,
    ),
    "development": Study(
        TASKS,
        AGENTS,
        seeds=8,
        first_seed=100,
        columns=("area", "evaluation_return"),
        measure=measure_area,
    ),
    "units": Study(
        OTHER_UNITS,
        DEFAULT | NORMALIZED,
        seeds=4,
        first_seed=100,
        columns=("area", "evaluation_return"),
        measure=measure_area,
    ),
    "standardization": Study(
        FIXED_TASKS,
        {
            "default": {},
            "nearest-neighbours": {"bonus": "nearest-neighbours"},
            "rnd": {"bonus": "rnd"},
            "disagreement": {"bonus": "disagreement"},
        },
        first_seed=100,
        label="bonus",
        columns=("bonus_mean", "bonus_std"),
        run=run_on_fixed_data,
    ),
}
