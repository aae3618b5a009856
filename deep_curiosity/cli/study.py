"""Run a study, tasks x agents x seeds, and write its table, summary and figure."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.arguments import check_file, check_folder, read_arguments
from deep_curiosity.configuration import setting
from deep_curiosity.experiments.engines import EngineArgs, make_engine
from deep_curiosity.experiments.grid import ENDINGS, overridden, part_of, run_study
from deep_curiosity.experiments.studies import find_study
from deep_curiosity.experiments.tables import output_path
from deep_curiosity.training.command_line import read_settings


@dataclass(frozen=True, kw_only=True)
class Args(EngineArgs):
    """What to study, and where."""

    study: Annotated[str, tyro.conf.Positional]
    """Name of a study, such as sparse, bonuses, rate or noise; or a file of your own that holds
    STUDIES, as FILE.py or FILE.py:NAME."""
    seeds: int | None = setting(None, at_most=10_000)
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

    def __post_init__(self) -> None:
        """Refuse folders that cannot be, before anything is run."""
        super().__post_init__()
        check_folder("runs", self.runs)
        if self.out is not None:
            check_paths(self.out, ENDINGS)


def check_paths(out: Path, endings: Sequence[str]) -> None:
    """Reject a path without suffix that cannot become files with these.

    Raises:
        ValueError: Naming the option and the path.
    """
    if out.suffix in endings or out.name in ("", ".."):
        raise ValueError(f"`out` must be a path of a file without its suffix, got {out}.")
    for ending in endings:
        check_file("out", output_path(out, ending))


def main(arguments: Sequence[str]) -> int:
    """Run the study; return whether runs failed."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity study")
    name, study, folder = find_study(args.study)
    study = part_of(study, args.tasks, args.agents)
    if args.seeds is not None:
        study = replace(study, seeds=args.seeds)
    study = overridden(study, read_settings(args.set))
    out = args.out or folder / "-".join((name, *args.tasks, *args.agents))
    engine = make_engine(args, args.runs)
    failed = run_study(study, runs=args.runs / name, out=out, engine=engine)
    return int(failed > 0)
