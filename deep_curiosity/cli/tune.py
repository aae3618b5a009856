"""Choose settings: trials of tasks x seeds, on any engine; the best are written as they come."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from deep_curiosity.arguments import check_folder, read_arguments
from deep_curiosity.cli.study import check_paths
from deep_curiosity.configuration import MOST_SEED, setting
from deep_curiosity.experiments.engines import EngineArgs, make_engine
from deep_curiosity.experiments.search import ENDINGS
from deep_curiosity.experiments.studies import find_search
from deep_curiosity.experiments.tables import output_path


@dataclass(frozen=True, kw_only=True)
class Args(EngineArgs):
    """What to choose, and where."""

    search: Annotated[str, tyro.conf.Positional]
    """Name of a search, such as agent; or a file of your own that holds SEARCHES, as FILE.py or
    FILE.py:NAME."""
    trials: int = setting(50, at_most=100_000)
    """Settings to try, those of earlier calls included."""
    at_once: int = setting(1, at_most=1_024)
    """Trials that are chosen together and computed side by side."""
    pruner: Literal["median", "hyperband", "none"] = "median"
    """Which trials are stopped early."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Of what is tried."""
    runs: Path = Path("runs")
    """Folder for the runs and the list of trials; the same command goes on with what is there."""
    storage: str | None = None
    """Of Optuna, as a URL, instead of a SQLite file in the folder of the runs."""
    out: Path | None = None
    """Path of best settings, table and figure, without suffix; results/NAME by default. Files
    there that are none of a search are left alone."""

    def __post_init__(self) -> None:
        """Refuse a folder that cannot be, before anything is run."""
        super().__post_init__()
        check_folder("runs", self.runs)


def main(arguments: Sequence[str]) -> int:
    """Search, and say what is best; return whether no trial was complete."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity tune")
    name, search = find_search(args.search)
    from deep_curiosity.experiments.tuner import tune  # needs what `find_search` asks for

    out = Path("results") / name if args.out is None else args.out
    check_paths(out, ENDINGS)
    tune(
        search,
        trials=args.trials,
        runs=args.runs / f"tune-{name}",
        out=out,
        engine=make_engine(args, args.runs),
        storage=args.storage,
        pruner=args.pruner,
        at_once=args.at_once,
        seed=args.seed,
    )
    print(what_is_in(out))
    return int(not output_path(out, ".json").exists())


def what_is_in(out: Path) -> str:
    """The files that a search has written, for its user."""
    best, table, figure = (output_path(out, ending) for ending in ENDINGS)
    if not best.exists():
        return f"no trial was complete; trials in {table}"
    return f"best settings in {best}, trials in {table}, picture in {figure}"
