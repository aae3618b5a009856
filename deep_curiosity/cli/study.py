"""Run a study, tasks x agents x seeds, and write its table, summary and figure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.experiments.grid import overridden, part_of, run_study
from deep_curiosity.experiments.studies import find_study
from deep_curiosity.training.command_line import read_settings


@dataclass(frozen=True)
class Args:
    """What to study, and where."""

    study: Annotated[str, tyro.conf.Positional]
    """Name of a study, such as sparse, bonuses, rate or noise; or a file of your own that holds
    STUDIES, as FILE.py or FILE.py:NAME."""
    seeds: int | None = None
    """Seeds of each agent on each task; by default as many as the study is documented with."""
    tasks: tuple[str, ...] = ()
    """Only these tasks of the study."""
    agents: tuple[str, ...] = ()
    """Only these agents of the study."""
    set: tuple[str, ...] = ()
    """Settings of all runs that differ from the study's, as name=value: total_steps=24000."""
    runs: Path = Path("runs")
    """Folder for the runs; finished ones there are not run again."""
    out: Path | None = None
    """Path of table, summary and figure, without suffix; by default as documented."""
    workers: int = 2
    """Processes at a time."""


def main(arguments: Sequence[str]) -> int:
    """Run the study; return whether runs failed."""
    args = tyro.cli(Args, args=arguments, description=__doc__, prog="deep-curiosity study")
    name, study, folder = find_study(args.study)
    study = replace(part_of(study, args.tasks, args.agents), seeds=args.seeds or study.seeds)
    study = overridden(study, read_settings(args.set))
    out = args.out or folder / "-".join((name, *args.tasks, *args.agents))
    failed = run_study(study, runs=args.runs / name, out=out, workers=args.workers)
    return int(failed > 0)
