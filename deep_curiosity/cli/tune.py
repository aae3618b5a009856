"""Choose settings: trials of tasks x seeds, on any engine; the best are written as they come."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from deep_curiosity.arguments import read_arguments
from deep_curiosity.configuration import MOST_SEED, setting
from deep_curiosity.experiments.engines import EngineArgs, make_engine
from deep_curiosity.experiments.studies import find_search


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
    """Path of best settings, table and figure, without suffix; results/NAME by default."""


def main(arguments: Sequence[str]) -> int:
    """Search, and say what is best."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity tune")
    name, search = find_search(args.search)
    from deep_curiosity.experiments.tuner import tune  # needs what `find_search` asks for

    out = args.out or Path("results") / name
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
    print(f"best settings, trials and picture in {out}.json, .csv and .png")
    return 0
