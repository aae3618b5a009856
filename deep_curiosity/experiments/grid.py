"""Running a study: tasks x agents x seeds in, one or several rows for each run out."""

import math
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any

from deep_curiosity.configuration import as_path
from deep_curiosity.experiments.engines.base import Engine, Job, Outcome, make_job
from deep_curiosity.experiments.engines.local import ExecutorEngine, LocalEngine
from deep_curiosity.experiments.execution import Execution
from deep_curiosity.experiments.figures import plot_columns, plot_curves
from deep_curiosity.experiments.progress import Progress
from deep_curiosity.experiments.runs import (
    COLUMNS_OF,
    find_finished,
    finished_key,
    is_finished,
    run_own,
)
from deep_curiosity.experiments.statistics import probability_of_improvement
from deep_curiosity.experiments.study import CHOSEN, Cell, Result, Row, Study
from deep_curiosity.experiments.tables import (
    check_outputs,
    check_runs,
    is_missing,
    markdown_table,
    one_for_each_run,
    output_path,
    summarize,
    write_table,
)
from deep_curiosity.experiments.together import (
    complete_agents,
    groups_of,
    have_joint_curve,
    plot_together,
    summarize_together,
)
from deep_curiosity.experiments.workers import check_guarded
from deep_curiosity.training.interruption import terminated_like_interrupted
from deep_curiosity.training.log import write_text

WRITING_SECONDS = 10.0  # from one writing of the tables to the next, while results come
MANY_TO_COMPARE = 12  # agents: a table of all pairs would be longer than anyone reads
MORE_IS_BETTER = ("return", "area", "coverage", "success_rate")
"""Words in the names of columns of which more is better, whatever the task."""

SOLVED = ("solved", "solved_step")
"""Columns of every row, whatever a study measures."""
OF_TABLES, OF_CURVES = ",seed,solved,", ",seed,step,"
"""Columns by which a table of runs is told from one of curves."""
ENDINGS = (".csv", "_curves.csv", ".md", ".png", "_together.png")
"""Of the files that a study writes: tables, summary, figure."""


def overridden(study: Study, values: dict[str, Any]) -> Study:
    """The same study with settings of all its runs changed, by their flat names.

    Raises:
        TypeError: If there is no such setting, or a value has the wrong type.
        ValueError: If a value is out of range, or the study or an agent chooses the setting.
    """
    for name, value in values.items():
        if name in CHOSEN:
            raise ValueError(
                f"`{name}` must be left to the study, which gives each run its own, got {value!r}."
            )
        if own := [f"{label}" for label, settings in study.agents.items() if name in settings]:
            raise ValueError(
                f"`{name}` must be left to the study, where it is chosen by {', '.join(own)}, "
                f"got {value!r}; leave these out by --agents."
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

    A finished run of the same settings that lies anywhere beside or below `runs` is used where it
    lies, unless the folder of its own is finished too.
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
        cell
        if is_finished(cell.config)
        else replace(cell, folder=finished.get(finished_key(cell.config), cell.folder))
        for cell in cells
    ]


def run_study(
    study: Study,
    *,
    runs: str | Path,
    out: str | Path,
    workers: int = 2,
    engine: Engine | None = None,
    executor: Executor | None = None,
) -> int:
    """Run every cell, and write tables as results come, then summary and figure.

    A run that is finished is read, one that was cut off is continued; one whose folder holds a run
    of other settings, or that raises, is listed as failed, and the others go on. Ctrl-C or SIGTERM
    ends all, each run with a checkpoint to continue from when this is called again.

    The workers of this machine are spawned and read a script anew, wherever it runs: there the
    call stands below `if __name__ == "__main__":`.

    Args:
        study: What is run.
        runs: Folder that receives the folders of the runs; all machines of an engine share it.
        out: Path without suffix of the table (.csv), the curves (_curves.csv), the summary (.md),
            the figure (.png) and that of all tasks together (_together.png).
        workers: Processes at a time, where neither engine nor executor is given.
        engine: Where the runs are computed; it is closed at the end.
        executor: Anything of `concurrent.futures`, such as Dask's, instead of an engine.

    Returns:
        Number of runs that failed.

    Raises:
        FileExistsError: If a file at `out` is none that a study has written.
        OSError: If nothing can be written at `out`, or in `runs`.
        TypeError: If `runs` or `out` is no path, or the workers are no whole number.
        ValueError: If there is no worker; or the study names a column that no run can have; or one
            that a run which ends does not have, which can be read when the study is run again with
            other columns.
        KeyboardInterrupt: If it is stopped, once what came is written.
        RuntimeError: If a script calls it that a worker reads anew.
    """
    check_guarded("run_study")
    runs = as_path("runs", runs).absolute()  # workers may have another working directory
    out = as_path("out", out)
    check_out(study, out)
    check_measure(study)
    check_runs(runs)
    cells = cells_of(study, runs)
    if engine is None:
        engine = LocalEngine(workers) if executor is None else ExecutorEngine(executor)
    records = Records(study, cells, out)
    with terminated_like_interrupted():
        try:
            _run_all(cells, engine, records)
        finally:
            records.write()  # takes its time, in which nothing runs any more
    return records.num_failed


def _run_all(cells: Sequence[Cell], engine: Engine, records: "Records") -> None:
    """Run every cell and note how it ended; the engine is closed, however that goes."""
    with engine, Progress(cells) as progress:
        execution = Execution(engine, [*map(_job, cells)], progress.step_of)
        for ended in execution:
            if ended is not None:
                records.add(*ended)
                progress.end(ended.number)
            progress.show(execution.running, records.num_failed)
            records.write_some()


def _job(cell: Cell) -> Job:
    speed = cell.planned.speed
    return make_job(run_cell, cell, threads=speed.threads, device=speed.device)


def run_cell(cell: Cell) -> Result:
    """See to one run, and refuse what is no result, so that it alone is listed as failed.

    Raises:
        TypeError: If the study's `run` returns no result, or rows or points that are none.
        ValueError: If a row has a column that the study gives it, or a point no step or return.
    """
    result = cell.study.run(cell)
    if not isinstance(result, Result):
        raise TypeError(f"`run` must return a Result, got {result!r}.")
    for name in ("rows", "curve"):
        lines = getattr(result, name)
        if not isinstance(lines, list) or not all(isinstance(each, dict) for each in lines):
            raise TypeError(f"`{name}` of a result must be a list of dictionaries, got {lines!r}.")
    for row in result.rows:
        if own := sorted({"task", "seed"} & set(row)):
            raise ValueError(f"`rows` must leave {', '.join(own)} to the study, got {row}.")
    for point in result.curve:
        if lacking := sorted({"step", "evaluation_return"} - set(point)):
            raise ValueError(f"`curve` must have {', '.join(lacking)}, got {point}.")
    return result


class Records:
    """What the runs of a study gave so far, and its files.

    Args:
        study: What is run.
        cells: Its runs.
        out: Path of its files, without suffix.
    """

    def __init__(self, study: Study, cells: Sequence[Cell], out: Path) -> None:
        self._study = study
        self._cells = cells
        self._out = out
        self._results: dict[int, Result] = {}
        self._failures: dict[int, str] = {}
        self._written = 0
        self._next = 0.0

    @property
    def num_failed(self) -> int:
        """Runs that raised, or were lost again and again."""
        return len(self._failures)

    def add(self, number: int, outcome: Outcome) -> None:
        """Note how a run ended.

        Raises:
            ValueError: If a column of the study is not measured, or none of numbers.
        """
        if not outcome.error:
            check_columns(self._study, outcome.result)
            self._results[number] = outcome.result
            return
        cell = self._cells[number]
        failure = f"{cell.task.name}, {cell.agent}, seed {cell.seed}: {outcome.error}"
        self._failures[number] = failure
        print(f"failed: {failure}", file=sys.stderr, flush=True)

    def write_some(self) -> None:
        """Write the tables where something came, now and then."""
        if self._written < len(self._results) and time.monotonic() > self._next:
            self._written, self._next = len(self._results), time.monotonic() + WRITING_SECONDS
            write_tables(self._study, *collect(self._cells, self._results), self._out)

    def write(self) -> None:
        """Write everything, also where all runs failed; nothing where none has ended."""
        if self._results or self._failures:
            rows, curves = collect(self._cells, self._results)
            report(self._study, rows, curves, self._notes(), self._out)

    def _notes(self) -> list[str]:
        """Markdown: how many runs there are of all, where some are to come; and which failed."""
        count, wanted = len(self._results), len(self._cells)
        is_whole = count + len(self._failures) == wanted
        so_far = [] if is_whole else [f"{count} of {wanted} runs so far.", ""]
        return so_far + [f"- failed: {self._failures[each]}" for each in sorted(self._failures)]


def check_out(study: Study, out: Path) -> None:
    """Refuse to write over files that are none of a study's, or another one's by their names.

    Raises:
        FileExistsError: Naming them.
    """
    owner = "a study, which has a table of tasks"
    check_outputs(out, ENDINGS, column="task", owner=owner)
    _refuse_other(output_path(out, ".csv"), "the curves", OF_CURVES)
    if study.curves:
        _refuse_other(output_path(out, "_curves.csv"), "the table", OF_TABLES)


def _refuse_other(path: Path, what: str, columns: str) -> None:
    """Refuse a CSV of another study, which has such columns.

    Raises:
        FileExistsError: Naming it.
    """
    if path.is_file() and columns in path.read_text(errors="replace").partition("\n")[0]:
        raise FileExistsError(
            f"`out` must name new files, or those of this study, got {path}, which holds {what} "
            "of another; choose another path."
        )


def check_columns(study: Study, result: Result) -> None:
    """Refuse columns of a study that a run does not have, or that hold no numbers.

    Raises:
        ValueError: Naming the first of them.
    """
    for row in result.rows:
        _check_measured(study, row)
        if study.label in row:
            raise ValueError(f"`label` must be no column of the rows, got {study.label!r}.")
        for name in study.columns:
            value = row.get(name)
            if not (value is None or isinstance(value, Real)):
                raise ValueError(f"`columns` must hold numbers, got {name!r} with {value!r}.")


def check_measure(study: Study) -> None:
    """Refuse columns that no run of the study can have, as far as that is known beforehand.

    Raises:
        ValueError: Naming the first of them, and those that there are.
    """
    if study.run is run_own and study.measure in COLUMNS_OF:
        _check_measured(study, COLUMNS_OF[study.measure])


def _check_measured(study: Study, measured: Iterable[str]) -> None:
    known = [*SOLVED, *measured]
    if unknown := [name for name in study.columns if name not in known]:
        raise ValueError(
            f"`columns` must be measured, got {unknown[0]!r}; there are {', '.join(known)}."
        )


def collect(cells: Sequence[Cell], results: dict[int, Result]) -> tuple[list[Row], list[Row]]:
    """Rows of the table and of the curves, in the order of the cells."""
    rows: list[Row] = []
    curves: list[Row] = []
    for number, result in sorted(results.items()):
        cell = cells[number]
        key = {"task": cell.task.name, cell.study.label: cell.agent, "seed": cell.seed}
        needed = cell.task.solved_return
        for measured in result.rows:
            solved = _solved(measured, result.curve, needed)
            rows.append(key | solved | measured | result.origin)
        curves += [key | point for point in result.curve]
    return rows, curves


def _solved(measured: Row, curve: Sequence[Row], needed: float) -> Row:
    """Whether a run ends solved, and the step of the first evaluation in which it is.

    One that ends without a return, as every episode of its last evaluation broke, is not solved.
    """
    if "evaluation_return" not in measured or math.isnan(needed):
        return {"solved": "", "solved_step": None}
    score = measured["evaluation_return"]
    steps = [
        point["step"]
        for point in curve
        if not is_missing(point["evaluation_return"]) and point["evaluation_return"] >= needed
    ]
    solved = not is_missing(score) and score >= needed
    return {"solved": int(solved), "solved_step": min(steps, default=None)}


def write_tables(study: Study, rows: list[Row], curves: list[Row], out: Path) -> None:
    """Write table and curves; the first columns of the table, where it has no rows, say whose."""
    write_table(output_path(out, ".csv"), rows, () if rows else ("task", study.label, "seed"))
    if study.curves:
        write_table(output_path(out, "_curves.csv"), curves)


def report(
    study: Study, rows: list[Row], curves: list[Row], notes: Sequence[str], out: Path
) -> None:
    """Write table, curves and summary of what was measured, and last the figures.

    Args:
        study: What was run.
        rows: Of the table.
        curves: Rows of the curves.
        notes: Lines of Markdown that end the summary.
        out: Path of all files, without ending.
    """
    write_tables(study, rows, curves, out)
    summary = "\n".join([summary_of(study, rows), *notes])
    write_text(output_path(out, ".md"), summary.rstrip("\n") + "\n")
    print(summary)
    _plot(study, rows, curves, out)


def _plot(study: Study, rows: list[Row], curves: list[Row], out: Path) -> None:
    """Draw the figures; one of an earlier call, where there is nothing to draw, is removed."""
    joint, once = study.joint, one_for_each_run(study, rows)
    if not rows:
        output_path(out, ".png").unlink(missing_ok=True)
    elif study.curves:
        plot_curves(output_path(out, ".png"), study, once, curves)
    else:
        plot_columns(output_path(out, ".png"), study, rows)
    if study.curves and have_joint_curve(joint, once):
        plot_together(output_path(out, "_together.png"), joint, once, curves)
    elif study.curves:
        output_path(out, "_together.png").unlink(missing_ok=True)


def summary_of(study: Study, rows: Sequence[Row]) -> str:
    """Markdown: each task by itself, all of them together, and agents against each other."""
    joint, rows = study.joint, one_for_each_run(study, rows)
    parts = [summarize(study, rows), *summarize_together(joint, rows), *compare(joint, rows)]
    return "\n".join(parts)


def compare(study: Study, rows: Sequence[Row]) -> list[str]:
    """Markdown: the chance that the first agent has more of a column than each other has.

    Over all tasks, of the first column. An agent of which a run has no value is left out, as a
    chance over its other runs would be of those that went well; so are all, if the first is such.
    Of single runs there is no chance to be told.
    """
    first, *others = study.agents
    if not others or len(others) > MANY_TO_COMPARE or study.label != "agent":
        return []
    column = study.columns[0]
    groups = {
        agent: own
        for agent in complete_agents(study, rows)
        for own in [groups_of(study, rows, agent, column)]
        if not any(is_missing(value) for runs in own for value in runs)
    }
    groups = {agent: own for agent, own in groups.items() if max(map(len, own)) > 1}
    lines = [
        [str(agent), str(probability_of_improvement(groups[first], groups[agent]))]
        for agent in others
        if first in groups and agent in groups
    ]
    if not lines:
        return [
            "Agents are not compared: two need all runs, several of a task, each with a "
            f"{column}.",
            "",
        ]
    is_better = any(word in column for word in MORE_IS_BETTER)
    comparison = "better than" if is_better else "has more than"
    header = [f"{first} {comparison}", f"probability, by {column}"]
    return [markdown_table(header, lines), ""]
