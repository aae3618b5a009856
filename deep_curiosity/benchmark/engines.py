"""What an engine costs: the same runs by one worker, two, two of Ray, and two bare processes.

python -m deep_curiosity.benchmark.engines --steps 8000

A machine whose speed drifts tells workers apart only where their turns are short:

python -m deep_curiosity.benchmark.engines --steps 6000 --rounds 5 --runs 8 \
    --runners "local, 1 worker" "local, 2 workers" --out docs/benchmark/engines_eight.csv
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, get_args

import tyro

from deep_curiosity.benchmark.tables import grouped, rate_over, summarize
from deep_curiosity.experiments.engines.base import Engine
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.engines.ray import RayEngine
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.study import Row, Study, Task
from deep_curiosity.experiments.tables import check_outputs, write_table
from deep_curiosity.training.config import Config
from deep_curiosity.training.log import CONFIG, SUMMARY
from deep_curiosity.training.loop import train
from deep_curiosity.training.source import source_commit
from deep_curiosity.transitions import check_counts

Runner = Literal["local, 1 worker", "local, 2 workers", "ray, 2 workers", "processes, 2"]
ALONE: Runner = "local, 1 worker"


@dataclass(frozen=True)
class Args:
    """How much, and where to."""

    rounds: int = 3
    """In each of which every runner has its turn; in every second one in the opposite order."""
    runs: int = 12
    """Of the study; one worker does half of them, which takes as long."""
    steps: int = 12_000
    """Environment steps of a run, which takes about a minute."""
    runners: tuple[Runner, ...] = get_args(Runner)
    """Which of them: engines, or processes without one."""
    out: Path = Path("docs/benchmark/engines.csv")
    """CSV file that receives a row for every turn."""

    def __post_init__(self) -> None:
        """Refuse what cannot be measured."""
        check_counts(rounds=self.rounds, steps=self.steps)
        if self.runs < 2:
            raise ValueError(
                f"`runs` must be at least 2, since one worker does half of them, got {self.runs}."
            )


def time_study(make_engine: Callable[[], Engine], runs: int, steps: int, folder: Path) -> float:
    """Seconds of a study from the beginning of its first run to the end of its last one.

    Raises:
        RuntimeError: If a run fails.
    """
    study = Study([Task("pendulum", config_of(steps))], {"curiosity": {}}, seeds=runs)
    if run_study(study, runs=folder / "runs", out=folder / "table", engine=make_engine()):
        raise RuntimeError(f"`runs` must come to their end to be timed, got failures in {folder}.")
    return seconds_of(folder)


def time_processes(runs: int, steps: int, folder: Path) -> float:
    """Seconds of the same runs by two processes that know of no engine, half of them each.

    Raises what a run raises.
    """
    config = config_of(steps)
    configs = [config.override(seed=seed, out=folder / f"seed{seed}") for seed in range(runs)]
    with ProcessPoolExecutor(2, get_context("spawn")) as processes:
        list(processes.map(train_each, [configs[::2], configs[1::2]]))
    return seconds_of(folder)


def train_each(configs: Sequence[Config]) -> None:
    """One run after the other, in this process."""
    for config in configs:
        train(config, show_progress=False)


def config_of(steps: int) -> Config:
    """Settings of the runs, but for seed and folder."""
    return Config.of(total_steps=steps, hidden_dim=64, update_to_data=0.5, compile="off")


def seconds_of(folder: Path) -> float:
    """From the beginning of the first run below a folder to the end of the last one."""
    begun = min(path.stat().st_mtime for path in folder.rglob(CONFIG))
    return max(path.stat().st_mtime for path in folder.rglob(SUMMARY)) - begun


TIMED: dict[Runner, Callable[[int, int, Path], float]] = {
    ALONE: partial(time_study, lambda: LocalEngine(1)),
    "local, 2 workers": partial(time_study, lambda: LocalEngine(2)),
    "ray, 2 workers": partial(time_study, lambda: RayEngine(num_cpus=2)),
    "processes, 2": time_processes,
}
"""From runs, their steps and a folder to seconds."""


def main(args: Args) -> None:
    """Time all runners in turns, and write a row for each turn."""
    check_outputs(
        args.out.with_suffix(""), [args.out.suffix], column="runner", owner="this timing"
    )
    rows: list[Row] = []
    for number in range(args.rounds):
        for name in args.runners if number % 2 == 0 else reversed(args.runners):
            runs = args.runs // 2 if name == ALONE else args.runs
            with TemporaryDirectory() as folder:
                seconds = TIMED[name](runs, args.steps, Path(folder))
            rows.append(
                {"runner": name, "repeat": number, "runs": runs, "seconds": seconds}
                | {"steps_per_second": runs * args.steps / seconds, "commit": source_commit()}
            )
            write_table(args.out, rows)
    beside = rate_over(rows, ALONE) if ALONE in args.runners else None
    for (runner,), own in grouped(rows, "runner").items():
        times = "" if beside is None else f", {summarize(own, beside)} times"
        print(f"{runner}: {summarize(own, 'seconds')} s{times}")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
