"""Run a study on this machine and on a Ray cluster that loses workers and a node; compare them."""

import shlex
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from deep_curiosity.arguments import check_file, read_arguments
from deep_curiosity.cli import answering
from deep_curiosity.configuration import MOST_SEED, Group, setting
from deep_curiosity.experiments.cluster_torture import (
    make_study,
    page,
    torture_cluster,
    two_nodes,
)


@dataclass(frozen=True)
class Args(Group):
    """How much, and where to."""

    seeds: int = setting(6, at_most=10_000)
    """Of each of two agents on each of two tasks: four runs a seed."""
    total_steps: int = setting(400)
    """Of a run."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Of the moments at which workers and node are killed, which are of this process's making."""
    pause: float = setting(30.0, at_least=0)
    """Seconds, at most, from one kill to the next."""
    out: Path = Path("docs/reliability/cluster.md")
    """Page that tells what came of it."""

    def __post_init__(self) -> None:
        """Refuse what cannot be, before anything is run."""
        super().__post_init__()
        check_file("out", self.out)


def main(args: Args) -> int:
    """Write what came of it; return whether anything was lost, doubled or changed."""
    study = make_study(args.seeds, args.total_steps)
    with tempfile.TemporaryDirectory() as scratch, two_nodes() as cluster:
        comparison = torture_cluster(
            study, Path(scratch), cluster, seed=args.seed, pause=args.pause
        )
    command = shlex.join(["python", "scripts/torture_cluster.py", *sys.argv[1:]])
    text = page(comparison, command)
    args.out.write_text(text)
    print(text)
    return int(not comparison.is_sound)


if __name__ == "__main__":
    with answering():
        sys.exit(main(read_arguments(Args, description=__doc__)))
