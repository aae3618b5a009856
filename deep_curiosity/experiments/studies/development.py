"""The tasks on which defaults are chosen, on seeds that are reported nowhere else."""

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
    halved,
)
from deep_curiosity.experiments.study import Agents, Study, Task
from deep_curiosity.training.config import Config

CAR = halved(MOUNTAIN_CAR, 12_000)
QUICK = [halved(PENDULUM), halved(MAZE), CAR]
TASKS = [
    *QUICK,
    halved(MAZE_THAT_ENDS),
    halved(CARTPOLE, 20_000),
    halved(CARTPOLE_SPARSE, 20_000),
]
DEFAULT: Agents = {"default": {}}
RAW: Agents = {"raw observations": {"normalize_observations": False}}
STEADY: Agents = {"steady greedy share": {"adaptive_greedy_share": False}}
ABLATIONS: Agents = {
    "256 components": {"components": 256},
    "nothing forgotten": {"marginal_half_life": None},
    "moments": {"whitening": "moments"},
    "no greedy policy": {"greedy_share": 0.0},
    "one step ahead": {"reward_steps": 1, "curiosity_steps": 1},
    **UNIFORM,
}
"""The default without one of its parts each."""
AGENTS: Agents = {
    **DEFAULT,
    **ABLATIONS,
    "half of the steps greedy": {"greedy_share": 0.5},
    "soft backup": {"soft_backup": True},
    "layer norm": {"critic_layer_norm": True},
    **STEADY,
    **RAW,
}
OTHER_UNITS = [CAR] + [
    halved(
        Task(
            f"dm_control {name}",
            SMALL.override(env_id=f"dm_control/{name}-v0"),
            solved_return=500.0,
        ),
        20_000,
    )
    for name in ("finger-spin", "point_mass-easy", "cartpole-balance_sparse")
]

FIXED = SMALL.override(total_steps=2_400, evaluation_interval=1_200, replay_capacity=4_000)
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

SCORED: dict[str, Any] = {
    "first_seed": 100,
    "columns": ("area", "evaluation_return"),
    "measure": measure_area,
}
"""How the protocol compares agents."""
STUDIES = {
    "harm": Study(DENSE_TASKS, CURIOSITY | PLAIN | STEADY, seeds=8, **SCORED),
    "development": Study(TASKS, AGENTS, seeds=8, **SCORED),
    "ablation": Study(QUICK, DEFAULT | ABLATIONS, seeds=8, **SCORED),
    "units": Study(OTHER_UNITS, DEFAULT | RAW, seeds=4, **SCORED),
    "standardization": Study(
        FIXED_TASKS,
        {
            "default": {},
            "nearest-neighbours": {"bonus": "nearest-neighbours"},
            "rnd": {"bonus": "rnd"},
            "disagreement": {"bonus": "disagreement"},
            "information gain": {"bonus": "information-gain"},
            "icm": {"bonus": "icm"},
            "hash-count": {"bonus": "hash-count"},
        },
        seeds=3,
        first_seed=100,
        label="bonus",
        columns=("bonus_mean", "bonus_std"),
        run=run_on_fixed_data,
    ),
}
