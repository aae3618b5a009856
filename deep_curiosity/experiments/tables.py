"""Tables of what was measured: rows in CSV files, and summaries of them in Markdown."""

import csv
import io
import math
import statistics as standard
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from deep_curiosity.experiments.statistics import Groups, bootstrap, rank_correlation
from deep_curiosity.experiments.study import Row, Study
from deep_curiosity.training.log import write_text

REACHED = ("first_success_step", "solved_step")
"""Columns of a step that a run reaches or never does, and is the better the sooner."""


def write_table(
    path: Path, rows: Sequence[Mapping[str, Any]], columns: Iterable[str] = ()
) -> None:
    """Write rows as CSV, numbers to six digits; a row without a column leaves it empty.

    What was there stands until the new table is whole, by which its owner is known.
    """
    names = list(columns) or list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows([[_short(row.get(name, "")) for name in names] for row in rows])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.getvalue())


def read_table(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV as they are written; none where there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [*csv.DictReader(file)]


def output_path(out: Path, ending: str) -> Path:
    """Path of one of several files that have a name in common, which may have a point."""
    return out.with_name(f"{out.name}{ending}")


def check_outputs(out: Path, endings: Iterable[str], *, column: str, owner: str) -> None:
    """Refuse to write over files, unless a table among them says whose they are.

    Args:
        out: Path of all files, without ending.
        endings: Of the files.
        column: First one of the owner's table.
        owner: Who may write there, for the message.

    Raises:
        FileExistsError: Naming the files.
        OSError: If nothing can be written there.
    """
    rule = f"`out` must name files in a folder that can be written to, got {out}"
    _check_writable(out.parent, rule)
    there = [path for end in endings if (path := output_path(out, end)).exists()]
    table = output_path(out, ".csv")
    own = table.is_file() and table.read_text(errors="replace").startswith(f"{column},")
    if there and not own:
        raise FileExistsError(
            f"`out` must name new files, or those of {owner}, got "
            f"{', '.join(map(str, there))}; choose another path."
        )


def check_runs(runs: Path) -> None:
    """Make the folder of all runs, or refuse one where none could be.

    Raises:
        OSError: If nothing can be written there.
    """
    _check_writable(runs, f"`runs` must be a folder that can be written to, got {runs}")


def _check_writable(folder: Path, rule: str) -> None:
    """Refuse a place where nothing can be written, before anything is computed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise type(error)(f"{rule}: {error}") from error


def check_page(folder: Path, title: str) -> None:
    """Refuse a folder whose page or tables are of something else.

    Args:
        folder: To be written to.
        title: First line of the page that is written there.

    Raises:
        FileExistsError: If there is another page, or there are tables without one.
        NotADirectoryError: If a file is in the place of the folder.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"`out` must name a folder, got {folder}, which is a file.")
    page = folder / "README.md"
    if page.exists():
        own = page.read_text(errors="replace").splitlines()[:1] == [title]
    else:
        own = not any(folder.glob("*.csv"))
    if not own:
        raise FileExistsError(
            f"`out` must name a folder without a page or tables of something else, got {folder}; "
            "choose another."
        )


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Table in Markdown; bars and line breaks of names are no longer such."""
    cells = [
        [" ".join(cell.replace("|", "\\|").splitlines()) for cell in line]
        for line in (header, ["---"] * len(header), *lines)
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def median_and_range(values: Sequence[float | int | None]) -> str:
    """`median [lowest, highest]`; a value that is missing counts as never, above all others."""
    known = sorted(math.inf if is_missing(value) else float(value) for value in values)  # type: ignore[arg-type]
    if known[0] == math.inf:
        return "never"
    shown = [
        f"{value:.4g}" if math.isfinite(value) else "never"
        for value in (standard.median(known), known[0], known[-1])
    ]
    return "{} [{}, {}]".format(*shown)


def select(rows: Sequence[Row], column: str, /, **where: Any) -> list[Any]:
    """Values of a column where other columns have some values, in the order of the rows."""
    return [row[column] for row in rows if all(row[name] == v for name, v in where.items())]


def one_for_each_run(study: Study, rows: Sequence[Row]) -> list[Row]:
    """The rows, where a run has several one with their means: a run counts once in statistics.

    A column of which some of them have no number keeps the mean of the others.
    """
    runs: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        runs.setdefault((row["task"], row[study.label], row["seed"]), []).append(row)
    return [
        own[-1] if len(own) == 1 else own[-1] | {name: _mean(own, name) for name in study.columns}
        for own in runs.values()
    ]


def _mean(rows: Sequence[Row], column: str) -> float | None:
    known = known_values(rows, column)
    return standard.fmean(known) if known else None


def summarize(study: Study, rows: Sequence[Row]) -> str:
    """Markdown: for each task and agent the interquartile mean of every column, with intervals.

    Of steps, where one that is missing was never reached by some run, median and range.
    """
    never = {
        column
        for column in study.columns
        if column in REACHED and any(_is_never(row, column) for row in rows)
    }
    titles = [
        f"{column.replace('_', ' ')}{', median and range' if column in never else ''}"
        for column in study.columns
    ]
    header = ["task", study.label, "runs solved", *titles]
    lines = []
    for task in study.tasks:
        for agent in study.agents:
            where = {"task": task.name, study.label: agent}
            solved = select(rows, "solved", **where)
            if not solved:
                continue
            counted = "-" if "" in solved else f"{sum(solved)} of {len(solved)}"
            cells = [
                median_and_range(values) if column in never and values else _estimate(values)
                for column in study.columns
                for values in [_values(rows, column, where)]
            ]
            lines.append([task.name, str(agent), counted, *cells])
    return "\n".join([markdown_table(header, lines) + "\n", *_rank_correlations(study, rows)])


def _values(rows: Sequence[Row], column: str, where: Mapping[str, Any]) -> list[Any]:
    """Values of a column; no steps of solving where no return counts as solved."""
    if column == "solved_step" and "" in select(rows, "solved", **where):
        return []
    return select(rows, column, **where)


def _is_never(row: Row, column: str) -> bool:
    """Whether a run has not reached what a column has the step of."""
    return is_missing(row[column]) and not (column == "solved_step" and row["solved"] == "")


def known_values(rows: Sequence[Row], column: str) -> list[float]:
    """Numbers of a column, of the rows that have one."""
    return [float(row[column]) for row in rows if not is_missing(row[column])]


def is_missing(value: float | str | None) -> bool:
    """Whether a run has no number there."""
    return value is None or value == "" or math.isnan(float(value))


def _estimate(values: Sequence[float | None]) -> str:
    """Interquartile mean with its interval, of the runs that have a value, and how many do."""
    known = [float(each) for each in values if not is_missing(each)]  # type: ignore[arg-type]
    if not known:
        return ""
    return counted_estimate([known], len(values))


def counted_estimate(known: Groups, num_runs: int) -> str:
    """Interquartile mean with its interval, and of how many runs, where some have no value.

    One run of each task has no interval: nothing tells how far another would be from it.
    """
    num_known = sum(map(len, known))
    counted = f", {num_known} of {num_runs} runs" if num_known < num_runs else ""
    estimate = bootstrap(known)
    is_alone = all(len(runs) == 1 for runs in known)
    return f"{f'{estimate.value:.4g}' if is_alone else estimate}{counted}"


def _rank_correlations(study: Study, rows: Sequence[Row]) -> list[str]:
    """Spearman's correlation of each column's medians with what is swept, where it is a number.

    A column has none where a run has no value, or all medians are equal.
    """
    numbers = [agent for agent in study.agents if isinstance(agent, int | float)]
    if len(numbers) < 3:
        return []
    lines = []
    for task in study.tasks:
        for column in study.columns:
            own = [
                select(rows, column, **{"task": task.name, study.label: number})
                for number in numbers
            ]
            if all(own) and not any(is_missing(value) for values in own for value in values):
                rank = rank_correlation(numbers, [*map(standard.median, own)])
                if math.isnan(rank):  # all medians are equal
                    continue
                lines.append(
                    f"- {task.name}: rank correlation of {column} with {study.label} {rank:.2f}"
                )
    return [*lines, ""]


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value
