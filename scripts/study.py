"""Run a study, tasks x agents x seeds, and write its table, summary and figure."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.experiments.engines import EngineArgs, make_engine
from deep_curiosity.experiments.grid import overridden, part_of, run_study
from deep_curiosity.experiments.studies import find_study
from deep_curiosity.training.command_line import read_settings


@dataclass(frozen=True, kw_only=True)
class Args(EngineArgs):
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
    """Path of table, summary and figure, without suffix; by default as documented. Files there
    that are none of a study are left alone."""


def main(args: Args) -> int:
    """Run the study; return how many runs failed."""
    name, study, folder = find_study(args.study)
    study = replace(part_of(study, args.tasks, args.agents), seeds=args.seeds or study.seeds)
    study = overridden(study, read_settings(args.set))
    out = args.out or folder / "-".join((name, *args.tasks, *args.agents))
    engine = make_engine(args, args.runs)
    return run_study(study, runs=args.runs / name, out=out, engine=engine)


if __name__ == "__main__":
    try:
        sys.exit(min(main(tyro.cli(Args, description=__doc__)), 1))
    except (ImportError, OSError, TypeError, ValueError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
