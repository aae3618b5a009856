"""Choose settings: trials of tasks x seeds, on any engine; the best are written as they come."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from deep_curiosity.experiments.engines import EngineArgs, make_engine
from deep_curiosity.experiments.studies import find_search


@dataclass(frozen=True, kw_only=True)
class Args(EngineArgs):
    """What to choose, and where."""

    search: Annotated[str, tyro.conf.Positional]
    """Name of a search, such as agent; or a file of your own that holds SEARCHES, as FILE.py or
    FILE.py:NAME."""
    trials: int = 50
    """Settings to try, those of earlier calls included."""
    at_once: int = 1
    """Trials that are chosen together and computed side by side."""
    pruner: Literal["median", "hyperband", "none"] = "median"
    """Which trials are stopped early."""
    seed: int = 0
    """Of what is tried."""
    runs: Path = Path("runs")
    """Folder for the runs and the list of trials; the same command goes on with what is there."""
    storage: str | None = None
    """Of Optuna, as a URL, instead of a SQLite file in the folder of the runs."""
    out: Path | None = None
    """Path of best settings, table and figure, without suffix; results/NAME by default."""


def main(args: Args) -> str:
    """Search; say what is best."""
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
    return f"best settings, trials and picture in {out}.json, .csv and .png"


if __name__ == "__main__":
    try:
        print(main(tyro.cli(Args, description=__doc__)))
    except (ImportError, OSError, TypeError, ValueError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
