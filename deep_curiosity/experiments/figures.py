"""Figures of studies: learning curves, and what was measured, with intervals over seeds."""

import math
import textwrap
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deep_curiosity.experiments.statistics import Estimate, bootstrap
from deep_curiosity.experiments.study import Row, Study
from deep_curiosity.experiments.tables import (
    REACHED,
    is_missing,
    known_values,
    one_for_each_run,
    select,
)

PANELS_PER_ROW = 3
LABEL_GAP = 0.06  # of the height of a panel, for a line of the labels beside the curves
LABEL_WIDTH = 24  # letters, beyond which a label goes on in the next line


def plain(text: str) -> str:
    """A name as it is written, in which a figure would read dollars as mathematics."""
    return text.replace("$", r"\$")


def evaluated(curves: Sequence[Row]) -> list[Row]:
    """The evaluations that have a return."""
    return [row for row in curves if not is_missing(row["evaluation_return"])]


def plot_curves(path: Path, study: Study, rows: Sequence[Row], curves: Sequence[Row]) -> None:
    """A panel for each task: interquartile mean of every agent, and its 95 % interval."""
    curves = evaluated(curves)
    num_columns = min(len(study.tasks), PANELS_PER_ROW)
    num_rows = math.ceil(len(study.tasks) / num_columns)
    figure = Figure(figsize=(5.6 * num_columns, 3.9 * num_rows), layout="constrained")
    for panel, task in enumerate(study.tasks, 1):
        axes = figure.add_subplot(num_rows, num_columns, panel)
        ends = {}
        for number, agent in enumerate(study.agents):
            solved = select(rows, "solved", **{"task": task.name, study.label: agent})
            own = [row for row in curves if (row["task"], row[study.label]) == (task.name, agent)]
            if own:
                counted = "" if "" in solved else f" ({sum(solved)}/{len(solved)})"
                steps, estimates = estimate_curve(own, "evaluation_return")
                draw_curve(axes, steps, estimates, f"C{number}")
                ends[f"{agent}{counted}", f"C{number}"] = estimates[-1].value
        if task.solved_return == task.solved_return:
            axes.axhline(task.solved_return, color="grey", linestyle=":", linewidth=1)
        axes.set(title=plain(task.name), xlabel="environment steps", ylabel="evaluation return")
        axes.locator_params(axis="x", nbins=5)
        label_beside(axes, ends)
    figure.savefig(path, dpi=120)


def estimate_curve(own: Sequence[Row], column: str) -> tuple[list[int], list[Estimate]]:
    """Interquartile mean of a column over the rows of each step, with its 95 % interval."""
    values = defaultdict(list)
    for row in own:
        values[row["step"]].append(row[column])
    steps = sorted(values)
    return steps, [bootstrap([values[step]]) for step in steps]


def draw_curve(
    axes: Axes, steps: Sequence[int], estimates: Sequence[Estimate], color: str
) -> None:
    """Draw a curve and its interval."""
    value, low, high = np.array(estimates).T
    axes.plot(steps, value, ".-", color=color, markersize=4)
    axes.fill_between(steps, low, high, color=color, alpha=0.15, linewidth=0)
    if len(steps) == 1:
        axes.vlines(steps, low, high, color=color, alpha=0.5)


def label_beside(axes: Axes, ends: dict[tuple[str, str], float]) -> None:
    """Names beside the ends of the curves, in their colours, none upon another or the title."""
    low, high = axes.get_ylim()
    ordered = sorted(ends.items(), key=lambda item: item[1])
    labels = [textwrap.wrap(name, LABEL_WIDTH) for (name, _), _ in ordered]
    halves = [LABEL_GAP * len(lines) / 2 for lines in labels]
    places = _spread([(end - low) / (high - low) for _, end in ordered], halves)
    for ((_, color), _), lines, place in zip(ordered, labels, places, strict=True):
        axes.annotate(
            plain("\n".join(lines)),
            (1.02, place),
            xycoords="axes fraction",
            color=color,
            va="center",
            fontsize=9,
        )


def _spread(wanted: Sequence[float], halves: Sequence[float]) -> list[float]:
    """Places of labels that are neither upon another nor past the top, near those wanted.

    Args:
        wanted: Rising, in heights of the axes.
        halves: Half of the height of each label.
    """
    places, free = [], -np.inf
    for place, half in zip(wanted, halves, strict=True):
        places.append(max(place, free + half))
        free = places[-1] + half
    free = 1.0
    for number in reversed(range(len(places))):
        places[number] = min(places[number], free - halves[number])
        free = places[number] - halves[number]
    return places


def plot_columns(path: Path, study: Study, rows: Sequence[Row]) -> None:
    """A panel for each task and column: interquartile mean, its 95 % interval, and every run."""
    height = 1.0 + 0.34 * len(study.agents) if _is_named(study) else 3.2
    size = 4.4 * len(study.columns), height * len(study.tasks)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(study.tasks), len(study.columns), squeeze=False)
    for line, task in zip(panels, study.tasks, strict=True):
        for axes, column in zip(line, study.columns, strict=True):
            own = [row for row in rows if row["task"] == task.name]
            axes.set_title(plain(task.name), fontsize=10)
            _plot_column(axes, study, own, column)
    figure.savefig(path, dpi=120)


class Measured(NamedTuple):
    """What a panel shows of an agent."""

    agent: str | float
    label: str
    values: list[float]
    """Of all rows, dots."""
    estimate: Estimate


def _plot_column(axes: Axes, study: Study, own: Sequence[Row], column: str) -> None:
    """Agents beneath each other where they have names, along an axis where they are numbers."""
    measured = [
        _measure(agent, column, runs, one_for_each_run(study, runs))
        for agent in study.agents
        for runs in [[row for row in own if row[study.label] == agent]]
        if known_values(runs, column)
    ]
    title = plain(column.replace("_", " "))
    if _is_named(study):
        _plot_intervals(axes, measured)
        axes.set_yticks(range(len(measured)), [plain(each.label) for each in measured])
        axes.invert_yaxis()
        axes.set_xlabel(title)
        return
    measured.sort()  # by the agent, a number
    for each in measured:
        axes.plot([each.agent] * len(each.values), each.values, ".", color="grey", alpha=0.6)
    if measured:
        value, low, high = np.array([each.estimate for each in measured]).T
        agents = [each.agent for each in measured]
        axes.plot(agents, value, "o-")
        axes.fill_between(agents, low, high, alpha=0.15, linewidth=0)
    axes.set(xlabel=plain(study.label), ylabel=title)


def _measure(
    agent: str | float, column: str, rows: Sequence[Row], runs: Sequence[Row]
) -> Measured:
    """What there is of an agent: its rows, of which a run may have several, and one of each run.

    Of what some runs never reach, those that do have no mean: an agent that seldom does would
    have the best one.
    """
    known = known_values(runs, column)
    is_complete = len(known) == len(runs)
    has_mean = is_complete or column not in REACHED
    return Measured(
        agent,
        f"{agent}" if is_complete else f"{agent}, {len(known)} of {len(runs)}",
        known_values(rows, column),
        bootstrap([known]) if has_mean else Estimate(math.nan, math.nan, math.nan),
    )


def _plot_intervals(axes: Axes, measured: Sequence[Measured]) -> None:
    for place, (_, _, runs, estimate) in enumerate(measured):
        axes.plot(runs, [place] * len(runs), ".", color="grey", alpha=0.6)
        axes.hlines(place, estimate.low, estimate.high, color="C0", linewidth=3, alpha=0.5)
        axes.plot(estimate.value, place, "o", color="C0")
    axes.grid(axis="x", alpha=0.3)


def _is_named(study: Study) -> bool:
    return any(isinstance(agent, str) for agent in study.agents)


def plot_search(path: Path, scores: Sequence[float], importances: Mapping[str, float]) -> None:
    """Two panels of a search: score of each trial and the best so far; weight of each setting.

    Args:
        path: Of the figure.
        scores: Of the trials; NaN where one has none to be shown.
        importances: Weight of each setting.
    """
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    history, weights = figure.subplots(1, 2)
    known = np.array(scores, dtype=float)
    history.plot(known, "o", color="C0", markersize=4, label="trial")
    history.step(range(len(known)), np.fmax.accumulate(known), where="post", label="best so far")
    history.set(xlabel="trial", ylabel="score", title="History")
    history.legend()
    names = sorted(importances, key=lambda name: importances[name])
    weights.barh(names, [importances[name] for name in names])
    weights.set(xlabel="share of the differences of score", title="Importance")
    figure.savefig(path, dpi=120)
