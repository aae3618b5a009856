"""What each dial of the agent does: runs along the dial, a table of them and a picture."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from deep_curiosity.training import Settings
from deep_curiosity.training.collection import Collector, as_batch
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.playback import load_agent
from deep_curiosity.training.records import read_progress
from deep_curiosity.training.study import median_and_range, run_once, write_table

Row = dict[str, Any]
HUNGERS = np.linspace(0, 1, 11).tolist()
SWEPT_EPISODES = 10
GRID = (24, 16)  # cells of the pendulum's angle and speed

SMALL = Settings(hidden_dim=64, log_interval=500, evaluation_interval=2_000)
PENDULUM = replace(SMALL, env_id="PendulumSwingup", env_kwargs={"action_cost": 0.1})
MAZE = replace(SMALL, env_id="PointMaze", total_steps=16_000)
CHEETAH = replace(SMALL, env_id="HalfCheetah-v5")


@dataclass(frozen=True)
class Dial:
    """Runs along a dial, and what is read off each.

    Args:
        settings: Name of each task to the settings of its runs.
        name: Setting that is the dial; a run for each of its values.
        values: Of the dial.
        measure: From the settings of a run, which it sees to, to rows of `columns`.
        columns: What is measured; each is drawn against `x`.
        x: Column along which the picture goes.
    """

    settings: Mapping[str, Settings]
    name: str
    values: Sequence[Any]
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


def measure_sweep(settings: Settings) -> list[Row]:
    """Return of a dialled agent that acts as in training, and cells it visits, at each hunger."""
    run_once(settings)
    environment = make_environment(settings.env_id, settings.env_kwargs)
    agent = load_agent(settings.out, settings, environment)
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


def pendulum_cell(observation: np.ndarray) -> tuple[int, int]:
    """Cell of the pendulum's angle and speed that an observation lies in."""
    cosine, sine, speed = observation
    angle = math.atan2(sine, cosine) / (2 * math.pi) + 0.5
    place = np.clip((angle, 0.5 * (1 + speed)), 0, 1 - 1e-9) * GRID
    return int(place[0]), int(place[1])


DIALS = {
    "rate": Dial(
        {
            "PendulumSwingup": replace(PENDULUM, prior="learned", update_to_data=0.5),
            "HalfCheetah-v5": replace(CHEETAH, prior="learned", update_to_data=0.5),
        },
        "target_information_rate",
        (0.5, 1.0, 2.0, 4.0),
        measure_rate,
        ("rate", "lower", "upper", "return"),
        x="target_information_rate",
    ),
    "hunger": Dial(
        {"PendulumSwingup": replace(PENDULUM, total_steps=16_000)},
        "hunger_control",
        ("draws",),
        measure_sweep,
        ("return", "coverage"),
        x="hunger",
    ),
    "horizon": Dial(
        {"PendulumSwingup": replace(PENDULUM, total_steps=16_000), "PointMaze": MAZE},
        "curiosity_discount",
        (0.0, 0.5, 0.9, 0.97, 0.99),
        measure_return,
        ("return", "mean_training_return", "coverage"),
        x="curiosity_discount",
    ),
}


@dataclass(frozen=True)
class Args:
    """Which dial, and where."""

    dial: Literal["rate", "hunger", "horizon"]
    """Information rate that the temperature holds; hunger of one agent that has learned them all;
    how far curiosity looks ahead."""
    seeds: int = 5
    """Runs at each value."""
    runs: Path = Path("runs/dials")
    """Folder for the runs; finished ones there are not run again."""
    out: Path = Path("docs/dials")
    """Folder for table, summary and picture."""
    workers: int = 2
    """Processes at a time."""


def main() -> None:
    """Turn a dial and print what it does."""
    args = tyro.cli(Args, description=__doc__)
    dial = DIALS[args.dial]
    cells = [
        (task, value, seed)
        for seed in range(args.seeds)
        for task in dial.settings
        for value in dial.values
    ]
    jobs = [
        replace(
            dial.settings[task],
            **{dial.name: value},
            seed=seed,
            out=args.runs / args.dial / task / f"{value}" / f"seed{seed}",
        )
        for task, value, seed in cells
    ]
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        measured = list(pool.map(dial.measure, jobs))
    rows = [
        {"task": task, dial.name: value, "seed": seed} | row
        for (task, value, seed), own in zip(cells, measured, strict=True)
        for row in own
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    write_table(args.out / f"{args.dial}.csv", list(rows[0]), rows)
    summary = summary_of(dial, rows)
    (args.out / f"{args.dial}.md").write_text(summary)
    draw(args.out / f"{args.dial}.png", dial, rows)
    print(summary)


def summary_of(dial: Dial, rows: Sequence[Row]) -> str:
    """Markdown: median and range over seeds at each value, and whether the dial is monotone."""
    header = ["task", dial.x, *dial.columns]
    lines = [header, ["---"] * len(header)]
    for task in dial.settings:
        for value in sorted({row[dial.x] for row in rows}):
            own = [row for row in rows if row["task"] == task and row[dial.x] == value]
            spreads = [median_and_range([row[name] for row in own]) for name in dial.columns]
            lines.append([task, f"{value:g}", *spreads])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
    return table + "\n" + "\n".join(_rank_correlations(dial, rows)) + "\n"


def _rank_correlations(dial: Dial, rows: Sequence[Row]) -> list[str]:
    """Spearman's correlation of each column's medians with the dial."""
    lines = []
    for task in dial.settings:
        values, medians = _medians(dial, rows, task)
        for name, column in medians.items():
            if np.isfinite(column).all():
                correlation = spearmanr(values, column).statistic
                lines.append(
                    f"- {task}: rank correlation of {name} with {dial.x} {correlation:.2f}"
                )
    return lines


def _medians(
    dial: Dial, rows: Sequence[Row], task: str
) -> tuple[list[float], dict[str, np.ndarray]]:
    values = sorted({row[dial.x] for row in rows})
    medians = {
        name: np.array(
            [
                np.median(
                    [row[name] for row in rows if row["task"] == task and row[dial.x] == value]
                )
                for value in values
            ]
        )
        for name in dial.columns
    }
    return values, medians


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
    values, medians = _medians(dial, rows, task)
    axes.plot(values, medians[name], "o-")
    axes.plot([row[dial.x] for row in own], [row[name] for row in own], ".", color="grey")
    if name in ("rate", "lower", "upper"):
        axes.plot(values, values, ":", color="grey", label="target")
        axes.legend(fontsize=8)
    axes.set(title=task, xlabel=dial.x.replace("_", " "), ylabel=name.replace("_", " "))


if __name__ == "__main__":
    main()
