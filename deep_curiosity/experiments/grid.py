"""Running a study: tasks x agents x seeds in, one or several rows for each run out."""

import math
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from deep_curiosity.experiments.figures import plot_columns, plot_curves
from deep_curiosity.experiments.runs import find_finished, finished_key, run_own
from deep_curiosity.experiments.statistics import probability_of_improvement
from deep_curiosity.experiments.study import Cell, Result, Row, Study
from deep_curiosity.experiments.tables import markdown_table, select, summarize, write_table

SUFFIXES = (".csv", ".md", ".png")
"""Of the files of a study: tables, summary, figure."""
CHOSEN = ("out", "seed")
"""Settings that a study chooses for each of its runs."""
MANY_TO_COMPARE = 12  # agents: a table of all pairs would be longer than anyone reads


def overridden(study: Study, values: dict[str, Any]) -> Study:
    """The same study with settings of all its runs changed, by their flat names.

    Raises:
        TypeError: If there is no such setting, or a value has the wrong type.
        ValueError: If a value is out of range, or the study itself chooses the setting.
    """
    for name, value in values.items():
        if name in CHOSEN or all(name in settings for settings in study.agents.values()):
            raise ValueError(
                f"`{name}` must be left to the study, which gives each run its own, got {value!r}."
            )
    tasks = [replace(task, config=task.config.override(**values)) for task in study.tasks]
    return replace(study, tasks=tasks)


def part_of(study: Study, tasks: Sequence[str], agents: Sequence[str]) -> Study:
    """Some tasks and agents of a study, by their names; all where none is named.

    Raises:
        ValueError: If a name is none of the study's, or named twice.
    """
    by_name = {task.name: task for task in study.tasks}
    labels = {str(label): label for label in study.agents}
    for name, wanted, known in (("tasks", tasks, by_name), ("agents", agents, labels)):
        if unknown := sorted(set(wanted) - set(known)):
            raise ValueError(
                f"`{name}` must be of the study, {', '.join(known)}, got {', '.join(unknown)}."
            )
        if len(set(wanted)) < len(wanted):
            raise ValueError(f"`{name}` must be named once each, got {', '.join(wanted)}.")
    return replace(
        study,
        tasks=[by_name[name] for name in tasks or by_name],
        agents={labels[name]: study.agents[labels[name]] for name in agents or labels},
    )


def cells_of(study: Study, runs: Path) -> list[Cell]:
    """All runs of a study, seed by seed, each with its folder below `runs`.

    A run of the same settings that lies anywhere beside or below `runs` is used where it lies.
    """
    cells = [
        Cell(study, task, agent, seed, runs / task.name / f"{agent}" / f"seed{seed}")
        for seed in range(study.first_seed, study.first_seed + study.seeds)
        for task in study.tasks
        for agent in study.agents
    ]
    if study.run is not run_own:
        return cells
    finished = find_finished(runs.parent)
    return [
        replace(cell, folder=finished.get(finished_key(cell.config), cell.folder))
        for cell in cells
    ]


def run_study(
    study: Study, *, runs: Path, out: Path, workers: int = 2, executor: Executor | None = None
) -> int:
    """Run every cell, and write tables, curves, summary and figure as far as they come.

    A run that is finished is read, one that was cut off is continued; one whose folder holds a run
    of other settings, or that raises, is listed as failed, and the others go on.

    Args:
        study: What is run.
        runs: Folder that receives the folders of the runs.
        out: Path without suffix of the table (.csv), the curves (_curves.csv), the summary (.md)
            and the figure (.png).
        workers: Processes at a time, where no executor is given.
        executor: Anything of `concurrent.futures`, such as Dask's or Ray's.

    Returns:
        Number of runs that failed.
    """
    cells = cells_of(study, runs)
    results: dict[int, Result] = {}
    failures: list[str] = []
    with _executor(executor, workers) as pool:
        futures = {pool.submit(study.run, cell): number for number, cell in enumerate(cells)}
        for future in as_completed(futures):
            cell = cells[futures[future]]
            try:
                results[futures[future]] = future.result()
            except Exception as error:  # whatever a run raises, the others go on
                where = f"{cell.task.name}, {cell.agent}, seed {cell.seed}"
                failures.append(f"{where}: {type(error).__name__}: {error}")
                print(f"failed: {failures[-1]}", file=sys.stderr, flush=True)
            else:
                print(f"{len(results)} of {len(cells)} runs", flush=True)
    if results:
        rows, curves = collect(cells, results)
        report(study, rows, curves, failures, out)
    return len(failures)


@contextmanager
def _executor(executor: Executor | None, workers: int) -> Iterator[Executor]:
    """The caller's own executor, which is left open, or processes of this machine."""
    if executor is not None:
        yield executor
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield pool


def collect(cells: Sequence[Cell], results: dict[int, Result]) -> tuple[list[Row], list[Row]]:
    """Rows of the table and of the curves, in the order of the cells."""
    rows: list[Row] = []
    curves: list[Row] = []
    for number, result in sorted(results.items()):
        cell = cells[number]
        key = {"task": cell.task.name, cell.study.label: cell.agent, "seed": cell.seed}
        for measured in result.rows:
            score = measured.get("evaluation_return", math.nan)
            needed = cell.task.solved_return
            known = not (math.isnan(score) or math.isnan(needed))
            solved = {"solved": int(score >= needed) if known else ""}
            rows.append(key | solved | measured | result.origin)
        curves += [key | point for point in result.curve]
    return rows, curves


def report(
    study: Study, rows: list[Row], curves: list[Row], failures: Sequence[str], out: Path
) -> None:
    """Write table, curves, summary and figure of what was measured."""
    table, text, figure = (out.with_name(out.name + suffix) for suffix in SUFFIXES)
    write_table(table, rows)
    if study.curves:
        write_table(out.with_name(f"{out.name}_curves.csv"), curves)
        plot_curves(figure, study, rows, curves)
    else:
        plot_columns(figure, study, rows)
    failed = [f"- failed: {failure}" for failure in failures]
    summary = "\n".join([summarize(study, rows), *compare(study, rows), *failed])
    text.write_text(summary.rstrip("\n") + "\n")
    print(summary)


def compare(study: Study, rows: Sequence[Row]) -> list[str]:
    """Markdown: the chance that the first agent beats each of the others, over all tasks."""
    first, *others = study.agents
    if not others or len(others) > MANY_TO_COMPARE or study.label != "agent":
        return []
    column = study.columns[0]
    groups = {
        agent: [select(rows, column, task=task.name, agent=agent) for task in study.tasks]
        for agent in study.agents
    }
    complete = [
        agent
        for agent in others
        if [*map(len, groups[agent])] == [*map(len, groups[first])] and all(groups[agent])
    ]
    lines = [
        [str(agent), str(probability_of_improvement(groups[first], groups[agent]))]
        for agent in complete
    ]
    return [markdown_table([f"{first} better than", f"probability, by {column}"], lines), ""]
