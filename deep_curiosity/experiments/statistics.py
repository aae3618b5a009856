"""Many agents on several tasks: a table and a picture with confidence intervals."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deep_curiosity.experiments.grid import Task, markdown_table

DRAWS = 10_000  # of the bootstrap
LEVEL = 0.95
Interval = tuple[float, float, float]
"""A mean and the ends of its confidence interval."""


def bootstrap(groups: Sequence[Sequence[float]], *, seed: int = 0) -> Interval:
    """Mean over groups of their means, and its 95 % interval by drawing runs anew in each group.

    Args:
        groups: Values of one agent's runs, a group for each task, so that no draw misses a task.
        seed: Of the draws.

    Reference: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical
    Precipice" (2021), https://arxiv.org/abs/2108.13264; section 4.1.
    """
    random = np.random.default_rng(seed)
    means = [
        np.take(group, random.integers(len(group), size=(DRAWS, len(group)))).mean(1)
        for group in groups
    ]
    low, high = np.quantile(np.mean(means, axis=0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(np.mean([np.mean(group) for group in groups])), float(low), float(high)


def compare(tasks: Sequence[Task], rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown table: for each agent the share of runs that solve, and the return on each task."""
    names = [task.name for task in tasks]
    header = ["agent", "runs solved", *(f"{name}: return, solved" for name in names)]
    lines = []
    for agent in _by_solved(tasks, rows):
        solved = [_values(rows, name, agent, "solved") for name in names]
        cells = [
            f"{_shown(bootstrap([_values(rows, name, agent, 'evaluation_return')]), '.3g')}, "
            f"{sum(own):.0f} of {len(own)}"
            for name, own in zip(names, solved, strict=True)
        ]
        lines.append([agent, _shown(bootstrap(solved), ".0%"), *cells])
    return markdown_table(header, lines) + "\n"


def draw_comparison(path: Path, tasks: Sequence[Task], rows: Sequence[Mapping[str, Any]]) -> None:
    """One panel for the share of runs that solve, and one for the returns on each task."""
    agents = _by_solved(tasks, rows)[::-1]
    figure = Figure(figsize=(3.4 * (len(tasks) + 1), 0.7 + 0.38 * len(agents)), layout="tight")
    overall, *panels = figure.subplots(1, len(tasks) + 1, sharey=True)
    solved = [[_values(rows, task.name, agent, "solved") for task in tasks] for agent in agents]
    _draw_intervals(overall, [bootstrap(groups) for groups in solved])
    overall.set(title="share of runs that solve", xlim=(-0.03, 1.03))
    overall.set_yticks(range(len(agents)), agents)
    for axes, task in zip(panels, tasks, strict=True):
        returns = [_values(rows, task.name, agent, "evaluation_return") for agent in agents]
        _draw_intervals(axes, [bootstrap([own]) for own in returns])
        for place, own in enumerate(returns):
            axes.plot(own, np.full(len(own), place), ".", color="grey", alpha=0.5)
        axes.axvline(task.solved_return, color="grey", linestyle=":")
        axes.set(title=task.name, xlabel="evaluation return")
    figure.savefig(path, dpi=120)


def _by_solved(tasks: Sequence[Task], rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Agents in the order of the share of runs that solve, the best first."""
    agents = list(dict.fromkeys(row["agent"] for row in rows))
    shares = {
        agent: np.mean([np.mean(_values(rows, task.name, agent, "solved")) for task in tasks])
        for agent in agents
    }
    return sorted(agents, key=lambda agent: -shares[agent])


def _draw_intervals(axes: Axes, intervals: Sequence[Interval]) -> None:
    mean, low, high = np.array(intervals).T
    place = np.arange(len(mean))
    axes.hlines(place, low, high, color="tab:blue", linewidth=3, alpha=0.5)
    axes.plot(mean, place, "o", color="tab:blue")
    axes.grid(axis="x", alpha=0.3)


def _values(rows: Sequence[Mapping[str, Any]], task: str, agent: str, column: str) -> list[float]:
    return [float(row[column]) for row in rows if (row["task"], row["agent"]) == (task, agent)]


def _shown(interval: Interval, number_format: str) -> str:
    mean, low, high = (format(value, number_format) for value in interval)
    return f"{mean} [{low}, {high}]"
