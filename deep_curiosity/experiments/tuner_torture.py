"""A search for settings that is killed on its way, beside one that is left in peace."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("optuna", extra="tune")

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.grid import output_path, run_study
from deep_curiosity.experiments.search import Search
from deep_curiosity.experiments.statistics import Estimate, bootstrap
from deep_curiosity.experiments.study import Study
from deep_curiosity.experiments.tables import markdown_table, read_table, select, write_table
from deep_curiosity.experiments.tuner import open_study

TITLE = "# A search that is killed"
LOOKING_SECONDS = 0.5  # from one look at the table of trials to the next
PAUSE = 10.0
"""Seconds, at most, from the end of the trial after which a search is killed to its death."""


@dataclass(frozen=True)
class Plan:
    """What is searched, and how often it is killed.

    Args:
        name: Of the search, or the file that holds it, as `deep-curiosity tune` takes it.
        search: The search itself.
        trials: How many settings are tried.
        kills: SIGKILLs.
        seed: Of the moments at which they come.
        workers: Processes at a time.
    """

    name: str
    search: Search
    trials: int
    kills: int
    seed: int = 0
    workers: int = 2

    def command(self, folder: Path) -> list[str]:
        """The search in a folder of its own."""
        options = {
            "--trials": self.trials,
            "--workers": self.workers,
            "--runs": folder,
            "--out": folder / "best",
        }
        words = [str(word) for pair in options.items() for word in pair]
        return [sys.executable, "-m", "deep_curiosity", "tune", self.name, *words]

    def trials_of(self, folder: Path) -> list[tuple[Any, ...]]:
        """All that was tried there: settings, how each ended, every score that was reported."""
        (runs,) = (path.parent for path in folder.glob("*/trials.db"))
        return [
            (each.number, each.state.name, each.params, each.value, each.intermediate_values)
            for each in open_study(self.search, runs).trials
        ]


def search_in_peace(plan: Plan, folder: Path) -> None:
    """Run a search to its end, or what is left of it.

    Raises:
        subprocess.CalledProcessError: If it fails.
    """
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(plan.command(folder), check=True)


def search_and_kill(plan: Plan, folder: Path) -> list[dict[str, float]]:
    """Kill a search at random moments, run it again after each, and let it end.

    Called again where it was stopped itself, it goes on with the kills that are left.

    Args:
        plan: What is searched.
        folder: For its runs.

    Returns:
        Of each kill the number of trials that had ended, and the seconds after the last of them.

    Raises:
        RuntimeError: If it ends before it is killed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    chance = random.Random(plan.seed)
    moments = sorted(chance.sample(range(1, plan.trials), plan.kills))
    kills = [{"trials": float(each), "seconds": chance.uniform(0.0, PAUSE)} for each in moments]
    path = folder / "kills.csv"
    for number in range(len(read_table(path)), len(kills)):
        _kill(plan, folder, **kills[number])
        write_table(path, kills[: number + 1])
    search_in_peace(plan, folder)
    return kills


def _kill(plan: Plan, folder: Path, trials: float, seconds: float) -> None:
    """Begin a search, and kill it so many seconds after so many trials have ended."""
    process = subprocess.Popen(plan.command(folder))
    try:
        while process.poll() is None and len(read_table(folder / "best.csv")) < trials:
            time.sleep(LOOKING_SECONDS)
        time.sleep(seconds)
    finally:
        process.kill()
        status = process.wait()
    if status != -signal.SIGKILL:
        raise RuntimeError(f"a search must last until it is killed, got one that ended: {status}.")


@dataclass(frozen=True)
class Comparison:
    """What became of two searches.

    Args:
        plan: What was searched.
        kills: As `search_and_kill` returns them.
        trials: Of the search that was killed.
        equal: How many of them are as in the one that was not, at the same place.
        best: The settings that it found.
        scores: Of the default and the best settings, over all tasks and seeds.
        seeds: Of the scores, on each task.
    """

    plan: Plan
    kills: Sequence[Mapping[str, float]]
    trials: Sequence[tuple[Any, ...]]
    equal: int
    best: Mapping[str, Any]
    scores: Mapping[str, Estimate]
    seeds: int

    @property
    def is_sound(self) -> bool:
        """Whether no trial was lost, doubled or changed."""
        return self.equal == len(self.trials) == self.plan.trials


def torture_search(plan: Plan, folder: Path, out: Path, *, seeds: int = 10) -> Comparison:
    """Search twice, once killed on the way; then score default and best settings on other seeds.

    Args:
        plan: What is searched.
        folder: For all runs. What is there goes on.
        out: Folder for trials (`trials.csv`, `.json`, `.png`) and scores (`seeds.csv`, ...).
        seeds: Of the scores, on each task.

    Raises:
        RuntimeError: If a search ends before it is killed, or runs of the scores fail.
    """
    search_in_peace(plan, folder / "whole")
    kills = search_and_kill(plan, folder / "killed")
    whole, killed = (plan.trials_of(folder / name) for name in ("whole", "killed"))
    out.mkdir(parents=True, exist_ok=True)
    for ending in (".csv", ".json", ".png"):
        shutil.copy(folder / "killed" / f"best{ending}", out / f"trials{ending}")
    best = json.loads((out / "trials.json").read_text())
    scores = score(plan, best, folder / "seeds" / "runs", out / "seeds", seeds)
    equal = sum(one == other for one, other in zip(whole, killed, strict=False))
    return Comparison(plan, kills, killed, equal, best, scores, seeds)


def score(
    plan: Plan, best: Mapping[str, Any], runs: Path, out: Path, seeds: int
) -> dict[str, Estimate]:
    """Interquartile mean of normalised returns of default and best settings, with its interval.

    Raises:
        RuntimeError: If runs fail.
    """
    study = Study(plan.search.tasks, {"default": {}, "best": dict(best)}, seeds=seeds)
    if failed := run_study(study, runs=runs, out=out, engine=LocalEngine(plan.workers)):
        raise RuntimeError(f"every run must come to its end, got {failed} that failed.")
    rows = read_table(output_path(out, ".csv"))
    return {
        str(agent): bootstrap(
            [
                [
                    plan.search.normalise(task.name, float(value))
                    for value in select(rows, "evaluation_return", task=task.name, agent=agent)
                ]
                for task in plan.search.tasks
            ]
        )
        for agent in study.agents
    }


def page(comparison: Comparison, command: str) -> str:
    """What came of it, in Markdown.

    Args:
        comparison: What came of it.
        command: The command line that asked for it.
    """
    plan = comparison.plan
    states = Counter(state.lower() for _, state, *_ in comparison.trials)
    ended = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
    kills = " and ".join(
        f"{kill['seconds']:.1f} s after trial {kill['trials']:.0f}" for kill in comparison.kills
    )
    lines = [[name, str(value)] for name, value in comparison.scores.items()]
    best = ", ".join(f"`{name}` {_short(value)}" for name, value in comparison.best.items())
    return f"""{TITLE}

The search `{plan.name}`: {plan.trials} trials of {len(plan.search.space)} settings on
{" and ".join(task.name for task in plan.search.tasks)}. It was killed (SIGKILL) {kills}, and
begun again by the same command. {comparison.equal} of its {len(comparison.trials)} trials are
those of a search that was left in peace, each at its place: settings, how it ended, every score on
the way ({ended}).

![History of the scores, and what they depend on](trials.png)

Best: {best}. Over {comparison.seeds} other seeds of each task, the interquartile mean of
normalised returns with its 95 % interval:

{markdown_table(["settings", "score"], lines)}

[Trials](trials.csv), [best settings](trials.json), [scores](seeds.md), [their runs](seeds.csv).

```sh
{command}
```
"""


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
