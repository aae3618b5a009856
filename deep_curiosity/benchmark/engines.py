"""What an engine costs: one study by one worker, by two, and by two workers of Ray, in turns.

python -m deep_curiosity.benchmark.engines --steps 8000

A machine whose speed drifts tells workers apart only where their turns are short:

python -m deep_curiosity.benchmark.engines --steps 8000 --rounds 5 --runs 4 \
    --engines "local, 1 worker" "local, 2 workers" --out docs/benchmark/engines_short.csv
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import tyro

from deep_curiosity.benchmark.tables import grouped, rate_over, summarize
from deep_curiosity.experiments.engines.base import Engine
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.engines.ray import RayEngine
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.study import Row, Study, Task
from deep_curiosity.experiments.tables import write_table
from deep_curiosity.training.config import Config
from deep_curiosity.training.log import CONFIG, SUMMARY
from deep_curiosity.training.source import source_commit

ALONE = "local, 1 worker"
ENGINES: dict[str, Callable[[], Engine]] = {
    ALONE: lambda: LocalEngine(1),
    "local, 2 workers": lambda: LocalEngine(2),
    "ray, 2 workers": lambda: RayEngine(num_cpus=2),
}


@dataclass(frozen=True)
class Args:
    """How much, and where to."""

    rounds: int = 3
    """In each of which every engine has its turn; in every second one in the opposite order."""
    runs: int = 12
    """Of the study; one worker does half of them, which takes as long."""
    steps: int = 12_000
    """Environment steps of a run, which takes about a minute."""
    engines: tuple[Literal["local, 1 worker", "local, 2 workers", "ray, 2 workers"], ...] = (
        "local, 1 worker",
        "local, 2 workers",
        "ray, 2 workers",
    )
    """Which of them."""
    out: Path = Path("docs/benchmark/engines.csv")
    """CSV file that receives a row for every turn."""


def time_study(make_engine: Callable[[], Engine], runs: int, steps: int, folder: Path) -> float:
    """Seconds of a study from the beginning of its first run to the end of its last one.

    Raises:
        RuntimeError: If a run fails.
    """
    config = Config.of(total_steps=steps, hidden_dim=64, update_to_data=0.5, compile="off")
    study = Study([Task("pendulum", config)], {"curiosity": {}}, seeds=runs)
    if run_study(study, runs=folder / "runs", out=folder / "table", engine=make_engine()):
        raise RuntimeError(f"`runs` must come to their end to be timed, got failures in {folder}.")
    begun = min(path.stat().st_mtime for path in folder.rglob(CONFIG))
    return max(path.stat().st_mtime for path in folder.rglob(SUMMARY)) - begun


def main(args: Args) -> None:
    """Time all engines in turns, and write a row for each turn."""
    rows: list[Row] = []
    for number in range(args.rounds):
        for name in args.engines if number % 2 == 0 else reversed(args.engines):
            runs = args.runs // 2 if name == ALONE else args.runs
            with TemporaryDirectory() as folder:
                seconds = time_study(ENGINES[name], runs, args.steps, Path(folder))
            rows.append(
                {"runner": name, "repeat": number, "runs": runs, "seconds": seconds}
                | {"steps_per_second": runs * args.steps / seconds, "commit": source_commit()}
            )
            write_table(args.out, rows)
    times_one_worker = rate_over(rows, ALONE)
    for (runner,), own in grouped(rows, "runner").items():
        print(f"{runner}: {summarize(own, 'seconds')} s, {summarize(own, times_one_worker)} times")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
