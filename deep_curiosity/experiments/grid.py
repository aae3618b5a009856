"""Studies: many runs side by side, one table and one picture of them."""

import csv
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deep_curiosity.training.loop import train
from deep_curiosity.training.log import CONFIG, SUMMARY, config_key, read_progress
from deep_curiosity.training.config import Settings

RESULT_COLUMNS = (
    "task",
    "agent",
    "seed",
    "solved",
    "evaluation_return",
    "training_return",
    "mean_training_return",
    "success_rate",
    "first_success_step",
    "coverage",
    "total_steps",
    "steps_per_second",
    "wall_seconds",
)
SUMMARIZED = ("evaluation_return", "mean_training_return", "first_success_step")
CURVE_COLUMNS = ("task", "agent", "seed", "step", "evaluation_return")
EVALUATION_TAG = "eval/return"


@dataclass(frozen=True)
class Task:
    """A task of a study, and when it counts as solved.

    Args:
        name: In tables and pictures.
        settings: Of its runs, but for what an agent changes and the seed.
        solved_return: Evaluation return from which a run counts as solved.
    """

    name: str
    settings: Settings
    solved_return: float


def run_study(
    tasks: Sequence[Task],
    agents: Mapping[str, Mapping[str, Any]],
    *,
    seeds: Sequence[int],
    runs: Path,
    out: Path,
    workers: int = 2,
) -> list[dict[str, Any]]:
    """Train every agent on every task with every seed, and write tables, curves and picture.

    A run whose folder holds a summary is not run again; one that was cut off is merge_config. Where a
    folder holds a run of other settings, a FileExistsError names them.

    Args:
        tasks: What is to be learned.
        agents: Name of each agent to the settings it changes.
        seeds: The same for all, so that agents are paired.
        runs: Folder that receives the folders of the runs.
        out: Path without suffix of the table (.csv), the curves (_curves.csv), the summary (.md)
            and the picture (.png).
        workers: Processes at a time.

    Returns:
        One row of `RESULT_COLUMNS` for each run.
    """
    cells = [(task, agent, seed) for seed in seeds for task in tasks for agent in agents]
    folders = [runs / task.name / agent / f"seed{seed}" for task, agent, seed in cells]
    jobs = [
        replace(task.settings, **agents[agent], seed=seed, out=folder)
        for (task, agent, seed), folder in zip(cells, folders, strict=True)
    ]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        summaries = list(pool.map(run_once, jobs))
    rows, curves = [], []
    for (task, agent, seed), folder, summary in zip(cells, folders, summaries, strict=True):
        cell = {"task": task.name, "agent": agent, "seed": seed}
        solved = summary["evaluation_return"] >= task.solved_return
        rows.append(cell | {"solved": int(solved)} | _only(summary, RESULT_COLUMNS[4:]))
        curves += [
            cell | {"step": row["step"], "evaluation_return": row[EVALUATION_TAG]}
            for row in read_progress(folder)
        ]
    out.parent.mkdir(parents=True, exist_ok=True)
    write_table(out.with_suffix(".csv"), RESULT_COLUMNS, rows)
    write_table(out.with_name(f"{out.name}_curves.csv"), CURVE_COLUMNS, curves)
    out.with_suffix(".md").write_text(summarize(rows))
    draw_curves(out.with_suffix(".png"), tasks, list(agents), rows, curves)
    return rows


def summarize(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown table: seeds solved, and median and range over seeds of what counts."""
    header = ["task", "agent", "seeds solved", *(name.replace("_", " ") for name in SUMMARIZED)]
    lines = []
    for task, agent in dict.fromkeys((row["task"], row["agent"]) for row in rows):
        own = [row for row in rows if (row["task"], row["agent"]) == (task, agent)]
        solved = f"{sum(row['solved'] for row in own)} of {len(own)}"
        spreads = [median_and_range([row[name] for row in own]) for name in SUMMARIZED]
        lines.append([task, agent, solved, *spreads])
    return markdown_table(header, lines) + "\n"


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Table in Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *lines))


def median_and_range(values: Sequence[float | int | None]) -> str:
    """`median [lowest, highest]`; a value that is missing counts as never, above all others."""
    known = sorted(math.inf if value is None else float(value) for value in values)
    shown = [_or_never(value) for value in (statistics.median(known), known[0], known[-1])]
    return "{} [{}, {}]".format(*shown)


def _or_never(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "never"


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, numbers to six digits."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([[_short(row[name]) for name in columns] for row in rows])


def draw_curves(
    path: Path,
    tasks: Sequence[Task],
    agents: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    curves: Sequence[Mapping[str, Any]],
) -> None:
    """One panel for each task: median evaluation return of each agent, and the range of seeds."""
    figure = Figure(figsize=(5.2 * len(tasks), 4), layout="constrained")
    for axes, task in zip(figure.subplots(1, len(tasks), squeeze=False)[0], tasks, strict=True):
        for agent in agents:
            own = [row for row in rows if (row["task"], row["agent"]) == (task.name, agent)]
            label = f"{agent} ({sum(row['solved'] for row in own)}/{len(own)} solved)"
            _draw_agent(axes, task.name, agent, label, curves)
        axes.axhline(task.solved_return, color="grey", linestyle=":", label="solved")
        axes.set(title=task.name, xlabel="environment step", ylabel="evaluation return")
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def _draw_agent(
    axes: Axes, task: str, agent: str, label: str, curves: Sequence[Mapping[str, Any]]
) -> None:
    own = [row for row in curves if (row["task"], row["agent"]) == (task, agent)]
    steps = sorted({int(row["step"]) for row in own})
    returns = np.array(
        [[float(r["evaluation_return"]) for r in own if int(r["step"]) == step] for step in steps]
    )
    color = axes.plot(steps, np.median(returns, axis=1), label=label)[0].get_color()
    axes.fill_between(steps, returns.min(1), returns.max(1), color=color, alpha=0.15)


def run_once(settings: Settings) -> dict[str, Any]:
    """Summary of a run: read where it is finished, merge_config or begun where it is not.

    Raises:
        FileExistsError: If the folder holds a run of other settings.
    """
    if not (settings.out / CONFIG).exists():
        return train(settings, show_progress=False)
    there, here = config_key(settings.out), config_key(settings)
    differing = {name for name in there.keys() | here.keys() if there.get(name) != here.get(name)}
    if others := sorted(differing - {"total_steps"}):
        raise FileExistsError(
            f"`out` must hold no run of other settings, got {settings.out}, which differs in "
            f"{', '.join(others)}; move it away or choose another folder."
        )
    path = settings.out / SUMMARY
    if path.exists():
        summary: dict[str, Any] = json.loads(path.read_text())
        if summary["total_steps"] >= settings.total_steps:
            return summary
    return train(replace(settings, resume=settings.out), show_progress=False)


def find_finished(jobs: Sequence[Settings], runs: Path) -> list[Settings]:
    """The same jobs, those that lie somewhere below a folder already in their places there."""
    lying = [(config_key(path.parent), path.parent) for path in sorted(runs.rglob(CONFIG))]

    def place(job: Settings) -> Path:
        own = config_key(job)
        return next((folder for other, folder in lying if other == own), job.out)

    return [replace(job, out=place(job)) for job in jobs]


def _only(values: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    return {name: values[name] for name in names}


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value
