"""Choosing settings: trials of tasks x seeds on any engine, asked of Optuna and told to it.

Reference: Akiba et al., "Optuna: A Next-generation Hyperparameter Optimization Framework" (2019),
https://arxiv.org/abs/1907.10902.
"""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("optuna", extra="tune")

import json
import math
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args
from urllib.parse import quote

import numpy as np
import optuna
from optuna.exceptions import StorageInternalError
from optuna.trial import TrialState
from sqlalchemy import URL
from sqlalchemy.exc import SQLAlchemyError

from deep_curiosity.configuration import MOST_SEED, as_path, check_range, flat
from deep_curiosity.experiments.engines.base import Engine, Job, make_job
from deep_curiosity.experiments.execution import Ended, Execution
from deep_curiosity.experiments.figures import plot_search
from deep_curiosity.experiments.progress import latest_step
from deep_curiosity.experiments.runs import RunStoppedError, run_once
from deep_curiosity.experiments.search import Search, check_out
from deep_curiosity.experiments.statistics import interquartile_mean
from deep_curiosity.experiments.tables import check_runs, output_path, write_table
from deep_curiosity.experiments.workers import check_guarded
from deep_curiosity.training.config import Config
from deep_curiosity.training.interruption import terminated_like_interrupted
from deep_curiosity.training.lease import Lease, LeaseError
from deep_curiosity.training.log import write_json
from deep_curiosity.transitions import check_counts, is_whole_number

EVALUATIONS = "evaluations.jsonl"
SEARCH = "search"  # attribute of Optuna's study: of what its trials are
REASON = "reason"  # attribute of a trial that has failed: why
VERY_POOR = -1e9  # score of a trial of which a run returned NaN
STOP = "stop"  # its being there tells the runs of a trial to stop
ENDED = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
Pruner = Literal["median", "hyperband", "none"]


def tune(
    search: Search,
    *,
    trials: int,
    runs: str | Path,
    out: str | Path,
    engine: Engine,
    storage: str | None = None,
    pruner: Pruner = "median",
    at_once: int = 1,
    seed: int = 0,
) -> optuna.Study:
    """Try settings, the present ones first, and write the best as they are found.

    A search that was cut off goes on with the trials it was at. Which settings are tried depends
    on `seed`, `at_once` and the scores alone, neither on clocks nor on interruptions.

    Where a present setting differs between the tasks, the first trial has that of the first task
    for all; where one of these lies outside the search space, the first trial is drawn like the
    others. A warning names such settings.

    Args:
        search: What may be chosen, and how it is scored.
        trials: How many settings are tried, those of earlier calls included.
        runs: Folder of the runs, shared by all machines of the engine.
        out: Path without suffix of the best settings (.json), which `train` takes, the table of
            trials (.csv), and the figure of history and importance (.png).
        engine: Where the runs are computed; it is closed at the end.
        storage: Of Optuna, as a URL; a file in `runs` when `None`.
        pruner: Which trials are stopped early, after an evaluation that all their runs have had.
        at_once: Trials that are chosen together and computed side by side.
        seed: Of the sampler.

    Returns:
        Optuna's study.

    Raises:
        FileExistsError: If a file at `out` is none that a search has written.
        LeaseError: If another process searches in `runs`.
        OSError: If nothing can be written at `out`, or in `runs`.
        RuntimeError: If a script calls it that a worker reads anew.
        TypeError: If a number is not whole, or `runs` or `out` is no path.
        ValueError: If a number is out of range, there is no such pruner, or `storage` cannot be
            opened.
    """
    check_guarded("tune")
    _check_options(trials, at_once, seed, pruner)
    runs = as_path("runs", runs).absolute()  # workers may have another working directory
    out = as_path("out", out)
    check_out(out)
    with terminated_like_interrupted(), _alone(runs), engine:
        study = open_study(search, runs, storage, pruner)
        while (ended := count_ended(study)) < trials:
            if ended:
                write_search(study, out)
            wanted = min(at_once - ended % at_once, trials - ended)  # what is left of a batch
            batch = [_Trial(search, each, runs) for each in ask(study, search, wanted, seed)]
            for trial in batch:
                trial.check()
            run_batch(batch, engine)
            for trial in batch:
                trial.tell(study)
        write_search(study, out)
    return study


def _check_options(trials: int, at_once: int, seed: int, pruner: Pruner) -> None:
    """Refuse numbers and a pruner that cannot be, before anything is tried.

    Raises:
        TypeError: If a number is not whole.
        ValueError: If it is out of range, or there is no such pruner.
    """
    check_counts(trials=trials, at_once=at_once)
    if not is_whole_number(seed):
        raise TypeError(f"`seed` must be a whole number, got {seed!r}.")
    check_range("seed", int(seed), {"at_least": 0, "at_most": MOST_SEED})
    if pruner not in (known := get_args(Pruner)):
        raise ValueError(f"`pruner` must be one of {', '.join(known)}, got {pruner!r}.")


@contextmanager
def _alone(runs: Path) -> Iterator[None]:
    """Keep other processes from the trials in a folder, which they would take for cut off.

    Raises:
        LeaseError: If another one is at them.
    """
    check_runs(runs)
    try:
        lease = Lease(runs)
    except LeaseError as error:
        holder = str(error).partition(", which is ")[2]
        raise LeaseError(
            f"`runs` must be searched by one process at a time, got {runs}, which is {holder}"
        ) from error
    try:
        yield
    finally:
        lease.release()


def open_study(
    search: Search, runs: Path, storage: str | None = None, pruner: Pruner = "median"
) -> optuna.Study:
    """Optuna's study of a search, made or opened again; its first trial has the present settings.

    Where it cannot have those of every task, a warning says so, as `tune` does.

    Args:
        search: What may be chosen.
        runs: Folder of the storage where none is given.
        storage: As a URL.
        pruner: Which trials are stopped early.

    Raises:
        ValueError: If the storage cannot be opened, or holds trials of another search.
    """
    runs.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        storage=_open_storage(storage, runs / "trials.db"),
        study_name=runs.name,
        direction="maximize",
        pruner=_make_pruner(search, pruner),
        load_if_exists=True,
    )
    present = _present_settings(search)
    outside = [name for name in present if not _holds(search.space[name], present[name][0])]
    _claim(study, search)  # once nothing else is to be refused
    if study.trials:
        return study
    _warn_of_first(search, present, outside)
    if not outside:
        study.enqueue_trial({name: values[0] for name, values in present.items()})
    return study


def _present_settings(search: Search) -> dict[str, list[Any]]:
    """Of what varies the value that each task has at present, by the name of the setting."""
    settings = [flat(task.config) for task in search.tasks]
    return {name: [own[name].value for own in settings] for name in search.space}


def _warn_of_first(
    search: Search, present: Mapping[str, Sequence[Any]], outside: Sequence[str]
) -> None:
    """Warn where the first trial cannot have the present settings of every task."""
    reasons = [f"`{name}` {present[name][0]!r} is outside the search space" for name in outside]
    for name, values in present.items():
        if any(value != values[0] for value in values):
            own = [
                f"{each!r} of {task.name}" for task, each in zip(search.tasks, values, strict=True)
            ]
            reasons.append(f"`{name}` differs between the tasks, {', '.join(own)}")
    if reasons:
        instead = "is drawn instead" if outside else f"has those of {search.tasks[0].name} for all"
        warnings.warn(
            "the first trial cannot have the present settings of every task: "
            f"{'; '.join(reasons)}. It {instead}.",
            stacklevel=3,
        )


def _claim(study: optuna.Study, search: Search) -> None:
    """Note of what search the trials are, and refuse those of another."""
    own = json.loads(json.dumps(search.identity()))
    noted = study.user_attrs.get(SEARCH)
    if noted is None:
        study.set_user_attr(SEARCH, own)
    elif differing := [name for name in own if noted.get(name) != own[name]]:
        raise ValueError(
            f"`runs` must hold no trials of another search, got {study.study_name}, whose "
            f"{', '.join(differing)} differ; name another folder."
        )


def _url_of(path: Path) -> str:
    """URL of a SQLite file, whatever letters its path has."""
    url = URL.create("sqlite", database=f"file:{quote(str(path))}", query={"uri": "true"})
    return url.render_as_string()


def _open_storage(storage: str | None, file: Path) -> optuna.storages.RDBStorage:
    """The database of a URL, or, without one, that in a file."""
    try:
        return optuna.storages.RDBStorage(_url_of(file) if storage is None else storage)
    except (ImportError, SQLAlchemyError, StorageInternalError, ValueError) as error:
        reason = str(error.__cause__ or error).partition("\n")[0].rstrip(".")
        if storage is None:
            raise ValueError(
                "`runs` must hold trials that can be read, or none, got "
                f"{file}: {reason}; move it away, or bring it back from a copy."
            ) from error
        raise ValueError(
            "`storage` must be the URL of a database that can be opened, such as "
            f"sqlite:///trials.db, got {storage!r}: {reason}."
        ) from error


def _make_pruner(search: Search, pruner: Pruner) -> optuna.pruners.BasePruner:
    evaluations = [
        task.config.run.total_steps // task.config.run.evaluation_interval for task in search.tasks
    ]
    pruners: dict[Pruner, optuna.pruners.BasePruner] = {
        "median": optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=1),
        "hyperband": optuna.pruners.HyperbandPruner(
            min_resource=1, max_resource=max(1, *evaluations), bootstrap_count=0
        ),
        "none": optuna.pruners.NopPruner(),
    }
    return pruners[pruner]


def _holds(distribution: Any, value: Any) -> bool:
    """Whether a distribution can give a value."""
    try:
        return bool(distribution._contains(distribution.to_internal_repr(value)))
    except (TypeError, ValueError):  # of another kind
        return False


def count_ended(study: optuna.Study) -> int:
    """Trials that are over."""
    return len(study.get_trials(deepcopy=False, states=ENDED))


def ask(study: optuna.Study, search: Search, wanted: int, seed: int) -> list[optuna.trial.Trial]:
    """Trials to compute next: first those that were cut off, wherever that was.

    Every setting of a trial is drawn by a sampler of its own, seeded by its place, so that what is
    tried does not depend on how often the search was cut off before, in the midst of a trial too.
    """
    open_trials = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
    trials = []
    for number in range(count_ended(study), count_ended(study) + wanted):
        if open_trials:
            trial = optuna.trial.Trial(study, open_trials.pop(0)._trial_id)
        else:
            trial = study.ask()
        for place, (name, distribution) in enumerate(search.space.items()):
            entropy = np.random.SeedSequence([seed, number, place])
            study.sampler = optuna.samplers.TPESampler(seed=int(entropy.generate_state(1)[0]))
            trial._suggest(name, distribution)  # reads what was drawn before
        trials.append(trial)
    return trials


@dataclass
class _Trial:
    """A trial in progress.

    Args:
        search: What it belongs to.
        trial: Optuna's.
        runs: Folder of the runs of all trials.
    """

    search: Search
    trial: optuna.trial.Trial
    runs: Path
    pruned: bool = False
    failures: list[str] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        """Of its runs."""
        return self.runs / f"trial{self.trial.number:04d}"

    @cached_property
    def cells(self) -> list[tuple[str, Config]]:
        """Task and settings of every run."""
        seeds = range(self.search.first_seed, self.search.first_seed + self.search.seeds)
        return [
            (
                task.name,
                task.config.override(
                    **self.trial.params, seed=seed, out=self.folder / task.name / f"seed{seed}"
                ),
            )
            for seed in seeds
            for task in self.search.tasks
        ]

    def check(self) -> None:
        """Note as a failure where no run can have what was drawn; the trial then has no runs."""
        try:
            self.cells  # noqa: B018
        except (TypeError, ValueError) as error:
            self.cells = []
            self.failures.append(f"{error}")
            print(f"failed: {self.folder}: {error}", file=sys.stderr, flush=True)

    def jobs(self) -> list[Job]:
        """Its runs, packed."""
        stop = self.folder / STOP
        return [
            make_job(
                run_cell, config, stop, threads=config.speed.threads, device=config.speed.device
            )
            for _, config in self.cells
        ]

    def curves(self) -> list[list[float]]:
        """Normalised return of every run at each of its evaluations so far."""
        return [
            [
                self.search.normalise(task, value)
                for value in read_evaluations(config.run.out).values()
            ]
            for task, config in self.cells
        ]

    def review(self) -> None:
        """Report the evaluations that all runs have had, and stop them where that is poor."""
        if self.pruned:
            return
        known = self.trial.study.get_trials(deepcopy=False)[self.trial.number].intermediate_values
        for index, values in enumerate(zip(*self.curves(), strict=False)):
            if index < max(known, default=0):
                continue  # it was not stopped for that one
            if index not in known:
                self.trial.report(score_of(values), index)
            if self.trial.should_prune():
                self.pruned = True
                self.stop()
                return

    def stop(self) -> None:
        """Tell its runs to stop, those that have not begun too."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / STOP).touch()

    def tell(self, study: optuna.Study) -> None:
        """Tell Optuna how it ended; it has failed where a run is without its last evaluation."""
        if failures := self.failures or ([] if self.pruned else self._lacking()):
            self.trial.set_user_attr(REASON, failures[0])
            study.tell(self.trial, state=TrialState.FAIL)
        elif self.pruned:
            study.tell(self.trial, state=TrialState.PRUNED)
        else:
            study.tell(self.trial, score_of([curve[-1] for curve in self.curves()]))

    def _lacking(self) -> list[str]:
        """Runs without one at their end, as they were lost or a failed trial was cut off."""
        lacking = [
            f"{config.run.out}: no evaluation at its end is noted"
            for _, config in self.cells
            if max(read_evaluations(config.run.out), default=0) < config.run.total_steps
        ]
        for failure in lacking:
            print(f"failed: {failure}", file=sys.stderr)
        return lacking


def score_of(values: Sequence[float]) -> float:
    """Interquartile mean of normalised returns, one of each run; very poor where one is NaN."""
    return VERY_POOR if np.isnan(values).any() else float(interquartile_mean(np.array(values)))


def run_batch(batch: Sequence[_Trial], engine: Engine) -> None:
    """Compute trials side by side, and review them as their evaluations come."""
    owners = [(trial, config) for trial in batch for _, config in trial.cells]
    jobs = [job for trial in batch for job in trial.jobs()]
    for ended in Execution(engine, jobs, lambda number: latest_step(owners[number][1].run.out)):
        if ended is not None and ended.outcome.error:
            _note_failure(*owners[ended.number], ended)
        for trial in batch:
            trial.review()


def _note_failure(trial: _Trial, config: Config, ended: Ended) -> None:
    trial.failures.append(ended.outcome.error)
    trial.stop()
    print(f"failed: {config.run.out}: {ended.outcome.error}", file=sys.stderr, flush=True)


def run_cell(config: Config, stop: Path) -> None:
    """One run of a trial, whose evaluations are noted, until its end or a file tells it to stop.

    Args:
        config: Settings of the run.
        stop: The file.

    Raises:
        RunStoppedError: If the run is stopped otherwise.
    """
    if stop.exists():
        return

    def note(step: int, values: Mapping[str, float]) -> bool:
        with (config.run.out / EVALUATIONS).open("a") as file:
            file.write(json.dumps([step, values["eval/return"]]) + "\n")
        return stop.exists()

    try:
        run_once(config, note)
    except RunStoppedError:
        if not stop.exists():
            raise


def read_evaluations(folder: Path) -> dict[int, float]:
    """Return of a run at each step of evaluation; one that was repeated counts once.

    Lines that a crash has torn are passed over.
    """
    path = folder / EVALUATIONS
    if not path.exists():
        return {}
    found: dict[int, float] = {}
    for line in path.read_text().split("\n")[:-1]:
        with suppress(ValueError, TypeError):
            step, value = json.loads(line)
            found[step] = value
    return dict(sorted(found.items()))


def write_search(study: optuna.Study, out: Path) -> None:
    """Write best settings, table and figure of what was tried so far.

    Best settings and figure of another search are removed, where no trial is complete yet.

    Args:
        study: Of Optuna.
        out: Path without suffix.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    trials = study.get_trials(deepcopy=False, states=ENDED)
    rows = [
        {"trial": each.number, "state": each.state.name.lower(), "score": each.value}
        | each.params
        | {name: why for name, why in each.user_attrs.items() if name == REASON}
        for each in trials
    ]
    write_table(output_path(out, ".csv"), rows)
    complete = [each for each in trials if each.state is TrialState.COMPLETE]
    if complete:
        write_json(output_path(out, ".json"), study.best_params)
        scores = [math.nan if each.value in (None, VERY_POOR) else each.value for each in trials]
        plot_search(output_path(out, ".png"), scores, importances(study))
    else:
        for ending in (".json", ".png"):
            output_path(out, ending).unlink(missing_ok=True)


def importances(study: optuna.Study) -> dict[str, float]:
    """Share of each setting in how scores differ; empty where there are too few, or none does."""
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    differ = len({each.value for each in complete}) > 1
    return dict(optuna.importance.get_param_importances(study)) if differ else {}
