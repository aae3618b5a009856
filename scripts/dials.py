"""What each dial of the agent does: runs along the dial, a table of them and a picture."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from deep_curiosity.bonuses.decomposition import PARTS
from deep_curiosity.training import Settings
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collector import Collector, Episode, as_batch
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.playback import load_agent
from deep_curiosity.training.log import read_progress
from deep_curiosity.experiments.grid import (
    EVALUATION_TAG,
    markdown_table,
    median_and_range,
    find_finished,
    run_once,
    write_table,
)
from deep_curiosity_envs import NoisyRoom
from deep_curiosity_envs.pendulum import SPEED_BOUND
from deep_curiosity_envs.point_room import CELLS_PER_SIDE

Row = dict[str, Any]
HUNGERS = [tenth / 10 for tenth in range(11)]
SWEPT_EPISODES = 10
LAST_EPISODES = 20
NAMES_TILT = 20  # degrees, so that long names do not run into each other
GRID = (24, 16)  # cells of the pendulum's angle and speed

SMALL = Settings(hidden_dim=64, log_interval=500, evaluation_interval=2_000)
PENDULUM = replace(SMALL, env_id="PendulumSwingup", env_kwargs={"action_cost": 0.1})
CHEETAH = replace(SMALL, env_id="HalfCheetah-v5")
HALVED = {"update_to_data": 0.5}
WIDE = {"hidden_dim": 128, "total_steps": 30_000, "evaluation_interval": 1_500}
NOISY_ROOM = {"NoisyRoom": replace(SMALL, env_id="NoisyRoom", total_steps=16_000, **HALVED)}
HOPPER = replace(SMALL, env_id="Hopper-v5", **WIDE)
FADING = {"marginal_horizon": 2_000, "marginal_forgetting": "exponential"}
PAST_THE_END = {"curiosity_episodic": False}
PLAIN_AND_DEFAULT = {"plain": {"bonus": "none"}, "default": {}}
DENSE_AGENTS = PLAIN_AND_DEFAULT | {"bandit": {"hunger_control": "bandit"}}
MOTORS = replace(PENDULUM, env_id="ManyMotors", total_steps=16_000, **HALVED)
NOISE_CHANNELS = slice(4, 6)  # of NoisyRoom's observation
PHASE = 4_000  # steps at either end of a run, whose cells are counted by themselves
NOISE_RIVALS = ("rnd", "icm", "nearest-neighbours", "none")


@dataclass(frozen=True)
class Dial:
    """Runs along a dial, and what is read off each.

    Args:
        settings: Name of each task to the settings of its runs.
        places: Where the dial is put, to the settings that put it there.
        measure: From the settings of a run, which it sees to, to rows of `columns`.
        columns: What is measured; each is drawn against `x`.
        x: Column along which the picture goes: the place, or one that is measured.
    """

    settings: Mapping[str, Settings]
    places: Mapping[float | str, Mapping[str, Any]]
    measure: Callable[[Settings], list[Row]]
    columns: Sequence[str]
    x: str


def measure_rate(settings: Settings) -> list[Row]:
    """Information of the actions over the last third of a run, as held and as checked."""
    summary = run_once(settings)
    begun = settings.total_steps * 2 / 3
    late = [row for row in read_progress(settings.out) if float(row["step"]) > begun]

    def mean(tag: str) -> float:
        return float(np.mean([float(row[tag]) for row in late]))

    return [
        {
            "rate": mean("agent/information_rate"),
            "lower": mean("agent/action_information_lower"),
            "upper": mean("agent/action_information_upper"),
            "return": summary["evaluation_return"],
        }
    ]


def measure_return(settings: Settings) -> list[Row]:
    """Return of a run's last evaluation, and coverage where the task has cells."""
    summary = run_once(settings)
    coverage = math.nan if summary["coverage"] is None else summary["coverage"]
    return [
        {
            "return": summary["evaluation_return"],
            "mean_training_return": summary["mean_training_return"],
            "coverage": coverage,
        }
    ]


def measure_area(settings: Settings) -> list[Row]:
    """Mean return over all evaluations of a run, the area under its curve, and the last one."""
    summary = run_once(settings)
    evaluations = {
        float(row["step"]): float(row[EVALUATION_TAG])
        for row in read_progress(settings.out)
        if float(row["step"]) % settings.evaluation_interval == 0
    }
    return [
        {
            "area": float(np.mean(list(evaluations.values()))),
            "return": summary["evaluation_return"],
        }
    ]


def measure_noise(settings: Settings) -> list[Row]:
    """Share of cells visited, and time where there is noise, in units of a uniform walk's."""
    summary = run_once(settings)
    rows = load_checkpoint(settings.out)["learner"]["replay"]["rows"]
    noise = rows[settings.learning_starts :, NOISE_CHANNELS]
    noisy = float((noise != 0).any(-1).double().mean())
    return [
        {
            "noisy_time": noisy / NoisyRoom.noisy_share,
            "early_coverage": cell_share(rows[:PHASE]),
            "late_coverage": cell_share(rows[-PHASE:]),
            "coverage": summary["coverage"],
        },
    ]


def measure_sweep(settings: Settings) -> list[Row]:
    """Return of a dialled agent that acts as in training, and cells it visits, at each hunger."""
    run_once(settings)
    environment = make_environment(settings.env_id, settings.env_kwargs, history=settings.history)
    agent = load_agent(settings.out, settings, environment)
    torch.manual_seed(settings.seed)
    rows = []
    for hunger in HUNGERS:
        agent.hunger = hunger
        collector = Collector(environment, seed=settings.seed)
        returns, cells = [], set()
        while len(returns) < SWEPT_EPISODES:
            step, finished = collector.step(agent.act(as_batch(collector.observation))[0].numpy())
            cells.add(pendulum_cell(step.next_observation))
            returns += [episode.episode_return for episode in finished]
        rows.append(
            {
                "hunger": hunger,
                "return": float(np.mean(returns)),
                "coverage": len(cells) / math.prod(GRID),
            }
        )
    environment.close()
    return rows


def measure_survival(settings: Settings) -> list[Row]:
    """How many of a run's last episodes ended with an empty battery, and cells seen in them."""
    summary = run_once(settings)
    state = load_checkpoint(settings.out)
    episodes = [Episode(*values) for values in state["history"]["episodes"][-LAST_EPISODES:]]
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


DIALS = {
    "rate": Dial(
        {
            "PendulumSwingup": replace(PENDULUM, prior="learned", update_to_data=0.5),
            "HalfCheetah-v5": replace(CHEETAH, prior="learned", update_to_data=0.5),
        },
        {rate: {"target_information_rate": rate} for rate in (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)},
        measure_rate,
        ("rate", "lower", "upper", "return"),
        x="target rate",
    ),
    "hunger": Dial(
        {"PendulumSwingup": replace(PENDULUM, total_steps=16_000)},
        {"draws": {"hunger_control": "draws"}},
        measure_sweep,
        ("return", "coverage"),
        x="hunger",
    ),
    "alpha": Dial(
        {"PendulumSwingup": replace(PENDULUM, total_steps=16_000)},
        {hunger: {"hunger": hunger} for hunger in (0.3, 1.0, 3.0, 10.0)},
        measure_return,
        ("return", "mean_training_return"),
        x="hunger",
    ),
    "parts": Dial(
        NOISY_ROOM,
        {"D": {}} | {part: {"bonus_parts": {part: 1.0}} for part in PARTS},
        measure_noise,
        ("noisy_time", "early_coverage", "late_coverage", "coverage"),
        x="part of D",
    ),
    "marginal": Dial(
        {"PointMaze": replace(SMALL, env_id="PointMaze", total_steps=16_000, **HALVED)},
        {
            "default": {},
            "newest 2000": {"marginal_horizon": 2_000},
            "half-life 2000": FADING,
            "bandwidth 0.1": {"bandwidth": 0.1},
            "perplexity": {"bandwidth": "perplexity"},
            "robust": {"whitening": "robust"},
            "position": {"features": (0, 1)},
        },
        measure_return,
        ("coverage", "return"),
        x="marginal",
    ),
    "noise": Dial(
        NOISY_ROOM,
        {"curiosity": {}, "fading": FADING} | {name: {"bonus": name} for name in NOISE_RIVALS},
        measure_noise,
        ("noisy_time", "early_coverage", "late_coverage", "coverage"),
        x="bonus",
    ),
    "history": Dial(
        {
            "PendulumHiddenVelocity": replace(
                PENDULUM, env_id="PendulumHiddenVelocity", total_steps=30_000
            )
        },
        {history: {"history": history} for history in (1, 4)},
        measure_return,
        ("return", "mean_training_return"),
        x="history",
    ),
    "prior": Dial(
        {
            "PendulumSwingup": replace(PENDULUM, total_steps=16_000, **HALVED),
            "MountainCarContinuous-v0": replace(
                SMALL, env_id="MountainCarContinuous-v0", total_steps=16_000, **HALVED
            ),
            "ManyMotors": MOTORS,
            "HalfCheetah-v5": replace(CHEETAH, total_steps=16_000, **HALVED),
        },
        {prior: {"prior": prior} for prior in ("uniform", "learned")},
        measure_area,
        ("area", "return"),
        x="prior",
    ),
    "motors": Dial(
        {"ManyMotors": MOTORS},
        {
            "uniform": {},
            "learned": {"prior": "learned"},
            "learned, 4 nats": {"prior": "learned", "target_information_rate": 4.0},
            "learned, 2 nats": {"prior": "learned", "target_information_rate": 2.0},
            "learned, fixed price": {"prior": "learned", "temperature_control": "constant"},
        },
        measure_area,
        ("area", "return"),
        x="prior",
    ),
    "default": Dial(
        {
            "HalfCheetah-v5": replace(CHEETAH, **WIDE),
            "Hopper-v5": HOPPER,
        },
        DENSE_AGENTS,
        measure_area,
        ("area", "return"),
        x="agent",
    ),
    "hopper": Dial(
        {"Hopper-v5": HOPPER},
        DENSE_AGENTS
        | {
            "weight 0.03": {"bonus_weight": 0.03},
            "past the end": PAST_THE_END,
            "constant bonus": {"bonus": "constant"},
        },
        measure_area,
        ("area", "return"),
        x="agent",
    ),
    "ends": Dial(
        {"Hopper-v5": HOPPER},
        PLAIN_AND_DEFAULT | {"past the end": PAST_THE_END},
        measure_area,
        ("area", "return"),
        x="agent",
    ),
    "horizon": Dial(
        {
            "PendulumSwingup": replace(PENDULUM, total_steps=16_000),
            "PointMaze": replace(SMALL, env_id="PointMaze", total_steps=16_000, **HALVED),
        },
        {discount: {"curiosity_discount": discount} for discount in (0.0, 0.5, 0.9, 0.97, 0.99)},
        measure_return,
        ("return", "mean_training_return", "coverage"),
        x="curiosity discount",
    ),
    "battery": Dial(
        {"BatteryRover": replace(SMALL, env_id="BatteryRover", total_steps=24_000, **HALVED)},
        {
            "purely curious": {"hunger_control": "dial", "hunger": 0.0},
            "battery": {"hunger_control": "battery"},
            "purely greedy": {"hunger_control": "dial", "hunger": 1.0},
        },
        measure_survival,
        ("starved", "coverage", "mean_training_return"),
        x="who turns the dial",
    ),
}


@dataclass(frozen=True)
class Args:
    """Which dial, and where."""

    dial: Literal[
        "rate",
        "hunger",
        "alpha",
        "battery",
        "noise",
        "parts",
        "marginal",
        "history",
        "prior",
        "motors",
        "default",
        "hopper",
        "ends",
        "horizon",
    ]
    """Information rate that the temperature holds; hunger of one agent that has learned them all;
    agents of one hunger each; a dial turned by a battery; bonuses beside a source of noise; parts
    of curiosity there; how the marginal is formed; windows of a hidden state; uniform or learned
    prior; the same at other rates where there are many motors; plain, default and bandit where
    reward is dense; what else was tried on Hopper-v5; curiosity that looks past the end of the
    world, or does not; how far it looks ahead."""
    tasks: tuple[str, ...] = ()
    """Of those the dial is turned on; all by default. The names of the files tell which."""
    seeds: int = 5
    """Runs at each value."""
    runs: Path = Path("runs/dials")
    """Folder for the runs; finished ones there are not run again, whichever dial they were for."""
    out: Path = Path("docs/dials")
    """Folder for table, summary and picture."""
    workers: int = 2
    """Processes at a time."""


def main() -> None:
    """Turn a dial and print what it does."""
    args = tyro.cli(Args, description=__doc__)
    dial = chosen(DIALS[args.dial], args.tasks)
    cells = [
        (task, place, seed)
        for seed in range(args.seeds)
        for task in dial.settings
        for place in dial.places
    ]
    jobs = [
        replace(
            dial.settings[task],
            **dial.places[place],
            seed=seed,
            out=args.runs / args.dial / task / f"{place}" / f"seed{seed}",
        )
        for task, place, seed in cells
    ]
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        measured = list(pool.map(dial.measure, find_finished(jobs, args.runs)))
    rows = [
        {"task": task, dial.x: place, "seed": seed} | row
        for (task, place, seed), own in zip(cells, measured, strict=True)
        for row in own
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    out = args.out / "-".join((args.dial, *args.tasks))
    write_table(out.with_suffix(".csv"), list(rows[0]), rows)
    summary = summary_of(dial, rows)
    out.with_suffix(".md").write_text(summary)
    draw(out.with_suffix(".png"), dial, rows)
    print(summary)


def chosen(dial: Dial, tasks: Sequence[str]) -> Dial:
    """The dial on some of its tasks.

    Raises:
        ValueError: If it is not turned on one of them.
    """
    for task in tasks:
        if task not in dial.settings:
            raise ValueError(f"`tasks` must be among {', '.join(dial.settings)}, got {task!r}.")
    return replace(dial, settings={task: dial.settings[task] for task in tasks or dial.settings})


def summary_of(dial: Dial, rows: Sequence[Row]) -> str:
    """Markdown: median and range over seeds at each value, and whether the dial is monotone."""
    header = ["task", dial.x, *dial.columns]
    lines = []
    for task in dial.settings:
        for place in _places(dial, rows):
            own = [row for row in rows if row["task"] == task and row[dial.x] == place]
            values = [[row[name] for row in own] for name in dial.columns]
            spreads = ["" if np.isnan(each).all() else median_and_range(each) for each in values]
            lines.append([task, f"{place}", *spreads])
    return "\n".join([markdown_table(header, lines) + "\n", *_rank_correlations(dial, rows)])


def _rank_correlations(dial: Dial, rows: Sequence[Row]) -> list[str]:
    """Spearman's correlation of each column's medians with the dial, where it has a scale."""
    places = _places(dial, rows)
    if isinstance(places[0], str):
        return []
    lines = []
    for task in dial.settings:
        for name in dial.columns:
            medians = _medians(dial, rows, task, name)
            if np.isfinite(medians).all():
                rank = spearmanr(places, medians).statistic
                lines.append(f"- {task}: rank correlation of {name} with {dial.x} {rank:.2f}")
    return [*lines, ""]


def _places(dial: Dial, rows: Sequence[Row]) -> list[float | str]:
    """Where the dial was put, from one end to the other."""
    return list(dict.fromkeys(row[dial.x] for row in rows))


def _medians(dial: Dial, rows: Sequence[Row], task: str, name: str) -> np.ndarray:
    """Median over seeds of a column at each place."""
    return np.array(
        [
            np.median([row[name] for row in rows if (row["task"], row[dial.x]) == (task, place)])
            for place in _places(dial, rows)
        ]
    )


def draw(path: Path, dial: Dial, rows: Sequence[Row]) -> None:
    """A panel for each task and column: median over seeds, every run a dot."""
    size = 4.2 * len(dial.columns), 3.4 * len(dial.settings)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(dial.settings), len(dial.columns), squeeze=False)
    for line, task in zip(panels, dial.settings, strict=True):
        for axes, name in zip(line, dial.columns, strict=True):
            _draw_panel(axes, dial, rows, task, name)
    figure.savefig(path, dpi=120)


def _draw_panel(axes: Axes, dial: Dial, rows: Sequence[Row], task: str, name: str) -> None:
    own = [row for row in rows if row["task"] == task]
    if all(np.isnan(row[name]) for row in own):
        axes.set_axis_off()
        return
    places = _places(dial, rows)
    named = isinstance(places[0], str)
    axes.plot(places, _medians(dial, rows, task, name), "o" if named else "o-")
    axes.plot([row[dial.x] for row in own], [row[name] for row in own], ".", color="grey")
    if name in ("rate", "lower", "upper"):
        axes.plot(places, places, ":", color="grey", label="target")
        axes.legend(fontsize=8)
    axes.set(title=task, xlabel=dial.x, ylabel=name.replace("_", " "))
    if named:
        axes.tick_params("x", rotation=NAMES_TILT)


if __name__ == "__main__":
    main()
