"""Kill a search for settings on its way, continue it, and compare it with one left in peace."""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from deep_curiosity.arguments import check_folder, read_arguments
from deep_curiosity.cli import answering
from deep_curiosity.configuration import MOST_SEED, Group, setting
from deep_curiosity.experiments.studies import find_search
from deep_curiosity.experiments.tables import check_page
from deep_curiosity.experiments.tuner_torture import TITLE, Plan, page, torture_search


@dataclass(frozen=True)
class Args(Group):
    """How much, and where to."""

    search: str = "short"
    """Name of a search, or a file of your own, as `deep-curiosity tune` takes it."""
    trials: int = setting(30, at_most=100_000)
    """Settings that are tried."""
    kills: int = setting(2, at_least=0, at_most=100)
    """SIGKILLs, each after another trial."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Of the moments at which they come."""
    seeds: int = setting(10, at_most=10_000)
    """Seeds on which default and best settings are scored."""
    workers: int = setting(2, at_most=1_024)
    """Processes at a time."""
    runs: Path = Path("runs/torture_search")
    """Folder for the runs; the same command goes on with what is there."""
    out: Path = Path("docs/tuning")
    """Folder for tables, pictures and their README.md."""

    def __post_init__(self) -> None:
        """Refuse what cannot be, before anything is run."""
        super().__post_init__()
        check_folder("runs", self.runs)
        if self.kills >= self.trials:
            raise ValueError(f"`kills` must be fewer than the trials, got {self.kills}.")


def main(args: Args) -> int:
    """Write what came of it; return whether a trial was lost, doubled or changed."""
    check_page(args.out, TITLE)
    _, search = find_search(args.search)
    plan = Plan(args.search, search, args.trials, args.kills, args.seed, args.workers)
    comparison = torture_search(plan, args.runs, args.out, seeds=args.seeds)
    command = shlex.join(["python", "scripts/torture_search.py", *sys.argv[1:]])
    (args.out / "README.md").write_text(page(comparison, command))
    print(f"See {args.out / 'README.md'}")
    return int(not comparison.is_sound)


if __name__ == "__main__":
    with answering():
        sys.exit(main(read_arguments(Args, description=__doc__)))
