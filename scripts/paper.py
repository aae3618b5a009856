"""Computes every number and figure of the paper's two illustrations, and writes docs/paper/.

python scripts/paper.py
"""

from dataclasses import dataclass
from pathlib import Path

from deep_curiosity.arguments import check_folder, read_arguments
from deep_curiosity.cli import answering
from deep_curiosity.configuration import MOST_SEED, Group, setting
from deep_curiosity.experiments.paper.page import write_paper


@dataclass(frozen=True)
class Args(Group):
    """Folder and seed of the tables, the figures and their page."""

    out: Path = Path("docs/paper")
    """Folder for the tables, the figures and their README.md."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Seed of the random policies, environments and samples."""

    def __post_init__(self) -> None:
        """Refuse a folder that cannot be, before anything is computed."""
        super().__post_init__()
        check_folder("out", self.out)


def main(args: Args) -> None:
    """Writes the tables, the figures and the page."""
    write_paper(args.out, args.seed)


if __name__ == "__main__":
    with answering():
        main(read_arguments(Args, description=__doc__))
