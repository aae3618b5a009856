"""A study of a thousand runs on two hundred workers, played with runs that sleep.

    python -m deep_curiosity.benchmark.many_runs

What is real is all that a study does beside training: giving out, looking into folders, trying
again what was lost, collecting, writing. A minute lasts a second.
"""

import json
import os
import random
import resource
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib.figure import Figure

from deep_curiosity.arguments import read_arguments
from deep_curiosity.experiments.engines.base import Job
from deep_curiosity.experiments.engines.local import ExecutorEngine
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.progress import latest_step
from deep_curiosity.experiments.runs import RunStoppedError
from deep_curiosity.experiments.study import Cell, Result, Study, Task
from deep_curiosity.experiments.tables import write_table
from deep_curiosity.training import Config
from deep_curiosity.training.log import PROGRESS

MINUTE = 1.0  # seconds that one is played in
MINUTES = 10  # of a run
WORKERS = 200
AGENTS = 10
SEEDS = 100
FAILING = 0.01  # share of the runs whose worker dies, at a moment drawn at random
TOTAL_STEPS = 1_000
OUT = Path("docs/benchmark/many_runs")


class SleepingEngine(ExecutorEngine):
    """Workers that are threads, since all they do is sleep."""

    def __init__(self, executor: ThreadPoolExecutor, workers: int) -> None:
        super().__init__(executor)
        self._workers = workers

    def capacity(self, job: Job) -> int:
        """As many as there are workers."""
        return self._workers


def sleep_through(cell: Cell) -> Result:
    """A run that sleeps, with a checkpoint every minute; the first try of some is lost.

    Raises:
        RunStoppedError: Where its worker dies.
    """
    begun = latest_step(cell.folder) * MINUTES // TOTAL_STEPS
    cell.folder.mkdir(parents=True, exist_ok=True)
    (cell.folder / "begun").touch()
    dies_at = death_of(cell.agent, cell.seed)
    if dies_at is not None and not (cell.folder / "died").exists():
        _sleep(cell, begun, int(dies_at))
        time.sleep(dies_at % 1 * MINUTE)
        (cell.folder / "died").touch()
        raise RunStoppedError("its worker died")
    _sleep(cell, begun, MINUTES)
    row = {"evaluation_return": float(cell.seed), "minutes": MINUTES}
    return Result([row], [], {"settings": json.dumps({"seed": cell.seed})})


def _sleep(cell: Cell, begun: int, until: int) -> None:
    """Sleep from one minute of a run to another, with a row of progress at each."""
    is_new = not (cell.folder / PROGRESS).exists()
    with (cell.folder / PROGRESS).open("a") as file:
        if is_new:
            print("step", file=file, flush=True)
        for minute in range(begun, until):
            time.sleep(MINUTE)
            print((minute + 1) * TOTAL_STEPS // MINUTES, file=file, flush=True)


def death_of(agent: str | float, seed: int) -> float | None:
    """Minute of a run at which its worker dies, for most of them none."""
    chance = random.Random(f"{agent} {seed}")
    return chance.random() * MINUTES if chance.random() < FAILING else None


def make_study(agents: int = AGENTS, seeds: int = SEEDS) -> Study:
    """The study: agents that differ in nothing."""
    task = Task("sleeping", Config.of(total_steps=TOTAL_STEPS))
    return Study(
        [task],
        {f"agent {number}": {} for number in range(agents)},
        seeds=seeds,
        columns=("evaluation_return",),
        run=sleep_through,
    )


class Sampler(threading.Thread):
    """Notes memory and CPU time of this process as a study goes on.

    Args:
        runs: Folder of the runs.
    """

    def __init__(self, runs: Path) -> None:
        super().__init__(daemon=True)
        self.rows: list[dict[str, float]] = []
        self._runs = runs
        self._ended = threading.Event()

    def run(self) -> None:
        """Note them twice a minute of the game."""
        started, busy = time.monotonic(), _cpu_seconds()
        while not self._ended.wait(MINUTE / 2):
            self.rows.append(
                {
                    "minutes": (time.monotonic() - started) / MINUTE,
                    "runs_begun": float(sum(1 for _ in self._runs.glob("*/*/*"))),
                    "memory_megabytes": _memory_megabytes(),
                    "cpu_seconds": _cpu_seconds() - busy,
                }
            )

    def end(self) -> None:
        """Stop noting."""
        self._ended.set()
        self.join()


def _memory_megabytes() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _cpu_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def simulate(
    study: Study, runs: Path, workers: int
) -> tuple[dict[str, float], list[dict[str, Any]]]:
    """Play a study.

    Args:
        study: Of runs that sleep.
        runs: Folder for their folders.
        workers: How many sleep at a time.

    Returns:
        Makespan and its bound in minutes, the runs that were lost; and the samples.
    """
    sampler = Sampler(runs)
    sampler.start()
    with ThreadPoolExecutor(workers) as executor:
        engine = SleepingEngine(executor, workers)
        failed = run_study(study, runs=runs, out=runs / "table", engine=engine)
    sampler.end()
    times = [path.stat().st_mtime for path in runs.rglob(PROGRESS)]
    begun = min(path.stat().st_mtime for path in runs.rglob("begun"))
    count = len(times)
    deaths = [death_of(agent, seed) for agent in study.agents for seed in range(study.seeds)]
    lost = sum(death % 1 for death in deaths if death is not None)  # since the last checkpoint
    summary = {
        "runs": float(count),
        "workers": float(workers),
        "failed": float(failed),
        "worker_deaths": float(sum(1 for _ in runs.rglob("died"))),
        "makespan_minutes": (max(times) - begun) / MINUTE,
        "bound_minutes": max(MINUTES, (count * MINUTES + lost) / workers),
    }
    return summary, sampler.rows


def plot(path: Path, summary: dict[str, float], rows: Sequence[dict[str, Any]]) -> None:
    """Runs begun against the clock, and what the process that gives them out takes."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    minutes = [row["minutes"] for row in rows]
    panels = {
        "runs_begun": "runs begun",
        "memory_megabytes": "memory of the driver, MB",
        "cpu_seconds": "CPU time of the driver, s",
    }
    for axes, (name, label) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        axes.plot(minutes, [row[name] for row in rows])
        axes.axvline(summary["bound_minutes"], color="grey", linestyle=":", label="bound")
        axes.axvline(summary["makespan_minutes"], color="C1", linestyle="--", label="makespan")
        axes.set(xlabel="simulated minutes", ylabel=label, ylim=(0, None))
        axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Play it, and write what came of it."""
    with TemporaryDirectory() as folder:
        summary, rows = simulate(make_study(), Path(folder) / "runs", WORKERS)
    write_table(OUT.with_suffix(".csv"), rows)
    write_table(OUT.with_name(f"{OUT.name}_summary.csv"), [summary])
    plot(OUT.with_suffix(".png"), summary, rows)
    print(json.dumps(summary, indent=2))


if __name__ == "__main__":
    read_arguments(main, description=__doc__)
