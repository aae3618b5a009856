"""All tasks of a study together, in units of the return that counts as solved.

Reference: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice"
(2021), https://arxiv.org/abs/2108.13264; sections 4.2 and 4.3.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from numbers import Real
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deep_curiosity.experiments.figures import draw_curve, evaluated, label_beside
from deep_curiosity.experiments.statistics import Estimate, Groups, bootstrap
from deep_curiosity.experiments.study import Row, Study, Task
from deep_curiosity.experiments.tables import (
    counted_estimate,
    is_missing,
    markdown_table,
    select,
)

COLUMNS = ("evaluation_return", "area")
"""Of the rows that can be compared between tasks, as far as a study has them."""
SHARES = np.linspace(0, 1, 21)
LEVELS = np.arange(31) / 20  # to 1.5, each rounded as a return that lies on it is


def are_comparable(study: Study) -> bool:
    """Whether a study has several tasks, and says of each which return above zero solves it."""
    returns = [task.solved_return for task in study.tasks]
    are_units = all(0 < each < math.inf for each in returns)
    return study.label == "agent" and len(returns) > 1 and are_units


def is_measured(rows: Sequence[Row], column: str) -> bool:
    """Whether runs have numbers in a column, or nothing, which a study's own measure decides."""
    values = [row.get(column, "") for row in rows]
    are_numbers = all(value is None or isinstance(value, Real) for value in values)
    return are_numbers and not all(map(is_missing, values))


def have_joint_curve(study: Study, rows: Sequence[Row]) -> bool:
    """Whether the runs of an agent at least can be shown together."""
    is_known = is_measured(_of(study, rows), "evaluation_return")
    return are_comparable(study) and is_known and bool(complete_agents(study, rows))


def _of(study: Study, rows: Sequence[Row]) -> list[Row]:
    """The rows of the tasks of a study."""
    tasks = [task.name for task in study.tasks]
    return [row for row in rows if row["task"] in tasks]


def complete_agents(study: Study, rows: Sequence[Row]) -> list[str | float]:
    """The agents that have every seed of each task that any has."""
    seeds = {
        agent: [set(select(rows, "seed", task=task.name, agent=agent)) for task in study.tasks]
        for agent in study.agents
    }
    wanted = [set().union(*own) for own in zip(*seeds.values(), strict=True)]
    return [agent for agent, own in seeds.items() if own == wanted and all(own)]


def groups_of(
    study: Study, rows: Sequence[Row], agent: str | float, column: str, *, normalized: bool = False
) -> Groups:
    """Values of an agent's runs in the order of their seeds, a group for each task.

    If asked, in units of a solved return.
    """
    rows = sorted(rows, key=lambda row: float(row["seed"]))
    return [
        [
            value / task.solved_return if normalized and not is_missing(value) else value
            for value in select(rows, column, task=task.name, agent=agent)
        ]
        for task in study.tasks
    ]


def summarize_together(study: Study, rows: Sequence[Row]) -> list[str]:
    """Markdown: for each agent how much it solved of all tasks, and how well, with intervals."""
    if not are_comparable(study):
        return []
    columns = [column for column in COLUMNS if is_measured(_of(study, rows), column)]
    lines = []
    for agent in complete_agents(study, rows):
        solved = [*chain(*groups_of(study, rows, agent, "solved"))]
        estimates = [
            _estimate(groups_of(study, rows, agent, column, normalized=True)) for column in columns
        ]
        lines.append([str(agent), f"{solved.count(1)} of {len(solved)}", *estimates])
    header = ["all tasks", "runs solved", *(f"{name}, solved is 1" for name in columns)]
    table = [markdown_table([text.replace("_", " ") for text in header], lines), ""]
    return [*(table if lines else []), *_left_out(study, rows)]


def _estimate(groups: Groups) -> str:
    """Interquartile mean of the runs that have a value; nothing where a task has none of them."""
    known = [[value for value in runs if not is_missing(value)] for runs in groups]
    return counted_estimate(known, sum(map(len, groups))) if all(known) else ""


def _left_out(study: Study, rows: Sequence[Row]) -> list[str]:
    """Markdown: the agents that lack runs which others have."""
    complete = complete_agents(study, rows)
    lacking = [f"{agent}" for agent in study.agents if agent not in complete]
    return [f"Without all runs, and left out: {', '.join(lacking)}.", ""] if lacking else []


def plot_together(path: Path, study: Study, rows: Sequence[Row], curves: Sequence[Row]) -> None:
    """Two panels: the curve over all tasks, and the share of runs that end above each return.

    Args:
        path: Of the figure.
        study: With several tasks, each of which says what counts as solved.
        rows: One of each run.
        curves: Evaluations of each run; an agent of which a run has none is left out of the first
            panel.
    """
    figure = Figure(figsize=(11.2, 3.9), layout="constrained")
    over_time, profile = figure.subplots(1, 2)
    agents = complete_agents(study, rows)
    curves = evaluated(curves)
    over_steps = [agent for agent in agents if _has_curves(study, rows, curves, agent)]
    _draw(over_time, study, SHARES, {each: _curve(study, curves, each) for each in over_steps})
    _draw(profile, study, LEVELS, {agent: _profile(study, rows, agent) for agent in agents})
    num_tasks = f"{len(study.tasks)} tasks"
    over_time.set(
        title=f"Interquartile mean over {num_tasks}",
        xlabel="share of the environment steps",
        ylabel="evaluation return, solved is 1",
    )
    profile.set(
        title=f"Runs that end at or above a return, {num_tasks}",
        xlabel="evaluation return, solved is 1",
        ylabel="share of runs",
    )
    figure.savefig(path, dpi=120)


def _draw(
    axes: Axes,
    study: Study,
    points: np.ndarray,
    estimates: Mapping[str | float, Sequence[Estimate]],
) -> None:
    """Draw agents in the colours that they have in the figure of single tasks."""
    ends = {}
    for number, agent in enumerate(study.agents):
        if agent in estimates:
            draw_curve(axes, points.tolist(), estimates[agent], f"C{number}")
            ends[f"{agent}", f"C{number}"] = estimates[agent][-1].value
    label_beside(axes, ends)


def _has_curves(
    study: Study, rows: Sequence[Row], curves: Sequence[Row], agent: str | float
) -> bool:
    """Whether every run of an agent has an evaluation, without which its curve says nothing."""
    tasks = [task.name for task in study.tasks]
    runs, evaluated = (
        {(row["task"], row["seed"]) for row in lines if row["agent"] == agent}
        for lines in (rows, curves)
    )
    return all(run in evaluated for run in runs if run[0] in tasks)


def _curve(study: Study, curves: Sequence[Row], agent: str | float) -> list[Estimate]:
    """Interquartile mean of the latest evaluations, at each share of the budgets."""
    groups = [_latest(study, task, curves, agent) for task in study.tasks]  # tasks x runs x shares
    return [
        bootstrap([runs[:, place].tolist() for runs in groups]) for place in range(len(SHARES))
    ]


def _latest(study: Study, task: Task, curves: Sequence[Row], agent: str | float) -> np.ndarray:
    """For each run its latest evaluation at each share of its steps; 0 before the first."""
    total_steps = study.agents[agent].get("total_steps", task.config.run.total_steps)
    own = [row for row in curves if (row["task"], row["agent"]) == (task.name, agent)]
    latest = []
    for seed in dict.fromkeys(row["seed"] for row in own):
        taken = select(own, "step", seed=seed)
        steps = np.minimum(taken, total_steps)  # several environments overshoot
        values = np.array([0.0, *select(own, "evaluation_return", seed=seed)])
        number = np.searchsorted(steps, SHARES * total_steps, side="right")
        latest.append(values[number] / task.solved_return)
    return np.array(latest)


def _profile(study: Study, rows: Sequence[Row], agent: str | float) -> list[Estimate]:
    """Share of the runs that end at each level or above; one without a return is above none."""
    groups = [
        np.array(runs, dtype=float)  # nothing becomes NaN
        for runs in groups_of(study, rows, agent, "evaluation_return", normalized=True)
    ]
    reached = [np.less_equal.outer(LEVELS, runs) for runs in groups]  # tasks x levels x runs
    return [
        bootstrap([runs[place].tolist() for runs in reached], _mean)
        for place in range(len(LEVELS))
    ]


def _mean(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.mean(-1))
