"""Agents side by side: curiosity, plain soft actor-critic, baselines, and what sampling spares."""

from dataclasses import replace

from deep_curiosity.experiments.study import Agents, Study, Task
from deep_curiosity.training.config import PRESETS, Config

SMALL = Config.of(total_steps=16_000, hidden_dim=64, log_interval=1_000, evaluation_interval=1_000)
PENDULUM = Task(
    "PendulumSwingup",
    SMALL.override(env_id="PendulumSwingup", env_kwargs={"action_cost": 0.1}),
    solved_return=100.0,  # half of 200 steps that pay at most 1 each
)
MAZE = Task(
    "PointMaze",
    SMALL.override(env_id="PointMaze", total_steps=24_000),
    solved_return=101.5,  # half of what the tests' scripted walk along the shortest way earns
)
MAZE_THAT_ENDS = Task(
    "PointMaze, ends at goal",
    MAZE.config.override(env_kwargs={"goal_terminates": 1.0}, evaluation_interval=2_000),
    solved_return=0.5,  # half of the one reward there is
)
CARTPOLE = Task(
    "CartpoleSwingup",
    SMALL.override(env_id="CartpoleSwingup", total_steps=30_000, evaluation_interval=2_000),
    solved_return=100.0,
)
CARTPOLE_SPARSE = Task(
    "dm_control cartpole-swingup_sparse",
    SMALL.override(
        env_id="dm_control/cartpole-swingup_sparse-v0",
        total_steps=50_000,
        evaluation_interval=5_000,
    ),
    solved_return=500.0,
)
MOUNTAIN_CAR = Task(
    "MountainCarContinuous-v0",
    SMALL.override(env_id="MountainCarContinuous-v0"),
    solved_return=90.0,
)
REACHER = Task(
    "ReacherSparse",
    SMALL.override(env_id="ReacherSparse"),
    solved_return=50.0,  # half of what an episode of 100 steps pays at most
)
CURIOSITY: Agents = {"curiosity": {}}
PLAIN: Agents = {"plain SAC": {"bonus": "none"}}
UNIFORM: Agents = {"uniform prior": {"prior": "uniform"}}
BASELINES = ("disagreement", "information-gain", "rnd", "icm", "nearest-neighbours", "hash-count")
UNDIRECTED = {"gSDE": "gsde", "pink noise": "pink", "Ornstein-Uhlenbeck": "ou"}


def halved(task: Task, total_steps: int = 16_000) -> Task:
    """The same task with an update at every second step only: many agents are to be compared."""
    config = task.config.override(
        update_to_data=0.5, total_steps=total_steps, evaluation_interval=2_000
    )
    return replace(task, config=config)


GOALS = [
    replace(PENDULUM, name="PendulumSwingup, full updates"),
    replace(halved(PENDULUM), name="PendulumSwingup, half the updates"),
    replace(halved(MAZE), name="PointMaze, half the updates"),
    MAZE_THAT_ENDS,
    MOUNTAIN_CAR,
    CARTPOLE,
    CARTPOLE_SPARSE,
]

STUDIES = {
    "goals": Study(GOALS, CURIOSITY | UNIFORM, seeds=10, curves=True),
    "sparse": Study([PENDULUM, halved(MAZE)], CURIOSITY | PLAIN, seeds=10, curves=True),
    "control": Study([PENDULUM, MAZE], {"constant bonus": {"bonus": "constant"}}, curves=True),
    "subsampling": Study(
        [halved(PENDULUM), halved(MAZE)],
        {
            "curiosity": {},
            "curiosity, exact": PRESETS["exact"],
            "curiosity, same time": {"update_to_data": 0.75},  # as the exact updates take
        },
        seeds=10,
    ),
    "bonuses": Study(
        [halved(task) for task in (PENDULUM, MAZE, REACHER, MOUNTAIN_CAR)],
        CURIOSITY
        | {name: {"bonus": name} for name in BASELINES}
        | PLAIN
        | {name: {"bonus": "none", "exploration": noise} for name, noise in UNDIRECTED.items()},
        columns=("evaluation_return", "mean_training_return"),
    ),
    "mountain_car": Study([MOUNTAIN_CAR], CURIOSITY | PLAIN, curves=True),
}
