"""The studies behind the README: curiosity against plain soft actor-critic, seed by seed."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from deep_curiosity.training import Settings
from deep_curiosity.training.study import Task, run_study, summarize

SMALL = Settings(hidden_dim=64, learning_rate=1e-3, log_interval=1_000, evaluation_interval=1_000)
PENDULUM_STEPS = 200  # of an episode; no step pays more than 1, so no return is above this


@dataclass(frozen=True)
class Args:
    """What to study, and where."""

    study: Literal["sparse", "mountain_car", "dense"] = "sparse"
    """Sparse rewards with action costs; MountainCarContinuous-v0; HalfCheetah-v5."""
    seeds: int = 5
    """Seeds of each agent on each task."""
    runs: Path = Path("runs/study")
    """Folder for the runs; finished ones there are not run again."""
    out: Path = Path("docs/study")
    """Folder for table and picture."""
    workers: int = 2
    """Processes at a time."""


def main() -> None:
    """Run a study and print its table."""
    args = tyro.cli(Args, description=__doc__)
    tasks, agents = STUDIES[args.study]
    rows = run_study(
        tasks,
        agents,
        seeds=range(args.seeds),
        runs=args.runs / args.study,
        out=args.out / args.study,
        workers=args.workers,
    )
    print(summarize(rows))


STUDIES: dict[str, tuple[list[Task], dict[str, dict[str, Any]]]] = {}


if __name__ == "__main__":
    main()
