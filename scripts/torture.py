"""Kill runs at random moments, continue them, and compare them with ones left in peace."""

import shlex
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro

from deep_curiosity.experiments.tables import write_table
from deep_curiosity.experiments.torture import as_lines, torture
from deep_curiosity.training.source import source_commit


@dataclass(frozen=True)
class Args:
    """How much, and where to."""

    kills: int = 1_000
    """SIGKILLs, over one and four environments with each prior; of children of this process."""
    seed: int = 0
    """Of the moments at which they come."""
    seconds: float = 900.0
    """After which no new run is begun."""
    out: Path | None = None
    """CSV file that receives the figures; must not exist yet. Folders of runs are temporary."""


def main(args: Args) -> int:
    """Print what came of it; return how many faults there were."""
    if args.out is not None and args.out.exists():
        raise FileExistsError(f"`out` must name a new file, got {args.out}.")
    origin = {"commit": source_commit(), "command": shlex.join(["python", *sys.argv])}
    with tempfile.TemporaryDirectory() as scratch:
        tallies = torture(
            Path(scratch) / "runs", kills=args.kills, seed=args.seed, seconds=args.seconds
        )
    print(as_lines(tallies))
    if args.out is not None:
        rows = [{"variant": name} | vars(tally) | origin for name, tally in tallies.items()]
        write_table(args.out, rows)
    return sum(tally.faults for tally in tallies.values())


if __name__ == "__main__":
    try:
        sys.exit(min(main(tyro.cli(Args, description=__doc__)), 1))
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")
