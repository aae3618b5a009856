"""Computes every number and figure of the paper's two illustrations, and writes docs/paper/.

python scripts/paper.py
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from deep_curiosity.experiments.paper.page import write_paper


@dataclass
class Args:
    """Folder and seed of the tables, the figures and their page."""

    out: Path = Path("docs/paper")  # Folder for the tables, the figures and their README.md.
    seed: int = 0  # Seed of the random policies, environments and samples.


def main(args: Args) -> None:
    """Writes the tables, the figures and the page."""
    write_paper(args.out, args.seed)


if __name__ == "__main__":
    try:
        main(tyro.cli(Args, description=__doc__))
    except OSError as error:
        sys.exit(f"error: {error}")
