"""One run: begun, continued or, where it is finished, read; and what is measured of it."""

import json
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deep_curiosity import __version__
from deep_curiosity.training.callbacks import Callback
from deep_curiosity.training.config import Config, config_key, run_key
from deep_curiosity.training.lease import LeaseError
from deep_curiosity.training.log import (
    CONFIG,
    PROGRESS,
    SUMMARY,
    read_progress,
    read_values,
    run_folders,
    write_text,
)
from deep_curiosity.training.loop import train
from deep_curiosity.training.source import source_commit
from deep_curiosity.transitions import is_whole_number

if TYPE_CHECKING:
    from deep_curiosity.experiments.study import Cell, Result, Row

EVALUATION_TAG = "eval/return"
MEASURED = (
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


class RunStoppedError(RuntimeError):
    """A run was stopped before its end, and can go on from its checkpoint."""


def run_own(cell: "Cell") -> "Result":
    """Train an agent of this package, unless it is trained already, and measure it.

    Raises:
        RunStoppedError: If the run is stopped before its end.
        ValueError: If its progress.csv is damaged, or ends before the run does.
    """
    from deep_curiosity.experiments.study import Result

    config = cell.config
    summary = run_once(config)
    check_progress(config, summary)
    curve = [
        {"step": step, "evaluation_return": value}
        for step, value in scheduled_evaluations(config, last=summary["total_steps"])
    ]
    versions = summary["versions"]
    origin = {
        "version": versions["deep-curiosity"],
        "commit": versions["commit"],
        "settings": changed_settings(config),
    }
    return Result(cell.study.measure(config, summary), curve, origin)


def check_progress(config: Config, summary: dict[str, Any]) -> None:
    """Refuse a finished run whose progress.csv has lost rows, which its curve would lack.

    Raises:
        ValueError: Naming the file.
    """
    rows, taken = _read_rows(config.run.out), summary["total_steps"]
    if not rows and summary["evaluation_return"] is None:  # all steps broke: it has not learned
        return
    last = int(float(rows[-1]["step"])) if rows else 0
    if last < taken:
        raise ValueError(
            f"`{PROGRESS}` must have a row of the last step of a run, {taken}, got "
            f"{config.run.out / PROGRESS}, which is missing or ends at step {last}; --resume "
            "mends it from the checkpoint."
        )


def changed_settings(config: Config) -> str:
    """Settings that differ from the default, as JSON; where a run lies is none of them."""
    return json.dumps({k: v for k, v in config.changes().items() if k != "out"})


def run_once(config: Config, on_evaluation: Callback | None = None) -> dict[str, Any]:
    """Summary of a run: read where it is finished, continued or begun where it is not.

    A shorter run is continued, unless a schedule was stretched over its steps; so is one whose
    summary is damaged.

    Args:
        config: Settings of the run.
        on_evaluation: As in `train`.

    Raises:
        FileExistsError: If the folder holds a run of other settings, or a longer one.
        LeaseError: If another process has begun the run meanwhile, or holds its folder.
        RunStoppedError: If it is stopped before its end; it can be continued.
        ValueError: If its summary is damaged, and no checkpoint is whole.
    """
    folder = config.run.out
    if not (folder / CONFIG).exists():
        return _begin(config, on_evaluation)
    there, here = config_key(read_values(folder)), config_key(config.to_json())
    differing = {name for name in there.keys() | here.keys() if there.get(name) != here.get(name)}
    extendable = set() if config.agent.follows_schedule else {"total_steps"}
    if others := sorted(differing - extendable):
        raise FileExistsError(
            f"`out` must hold no run of other settings, got {folder}, which differs in "
            f"{', '.join(others)}; move it away or choose another folder."
        )
    summary = _read_summary(folder)
    if summary is not None:
        taken, wanted = summary["total_steps"], config.run.total_steps
        if taken >= wanted + config.environment.num_envs:  # which are stepped together
            raise FileExistsError(
                f"`out` must hold no longer run than the {wanted} steps that are wanted, got "
                f"{folder}, which has taken {taken}; move it away or choose another folder."
            )
        if taken >= wanted:
            return summary
    try:
        return _to_its_end(config, on_evaluation, resume=True)
    except FileNotFoundError as error:
        if summary is not None or not (folder / SUMMARY).exists():
            raise
        raise ValueError(
            f"`{SUMMARY}` must be that of a run, or stand beside a checkpoint that is whole, got "
            f"{folder / SUMMARY}, which is damaged: {error}"
        ) from error


def _read_summary(folder: Path) -> dict[str, Any] | None:
    """Summary of a run; `None` where it has none, or one that is damaged."""
    try:
        summary = json.loads((folder / SUMMARY).read_text())
        versions = summary["versions"]
        is_whole = is_whole_number(summary["total_steps"])
        return summary if is_whole and {"deep-curiosity", "commit"} <= versions.keys() else None
    except (AttributeError, KeyError, OSError, TypeError, ValueError):
        return None


def _begin(config: Config, on_evaluation: Callback | None) -> dict[str, Any]:
    """Summary of a new run, whose folder was free a moment ago."""
    try:
        return _to_its_end(config, on_evaluation)
    except FileExistsError as error:
        if not (config.run.out / CONFIG).exists():
            raise
        raise LeaseError(
            f"`out` must not be begun by two processes at once, got {config.run.out}: {error}"
        ) from error


def _to_its_end(
    config: Config, on_evaluation: Callback | None, *, resume: bool = False
) -> dict[str, Any]:
    summary = train(config, resume=resume, on_evaluation=on_evaluation, show_progress=False)
    if summary["total_steps"] < config.run.total_steps:
        raise RunStoppedError(
            f"a run must reach its {config.run.total_steps} steps to count, got one stopped at "
            f"step {summary['total_steps']}: {config.run.out}; run the study again to continue it."
        )
    return summary


def run_foreign(cell: "Cell", trained: Callable[["Cell"], tuple["Row", list["Row"]]]) -> "Result":
    """Train an agent of another library, unless its result is there already.

    Args:
        cell: What is to be trained.
        trained: From a cell to a row of what is measured, and the curve.

    Raises:
        FileExistsError: If the folder holds a result of other settings.
        ValueError: If it holds one that is damaged.
    """
    from deep_curiosity.experiments.study import Result

    path = cell.folder / "result.json"
    settings = {**cell.study.agents[cell.agent], "seed": cell.seed, **cell.task.config.changes()}
    wanted = json.dumps(settings, default=str, sort_keys=True)
    if not path.exists():
        row, curve = trained(cell)
        origin = {"version": __version__, "commit": source_commit(), "settings": wanted}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps({"row": row, "curve": curve, "origin": origin}))
    try:
        result = json.loads(path.read_text())
        row, curve, origin = result["row"], result["curve"], result["origin"]
        found = origin["settings"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"`runs` must hold results that are whole, got {path}, which is damaged "
            f"({type(error).__name__}: {error}); delete it to train again."
        ) from error
    if found != wanted:
        raise FileExistsError(f"`runs` must hold no result of other settings, got {path}.")
    return Result([row], curve, origin)


def find_finished(runs: Path) -> dict[str, Path]:
    """Folders of all finished runs below one, by what makes each run the one it is.

    A run that has not come to its end is none. One whose settings cannot be read is left where it
    lies, with a warning.
    """
    found = {}
    for folder in reversed(run_folders(runs)):
        try:
            values = read_values(folder)
        except (OSError, ValueError) as error:
            warnings.warn(f"{folder} is passed over: {error}", stacklevel=2)
            continue
        if _is_finished(folder, values):
            found[run_key(values)] = folder
    return found


def is_finished(config: Config) -> bool:
    """Whether the folder of a run holds it, and to its end."""
    try:
        values = read_values(config.run.out)
    except (OSError, ValueError):
        return False
    return run_key(values) == finished_key(config) and _is_finished(config.run.out, values)


def _is_finished(folder: Path, values: dict[str, Any]) -> bool:
    """Whether a run's summary is whole, and tells of all the steps that its settings want."""
    summary, wanted = _read_summary(folder), values.get("total_steps")
    return summary is not None and is_whole_number(wanted) and summary["total_steps"] >= wanted


def finished_key(config: Config) -> str:
    """Key of a run in `find_finished`."""
    return run_key(config.to_json())


def measure_run(config: Config, summary: "Row") -> list["Row"]:
    """The figures by which runs are compared, as the summary has them."""
    return [{name: summary[name] for name in MEASURED}]


def read_evaluations(folder: Path) -> list[tuple[int, float]]:
    """Step and mean return of every evaluation of a run since it has learned."""
    rows = [
        (int(float(row["step"])), float(row[EVALUATION_TAG] or "nan"))
        for row in _read_rows(folder)
    ]
    return [(step, value) for step, value in rows if math.isfinite(value)]


def scheduled_evaluations(config: Config, *, last: int = -1) -> list[tuple[int, float]]:
    """Those that every run of the same settings has, and one of the last step.

    A run that was shorter once has one of its end of then, as no other seed has.
    """
    return [
        (step, value)
        for step, value in read_evaluations(config.run.out)
        if step % config.run.evaluation_interval < config.environment.num_envs or step == last
    ]


def _read_rows(folder: Path) -> list[dict[str, str]]:
    """Rows of progress.csv whose steps are whole numbers."""
    rows = read_progress(folder)
    check_steps(rows, source=str(folder / PROGRESS))
    return rows


def check_steps(rows: Sequence[dict[str, str]], *, source: str) -> None:
    """Refuse rows of a step that is no whole number, such as infinity.

    Raises:
        ValueError: Naming the file and the row.
    """
    for number, row in enumerate(rows, 2):
        if not float(row["step"]).is_integer():
            raise ValueError(
                f"`step` must be a whole number, got {row['step']} in row {number} of {source}, "
                "which is damaged; --resume mends it from the checkpoint."
            )


def measure_area(config: Config, summary: "Row") -> list["Row"]:
    """Mean return over all scheduled evaluations, the area under the curve, and the last one."""
    return [{"area": _area(config), "evaluation_return": summary["evaluation_return"]}]


def measure_run_and_area(config: Config, summary: "Row") -> list["Row"]:
    """All that `measure_run` gives, and the mean return over all scheduled evaluations."""
    return [{"area": _area(config), **row} for row in measure_run(config, summary)]


def _area(config: Config) -> float | None:
    """`None` where no scheduled evaluation has a return."""
    evaluations = [value for _, value in scheduled_evaluations(config)]
    return sum(evaluations) / len(evaluations) if evaluations else None


COLUMNS_OF: "dict[Callable[[Config, Row], list[Row]], Sequence[str]]" = {
    measure_run: MEASURED,
    measure_area: ("area", "evaluation_return"),
    measure_run_and_area: ("area", *MEASURED),
}
"""Columns of the rows that a measure of this module gives."""
