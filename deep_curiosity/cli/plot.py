"""Draw learning curves of many runs, grouped by agent, with intervals: a picture and a page."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.arguments import read_arguments
from deep_curiosity.cli.study import check_paths
from deep_curiosity.configuration import Group
from deep_curiosity.experiments.curves import (
    ENDINGS,
    check_place,
    find_runs,
    known_tags,
    plot_png,
    read_runs,
    write_page,
)
from deep_curiosity.experiments.tables import output_path


@dataclass(frozen=True)
class Args(Group):
    """What to draw."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of runs, or folders below which runs lie."""
    out: Path = Path("runs/curves")
    """Path of the picture (.png) and the page (.html), without suffix. The page works without a
    network: hover for numbers, choose agents and quantities. Files there are left alone, unless
    the page among them is a plot's: then both are written anew."""
    tags: tuple[str, ...] = ()
    """Quantities of progress.csv, such as eval/return; by default returns, success, coverage and
    nats, as far as the runs have them. The picture shows the first alone where none is named."""
    group_by: tuple[str, ...] = ()
    """Settings that make an agent, such as bonus; by default all in which the runs differ, but
    for the seed."""

    def __post_init__(self) -> None:
        """Refuse what cannot be written, before anything is read."""
        super().__post_init__()
        if not self.runs:
            raise ValueError("`runs` must name a folder at least, got none.")
        check_paths(self.out, ENDINGS)
        check_place(self.out)


def main(arguments: Sequence[str]) -> int:
    """Write the picture and the page, and say where they are."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity plot")
    runs = read_runs(find_runs(args.runs), args.group_by)
    tags = known_tags(runs, args.tags)
    page, picture = (output_path(args.out, ending) for ending in ENDINGS)
    try:
        write_page(page, runs, tags)
        plot_png(picture, runs, args.tags or tags[:1])
    except OSError as error:
        raise OSError(
            f"`out` must name files that can be written, got {args.out}: {error.strerror}."
        ) from error
    print(f"{len(runs)} runs in {picture} and {page}")
    return 0
