"""One setting at a time: what it does to return, coverage, information or time at a noise."""

import math
from typing import Any

import gymnasium
import numpy as np
import torch

from deep_curiosity.bonuses.decomposition import PARTS
from deep_curiosity.experiments.runs import measure_area
from deep_curiosity.experiments.study import Agents, Row, Study, Task
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collector import Collector, Episode, as_batch
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.log import read_progress
from deep_curiosity.training.playback import load_agent
from deep_curiosity_envs import NoisyRoom
from deep_curiosity_envs.pendulum import SPEED_BOUND
from deep_curiosity_envs.point_room import CELLS_PER_SIDE

HUNGERS = [tenth / 10 for tenth in range(11)]
SWEPT_EPISODES = 10
LAST_EPISODES = 20
GRID = (24, 16)  # cells of the pendulum's angle and speed
NOISE_CHANNELS = slice(4, 6)  # of NoisyRoom's observation
PHASE = 4_000  # steps at either end of a run, whose cells are counted by themselves

SMALL = Config.of(hidden_dim=64, log_interval=500, evaluation_interval=2_000)
HALVED = SMALL.override(update_to_data=0.5, total_steps=16_000)
WIDE = SMALL.override(hidden_dim=128, total_steps=30_000, evaluation_interval=1_500)
COST: dict[str, Any] = {"env_kwargs": {"action_cost": 0.1}}
LASTING: dict[str, Any] = {"marginal_half_life": None}
PAST_THE_END: dict[str, Any] = {"curiosity_episodic": False}
DEFAULT: Agents = {"curiosity": {}}
PLAIN_AND_DEFAULT: Agents = {"plain": {"bonus": "none"}, "default": {}}
DENSE_AGENTS: Agents = PLAIN_AND_DEFAULT | {"bandit": {"hunger": "bandit"}}
NOISE_BASELINES = ("rnd", "icm", "nearest-neighbours", "none")
RETURNS = ("evaluation_return", "mean_training_return")
AREA = ("area", "evaluation_return")
NOISE = ("noisy_time", "early_coverage", "late_coverage", "coverage")


def task(name: str, base: Config, **settings: Any) -> Task:
    """A task by its id, in a study that asks for no return."""
    return Task(name, base.override(env_id=name, **settings))


def measure_rate(config: Config, summary: Row) -> list[Row]:
    """Information of the actions over the last third of a run, as held and from both sides."""
    begun = config.run.total_steps * 2 / 3
    late = [row for row in read_progress(config.run.out) if float(row["step"]) > begun]
    tags = {
        "rate": "agent/information_rate",
        "lower": "agent/action_information_lower",
        "upper": "agent/action_information_upper",
    }
    means = {name: float(np.mean([float(row[tag]) for row in late])) for name, tag in tags.items()}
    return [means | {"evaluation_return": summary["evaluation_return"]}]


def measure_noise(config: Config, summary: Row) -> list[Row]:
    """Share of cells visited, and time where there is noise, in units of a uniform walk's."""
    rows = load_checkpoint(config.run.out)["learner"]["replay"]["rows"]
    noise = rows[config.run.learning_starts :, NOISE_CHANNELS]
    noisy = float((noise != 0).any(-1).double().mean())
    return [
        {
            "noisy_time": noisy / NoisyRoom.noisy_share,
            "early_coverage": cell_share(rows[:PHASE]),
            "late_coverage": cell_share(rows[-PHASE:]),
            "coverage": summary["coverage"],
        }
    ]


def measure_hungers(config: Config, summary: Row) -> list[Row]:
    """Return and cells of an agent that is conditioned on its hunger, at each hunger."""
    environment = make_environment(config.environment)
    agent = load_agent(config.run.out, config, environment)
    torch.manual_seed(config.run.seed)
    row: Row = {}
    for hunger in HUNGERS:
        agent.hunger = hunger
        collector = Collector(environment, seed=config.run.seed)
        returns: list[float] = []
        cells = set()
        while len(returns) < SWEPT_EPISODES:
            step, finished = collector.step(agent.act(as_batch(collector.observation)).numpy())
            cells.add(pendulum_cell(step.next_observation[0]))
            returns += [episode.episode_return for episode in finished]
        row[f"return_at_{hunger}"] = float(np.mean(returns))
        row[f"coverage_at_{hunger}"] = len(cells) / math.prod(GRID)
    environment.close()
    return [row]


def measure_survival(config: Config, summary: Row) -> list[Row]:
    """How many of a run's last episodes ended with an empty battery, and cells seen in them."""
    state = load_checkpoint(config.run.out)
    episodes = [Episode(*values) for values in state["run_log"]["episodes"][-LAST_EPISODES:]]
    steps = sum(episode.length for episode in episodes)
    whole = gymnasium.spec("deep_curiosity/BatteryRover-v0").max_episode_steps
    return [
        {
            "starved": sum(episode.length != whole for episode in episodes),
            "coverage": cell_share(state["learner"]["replay"]["rows"][-steps:]),
            "mean_training_return": summary["mean_training_return"],
        }
    ]


def cell_share(rows: torch.Tensor) -> float:
    """Share of a room's cells that rows of replay lie in."""
    position = rows[:, :2].numpy()
    cells = np.floor(np.clip((position + 1) / 2, 0, 1 - 1e-6) * CELLS_PER_SIDE).astype(int)
    return len(np.unique(cells, axis=0)) / CELLS_PER_SIDE**2


def pendulum_cell(observation: np.ndarray) -> tuple[int, int]:
    """Cell of the pendulum's angle and speed that an observation lies in."""
    cosine, sine, speed = observation
    angle = math.atan2(sine, cosine) / (2 * math.pi) + 0.5
    place = np.clip((angle, 0.5 * (1 + speed / SPEED_BOUND)), 0, 1 - 1e-9) * GRID
    return int(place[0]), int(place[1])


PENDULUM_FULL = task("PendulumSwingup", SMALL, total_steps=16_000, **COST)
MAZE_HALVED = task("PointMaze", HALVED)
MOTORS = task("ManyMotors", HALVED, **COST)
HOPPER = task("Hopper-v5", WIDE)

STUDIES = {
    "rate": Study(
        [
            task("PendulumSwingup", SMALL, update_to_data=0.5, **COST),
            task("HalfCheetah-v5", SMALL, update_to_data=0.5),
        ],
        {rate: {"target_information_rate": rate} for rate in (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)},
        label="target rate",
        columns=("rate", "lower", "upper", "evaluation_return"),
        measure=measure_rate,
    ),
    "hunger": Study(
        [PENDULUM_FULL],
        {"conditioned": {"hunger": "random"}},
        columns=[f"{name}_at_{hunger}" for name in ("return", "coverage") for hunger in HUNGERS],
        measure=measure_hungers,
    ),
    "alpha": Study(
        [PENDULUM_FULL],
        {hunger: {"hunger": hunger} for hunger in (0.3, 1.0, 3.0, 10.0)},
        label="hunger",
        columns=RETURNS,
    ),
    "parts": Study(
        [task("NoisyRoom", HALVED)],
        DEFAULT | {part: {"bonus_parts": {part: 1.0}} for part in PARTS},
        columns=NOISE,
        measure=measure_noise,
    ),
    "noise": Study(
        [task("NoisyRoom", HALVED)],
        DEFAULT
        | {"nothing forgotten": LASTING}
        | {name: {"bonus": name} for name in NOISE_BASELINES},
        columns=NOISE,
        measure=measure_noise,
    ),
    "marginal": Study(
        [MAZE_HALVED],
        {
            "default": {},
            "half-life of 2 episodes": {"marginal_half_life": 2.0},
            "half-life of 50 episodes": {"marginal_half_life": 50.0},
            "nothing forgotten": LASTING,
            "256 components": {"components": 256},
            "bandwidth 0.1": {"bandwidth": 0.1},
            "perplexity": {"bandwidth": "perplexity"},
            "moments": {"whitening": "moments"},
            "robust": {"whitening": "robust"},
            "position": {"features": (0, 1)},
        },
        columns=("coverage", "evaluation_return"),
    ),
    "frame_stack": Study(
        [task("PendulumHiddenVelocity", SMALL, total_steps=30_000, **COST)],
        {"1 frame": {"frame_stack": 1}, "4 frames": {"frame_stack": 4}},
        columns=RETURNS,
    ),
    "prior": Study(
        [
            task("PendulumSwingup", HALVED, **COST),
            task("MountainCarContinuous-v0", HALVED),
            MOTORS,
            task("HalfCheetah-v5", HALVED),
        ],
        {prior: {"prior": prior} for prior in ("uniform", "learned")},
        columns=AREA,
        measure=measure_area,
    ),
    "motors": Study(
        [MOTORS],
        {
            "uniform": {"prior": "uniform"},
            "learned": {},
            "learned, 4 nats": {"target_information_rate": 4.0},
            "learned, 2 nats": {"target_information_rate": 2.0},
            "uniform, 4 nats": {"prior": "uniform", "target_information_rate": 4.0},
            "uniform, 2 nats": {"prior": "uniform", "target_information_rate": 2.0},
            "learned, fixed price": {"temperature": "constant:0.02"},
        },
        columns=AREA,
        measure=measure_area,
    ),
    "default": Study(
        [task("HalfCheetah-v5", WIDE), HOPPER], DENSE_AGENTS, columns=AREA, measure=measure_area
    ),
    "hopper": Study(
        [HOPPER],
        DENSE_AGENTS
        | {
            "weight 0.03": {"bonus_weight": 0.03},
            "past the end": PAST_THE_END,
            "constant bonus": {"bonus": "constant"},
        },
        columns=AREA,
        measure=measure_area,
    ),
    "ends": Study(
        [HOPPER],
        PLAIN_AND_DEFAULT | {"past the end": PAST_THE_END},
        seeds=10,
        columns=AREA,
        measure=measure_area,
    ),
    "horizon": Study(
        [PENDULUM_FULL, MAZE_HALVED],
        {discount: {"curiosity_discount": discount} for discount in (0.0, 0.5, 0.9, 0.97, 0.99)},
        label="curiosity discount",
        columns=(*RETURNS, "coverage"),
    ),
    "battery": Study(
        [task("BatteryRover", HALVED, total_steps=24_000)],
        {
            "purely curious": {"hunger": "conditioned:0.0"},
            "battery": {"hunger": "battery"},
            "purely greedy": {"hunger": "conditioned:1.0"},
        },
        columns=("starved", "coverage", "mean_training_return"),
        measure=measure_survival,
    ),
}
