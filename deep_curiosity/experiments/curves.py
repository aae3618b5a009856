"""Learning curves of runs that lie in folders: read, grouped by what sets them apart, drawn."""

import json
import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from deep_curiosity.experiments.figures import draw_curve, estimate_curve, label_beside, plain
from deep_curiosity.experiments.runs import check_steps
from deep_curiosity.experiments.study import Row
from deep_curiosity.experiments.tables import output_path
from deep_curiosity.training.callbacks import CALLBACK
from deep_curiosity.training.config import CHANGEABLE, IGNORED, config_key, run_key
from deep_curiosity.training.environments import MADE_BY_FUNCTION
from deep_curiosity.training.log import (
    CONFIG,
    PROGRESS,
    SUMMARY,
    parse_progress,
    read_values,
    run_folders,
    write_text,
    written_whole,
)

TAGS = (
    "eval/return",
    "episode/return_mean",
    "eval/success_rate",
    "episode/coverage",
    "curiosity/nats",
)
"""What is drawn by default, as far as the runs have it."""
OF_THE_TASK = ("env_id", "env_kwargs")
OF_NO_AGENT = (*IGNORED, *OF_THE_TASK, "seed", "total_steps", "threads", "device", "compile")
"""Settings in which runs of one agent may differ."""
OF_EVERY_RUN = ("env_id", "bonus")
"""Settings without which a config.json is of something else."""
ENDINGS = (".html", ".png")
"""Of the page and the picture; the page goes first, as it says whose the picture is."""
OWNER = '<meta name="generator" content="deep-curiosity plot">'
"""By which a page is known as one that was written here."""
ASSETS = files("deep_curiosity.experiments") / "assets"


FoundRun = tuple[dict[str, Any], list[dict[str, float]]]
"""Settings and rows of a run."""


@dataclass(frozen=True)
class RunCurves:
    """What a run logged.

    Args:
        folder: Where it lies.
        task: Its environment, with arguments.
        agent: What sets it apart from the other runs.
        rows: Rows of its progress.csv, as numbers; what is missing is NaN.
        was_stopped: Whether a callback ended it before its last step, as one that is solved.
    """

    folder: Path
    task: str
    agent: str
    rows: list[dict[str, float]]
    was_stopped: bool = False


def find_runs(paths: Iterable[Path]) -> list[Path]:
    """Folders of runs: each path is one, or has some somewhere below it, if by a link.

    A folder to which several ways lead is found once.

    Raises:
        FileNotFoundError: If a path has no run.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        folders = run_folders(path)
        if not folders:
            raise FileNotFoundError(f"`runs` must be folders of runs, got {path}, which has none.")
        for folder in folders:
            found.setdefault(folder.resolve(), folder)
    return list(found.values())


def read_runs(folders: Sequence[Path], group_by: Sequence[str] = ()) -> list[RunCurves]:
    """Read runs, and name the agent of each by the settings that set it apart.

    A folder that holds no run, or one whose progress.csv is damaged, is passed over with a
    warning; one whose last row is cut off, as it is being written, is read up to there, with a
    warning. A folder without rows, such as an exported policy, is left out. Of a run and its
    copies, which may have gone on, the longest one counts, with a warning.

    Args:
        folders: Of the runs.
        group_by: Settings by which agents are told apart; by default all in which the runs
            differ, but for the seed and where and how long they ran.

    Raises:
        ValueError: If a setting to group by is none of the runs', or named twice, or none has any
            row.
    """
    _check_named_once("group_by", group_by)
    found = {folder: own for folder in folders if (own := _read_run(folder)) is not None}
    if not found:
        raise ValueError(f"`runs` must have logged something, got {len(folders)} that have not.")
    found = _each_once(found)
    settings = [values for values, _ in found.values()]
    known = {name for values in settings for name in values}
    if unknown := sorted(set(group_by) - known):
        raise ValueError(f"`group_by` must be settings of the runs, got {', '.join(unknown)}.")
    names = group_by or _differing(settings)
    return [
        RunCurves(
            folder, _task_of(values), _agent_of(values, names), rows, _was_stopped(folder, rows)
        )
        for folder, (values, rows) in found.items()
    ]


def _check_named_once(name: str, values: Sequence[str]) -> None:
    if len(set(values)) < len(values):
        raise ValueError(f"`{name}` must be named once each, got {', '.join(values)}.")


def _each_once(found: dict[Path, FoundRun]) -> dict[Path, FoundRun]:
    """The runs without copies, which would count as seeds of their own."""
    kept: dict[str, list[Path]] = {}
    for folder in sorted(found, key=lambda folder: -found[folder][1][-1]["step"]):
        own = kept.setdefault(_lasting_key(found[folder][0]), [])
        same = [longer for longer in own if _is_copy(found[folder], found[longer])]
        if same:
            warnings.warn(
                f"{folder} is passed over: it is the same run as {same[0]}.", stacklevel=3
            )
        else:
            own.append(folder)
    distinct = {folder for folders in kept.values() for folder in folders}
    return {folder: own for folder, own in found.items() if folder in distinct}


def _lasting_key(values: dict[str, Any]) -> str:
    """What no copy of a run can go on without."""
    own = {name: value for name, value in config_key(values).items() if name not in CHANGEABLE}
    return json.dumps(own, sort_keys=True)


def _is_copy(run: FoundRun, longer: FoundRun) -> bool:
    """Whether a run has all settings of a longer one, or is as that one began.

    Settings alone do not tell apart what functions of the caller's own have made.
    """
    (values, rows), (others, more) = run, longer
    if values["env_id"] != MADE_BY_FUNCTION and run_key(values) == run_key(others):
        return True
    return _untimed(rows) == _untimed(more[: len(rows)])


def _untimed(rows: list[dict[str, float]]) -> list[dict[str, str]]:
    """Rows without the clock, as texts, of which one that says NaN equals itself."""
    return [
        {tag: str(value) for tag, value in row.items() if not tag.startswith("time/")}
        for row in rows
    ]


def _was_stopped(folder: Path, rows: list[dict[str, float]]) -> bool:
    """Whether a callback has ended a run; one that a signal cut off would have gone on.

    So would one that was continued since, beyond the step of its summary.
    """
    try:
        summary = json.loads((folder / SUMMARY).read_text())
        return bool(
            summary["stopped_by"] == CALLBACK and summary["total_steps"] >= rows[-1]["step"]
        )
    except (OSError, ValueError, KeyError, TypeError):  # it has not ended, or nothing is known
        return False


def _read_run(folder: Path) -> FoundRun | None:
    """Settings and rows of a run; `None` where there is none that could be drawn."""
    try:
        values = read_values(folder)
        _check_settings(values)
        rows = _numbers(folder)
    except (OSError, ValueError) as error:
        warnings.warn(f"{folder} is passed over: {error}", stacklevel=2)
        return None
    return (values, rows) if rows else None


def _check_settings(values: dict[str, Any]) -> None:
    """Refuse settings that are those of no run.

    Raises:
        ValueError: Naming the first one that is wrong.
    """
    if missing := [name for name in OF_EVERY_RUN if name not in values]:
        raise ValueError(f"`{CONFIG}` must be that of a run, got one without {missing[0]}.")
    kinds: dict[str, type] = {**dict.fromkeys(OF_EVERY_RUN, str), "env_kwargs": dict}
    for name, kind in kinds.items():
        if not isinstance(values.get(name, {}), kind):
            raise ValueError(
                f"`{CONFIG}` must be that of a run, got one whose {name} is {values[name]!r}."
            )


def _differing(settings: Sequence[dict[str, Any]]) -> list[str]:
    """Settings in which runs differ that have them; the bonus goes first."""
    names = dict.fromkeys(["bonus", *(name for values in settings for name in values)])
    return [
        name
        for name in names
        if name not in OF_NO_AGENT
        and len({json.dumps(values[name]) for values in settings if name in values}) > 1
    ]


def _task_of(values: dict[str, Any]) -> str:
    name = values["env_id"].removeprefix("deep_curiosity/").removesuffix("-v0")
    arguments = [f"{key} {value}" for key, value in values.get("env_kwargs", {}).items()]
    return ", ".join([name, *arguments])


def _agent_of(values: dict[str, Any], names: Sequence[str]) -> str:
    """Name of an agent: its bonus, where agents differ in it, and its other settings."""
    parts = [
        f"{values[name]}" if name == "bonus" else f"{name} {values[name]}"
        for name in names
        if name in values
    ]
    return ", ".join(parts) or f"{values['bonus']}"


def _numbers(folder: Path) -> list[dict[str, float]]:
    """Rows of progress.csv, but for one at its end that is not whole yet."""
    path = folder / PROGRESS
    text = path.read_text(errors="replace") if path.exists() else ""
    whole, end, torn = text.rpartition("\n")
    if torn:
        warnings.warn(f"{path} is read but for its last row, which is cut off.", stacklevel=2)
    rows = parse_progress(whole + end, source=str(path))
    check_steps(rows, source=str(path))
    return [{name: float(value or "nan") for name, value in row.items()} for row in rows]


def known_tags(runs: Sequence[RunCurves], tags: Sequence[str]) -> list[str]:
    """The tags of which the runs have numbers; where none is named, the usual ones.

    Raises:
        ValueError: If a tag is named that no run has, or twice, or no run has anything to draw.
    """
    _check_named_once("tags", tags)
    there = {
        tag: None
        for run in runs
        for row in run.rows
        for tag, value in row.items()
        if tag != "step" and math.isfinite(value)
    }
    if unknown := [tag for tag in tags if tag not in there]:
        raise ValueError(
            f"`tags` must be of {', '.join(there) or 'a run that has learned'}, "
            f"got {', '.join(unknown)}."
        )
    drawn = list(tags) or [tag for tag in TAGS if tag in there]
    if not drawn:
        raise ValueError(f"`runs` must have logged something, got {len(runs)} that have not.")
    return drawn


def _points(runs: Sequence[RunCurves], task: str, agent: str, tag: str) -> list[Row]:
    """A number of each run of an agent on a task at every step at which one of them logged a tag.

    Between the steps that it logged itself a run has what lies on the line between them, or a step
    that one run alone logged would show this one as the mean. A run that was stopped keeps its
    last number for as long as others go on, or the solved ones would be missing first.
    """
    own = [run for run in runs if (run.task, run.agent) == (task, agent)]
    logged = [
        {int(row["step"]): row[tag] for row in run.rows if math.isfinite(row.get(tag, math.nan))}
        for run in own
    ]
    steps = sorted({step for values in logged for step in values})
    points = []
    for run, values in zip(own, logged, strict=True):
        if not values:
            continue
        at = sorted(values)
        last = math.inf if run.was_stopped else at[-1]
        there = [step for step in steps if at[0] <= step <= last]
        drawn = np.interp(there, at, [values[step] for step in at])
        points += [
            {"step": step, tag: float(value)} for step, value in zip(there, drawn, strict=True)
        ]
    return points


def _names(runs: Sequence[RunCurves], attribute: str) -> list[str]:
    return list(dict.fromkeys(getattr(run, attribute) for run in runs))


def check_place(out: Path) -> None:
    """Refuse to write into a run, or over files, unless the page among them was written here.

    Args:
        out: Path of page and picture, without ending.

    Raises:
        FileExistsError: Naming the files.
        ValueError: If the folder is that of a run.
    """
    if (out.parent / CONFIG).exists():
        raise ValueError(f"`out` must name files outside of the folder of a run, got {out}.")
    there = [path for ending in ENDINGS if (path := output_path(out, ending)).exists()]
    page = output_path(out, ".html")
    own = page.is_file() and OWNER in page.read_text(errors="replace")
    if there and not own:
        raise FileExistsError(
            "`out` must name new files, or those of a plot, got "
            f"{', '.join(map(str, there))}; choose another path."
        )


def plot_png(path: Path, runs: Sequence[RunCurves], tags: Sequence[str]) -> None:
    """A line of panels for each tag, one for each task: interquartile mean and 95 % interval."""
    tasks, agents = _names(runs, "task"), _names(runs, "agent")
    size = 5.6 * len(tasks), 3.9 * len(tags)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(tags), len(tasks), squeeze=False)
    for line, tag in zip(panels, tags, strict=True):
        for axes, task in zip(line, tasks, strict=True):
            ends = {}
            for number, agent in enumerate(agents):
                if points := _points(runs, task, agent, tag):
                    steps, estimates = estimate_curve(points, tag)
                    draw_curve(axes, steps, estimates, f"C{number}")
                    count = sum((run.task, run.agent) == (task, agent) for run in runs)
                    ends[f"{agent} ({count})", f"C{number}"] = estimates[-1].value
            axes.set(title=plain(task), xlabel="environment steps", ylabel=plain(tag))
            label_beside(axes, ends)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as partial:
        figure.savefig(partial, dpi=120)


def write_page(path: Path, runs: Sequence[RunCurves], tags: Sequence[str]) -> None:
    """One HTML page with all curves, to hover over, choose from and compare, without a network."""
    page = (ASSETS / "curves.html").read_text()
    parts = {
        "STYLE": (ASSETS / "uPlot.min.css").read_text(),
        "LIBRARY": (ASSETS / "uPlot.iife.min.js").read_text(),
        "DATA": json.dumps(page_data(runs, tags), allow_nan=False).replace("</", "<\\/"),
    }
    for name, text in parts.items():
        page = page.replace(f"/*{name}*/", text)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)


def page_data(runs: Sequence[RunCurves], tags: Sequence[str]) -> dict[str, Any]:
    """What the page shows: for each task and tag the curves of every agent, and of its runs."""
    tasks, agents = _names(runs, "task"), _names(runs, "agent")
    curves = {task: {tag: _panel(runs, task, agents, tag) for tag in tags} for task in tasks}
    return {"tags": list(tags), "agents": agents, "curves": curves}


def _panel(
    runs: Sequence[RunCurves], task: str, agents: Sequence[str], tag: str
) -> dict[str, Any]:
    """Steps, and for each agent what lies there; `None` where nothing does."""
    points = {agent: _points(runs, task, agent, tag) for agent in agents}
    steps = sorted({point["step"] for own in points.values() for point in own})
    panel: dict[str, Any] = {"steps": steps, "agents": {}}
    for agent in agents:
        if points[agent]:
            there = dict(zip(*estimate_curve(points[agent], tag), strict=True))
            own = [run for run in runs if (run.task, run.agent) == (task, agent)]
            panel["agents"][agent] = {
                "value": [there[step].value if step in there else None for step in steps],
                "low": [there[step].low if step in there else None for step in steps],
                "high": [there[step].high if step in there else None for step in steps],
                "runs": {str(run.folder): _of_run(run, tag, steps) for run in own},
            }
    return panel


def _of_run(run: RunCurves, tag: str, steps: Sequence[int]) -> list[float | None]:
    values = {int(row["step"]): row.get(tag, math.nan) for row in run.rows}
    found = [values.get(step, math.nan) for step in steps]
    return [value if math.isfinite(value) else None for value in found]
