"""Time from the start of a command until its agent has solved a task, beside other checkouts'.

    git worktree add /tmp/before 010a659
    python -m deep_curiosity.benchmark.solved --beside before /tmp/before

What is run is `scripts/train.py` of each checkout with its own defaults and narrow networks, in a
process of its own: imports, compiling and evaluations are counted. What a checkout has compiled it
finds again in its later runs, as on the machine of a user.
"""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deep_curiosity.benchmark.tables import grouped, summarize
from deep_curiosity.experiments.studies.comparisons import MAZE, MOUNTAIN_CAR, PENDULUM
from deep_curiosity.experiments.study import Row, Task
from deep_curiosity.experiments.tables import (
    check_outputs,
    is_missing,
    markdown_table,
    output_path,
    read_table,
    write_table,
)
from deep_curiosity.training.log import PROGRESS, write_text
from deep_curiosity.training.source import commit_of
from deep_curiosity.transitions import check_counts
from deep_curiosity_envs.ids import registered_id

TASKS = (PENDULUM, MAZE, MOUNTAIN_CAR)
LOOKING_SECONDS = 0.5  # from one look at a run's evaluations to the next
ENDINGS = (".csv", ".md", ".png")
OWN = "default"
"""Name of this checkout."""


@dataclass(frozen=True)
class Args:
    """What is timed, and where to."""

    beside: dict[str, Path] = field(default_factory=dict)
    """Name and folder of other checkouts, which have their turn at every task and seed after this
    one's default."""
    seeds: int = 10
    """Runs of each on every task."""
    workers: int = 2
    """Runs at a time."""
    out: Path = Path("docs/benchmark/solved")
    """Path of table, summary and picture, without suffix."""

    def __post_init__(self) -> None:
        """Refuse what cannot be timed."""
        check_counts(seeds=self.seeds, workers=self.workers)
        for name, folder in self.beside.items():
            if name == OWN or not (folder / "scripts" / "train.py").is_file():
                raise ValueError(
                    f"`beside` must each be a name of its own, and the folder of a checkout with "
                    f"scripts/train.py, got {name} {folder}."
                )


def time_to_solved(checkout: Path, task: Task, seed: int, cache: Path) -> Row:
    """Seconds and steps until an evaluation reaches what counts as solved; none where none does.

    Args:
        checkout: Folder with `scripts/train.py`.
        task: With what counts as solved.
        seed: Of the run.
        cache: Folder for what is compiled.

    Raises:
        RuntimeError: If the run fails, with what it said.
    """
    with TemporaryDirectory() as folder:
        out, said = Path(folder) / "run", Path(folder) / "said.txt"
        environment = os.environ | {
            "PYTHONPATH": f"{checkout.resolve()}:{checkout.resolve() / 'envs'}",
            "TORCHINDUCTOR_CACHE_DIR": str(cache),
        }
        command = [sys.executable, "scripts/train.py", *flags_of(task, seed), "--out", str(out)]
        with said.open("w") as output:
            started = time.perf_counter()
            process = subprocess.Popen(
                command, cwd=checkout, env=environment, stdout=output, stderr=output
            )
            try:
                step = solved_step(out, task)
                while step is None and process.poll() is None:
                    time.sleep(LOOKING_SECONDS)
                    step = solved_step(out, task)
                seconds = time.perf_counter() - started
            finally:
                process.kill()
                process.wait()
        if step is None and process.returncode:
            raise RuntimeError(f"`{' '.join(command)}` must train, but said: {said.read_text()}")
    return {"seconds": None if step is None else seconds, "step": step}


def flags_of(task: Task, seed: int) -> list[str]:
    """The command line of a run, of flags that every version has."""
    config = task.config
    kwargs = [str(part) for pair in dict(config.environment.env_kwargs).items() for part in pair]
    return [
        *("--env-id", registered_id(config.environment.env_id)),
        *(("--env-kwargs", *kwargs) if kwargs else ()),
        *("--total-steps", str(config.run.total_steps)),
        *("--evaluation-interval", str(config.run.evaluation_interval)),
        *("--log-interval", str(config.run.log_interval)),
        *("--hidden-dim", str(config.agent.hidden_dim)),
        *("--seed", str(seed)),
    ]


def solved_step(folder: Path, task: Task) -> int | None:
    """Step of the first evaluation of a run that reaches what counts as solved, so far."""
    for row in read_table(folder / PROGRESS):
        value = row.get("eval/return")
        if value and not is_missing(value) and float(value) >= task.solved_return:
            return int(row["step"])
    return None


def summary_of(rows: Sequence[Row]) -> str:
    """Markdown: runs that solve each task, and how long that takes them."""
    lines = [
        [str(task), str(checkout), f"{len(solved)} of {len(own)}", summarize(own, "seconds")]
        for (task, checkout), own in grouped(rows, "task", "checkout").items()
        for solved in [[row for row in own if not is_missing(row["seconds"])]]
    ]
    return markdown_table(["task", "checkout", "runs that solve it", "seconds"], lines)


def plot(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each task: share of the runs that have solved it, against the clock."""
    tasks = grouped(rows, "task")
    figure = Figure(figsize=(3.4 * len(tasks), 3.2), layout="constrained")
    panels = figure.subplots(1, len(tasks), squeeze=False, sharey=True)[0]
    for axes, ((task,), own) in zip(panels, tasks.items(), strict=True):
        for (checkout,), runs in grouped(own, "checkout").items():
            _plot_share(axes, str(checkout), runs)
        axes.set(title=task, xlabel="seconds from the start", xlim=(0, None), ylim=(0, 1.02))
    panels[0].set_ylabel("share of runs that have solved it")
    panels[0].legend(loc="upper left")
    figure.savefig(path, dpi=120)


def _plot_share(axes: Axes, name: str, runs: Sequence[Row]) -> None:
    times = sorted(float(row["seconds"]) for row in runs if not is_missing(row["seconds"]))
    shares = [number / len(runs) for number in range(len(times) + 1)]
    axes.step([0.0, *times], shares, where="post", marker=".", label=name)


def main(args: Args) -> None:
    """Time all runs, and write a row for each as it comes."""
    check_outputs(args.out, ENDINGS, column="task", owner="this timing")
    checkouts = {OWN: Path(__file__).parents[2], **args.beside}
    turns = [
        (task, name, seed) for seed in range(args.seeds) for task in TASKS for name in checkouts
    ]
    rows: list[Row] = []
    with TemporaryDirectory() as caches, ThreadPoolExecutor(args.workers) as executor:
        timed = [
            executor.submit(time_to_solved, checkouts[name], task, seed, Path(caches, name))
            for task, name, seed in turns
        ]
        try:
            for (task, name, seed), future in zip(turns, timed, strict=True):
                row = {"task": task.name, "checkout": name, "seed": seed, **future.result()}
                rows.append(row | {"commit": commit_of(checkouts[name])})
                write_table(output_path(args.out, ".csv"), rows)
                print(row, flush=True)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    summary = summary_of(rows)
    write_text(output_path(args.out, ".md"), f"{summary}\n")
    plot(output_path(args.out, ".png"), rows)
    print(summary)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
