"""The page that states each number beside the one that the paper prints."""

from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from deep_curiosity.experiments.paper.clever_random import (
    CleverRandomSummary,
    write_clever_random,
)
from deep_curiosity.experiments.paper.neighbours import NeighbourRow, write_neighbours
from deep_curiosity.experiments.paper.rate_return import RateReturnSummary, write_rate_return
from deep_curiosity.experiments.paper.reliable_unreliable import (
    FarSightedRow,
    write_reliable_unreliable,
)
from deep_curiosity.experiments.paper.samples import Quantities, write_samples
from deep_curiosity.experiments.tables import check_page

TITLE = "# The paper in numbers"


def write_paper(folder: Path, seed: int = 0) -> None:
    """Writes all tables and figures, and the page that describes them.

    Args:
        folder: Folder of the files, made if it is missing.
        seed: Seed of the random policies, environments and samples.

    Raises:
        FileExistsError: If the folder holds a page or tables of something else.
    """
    check_page(folder, TITLE)
    folder.mkdir(parents=True, exist_ok=True)
    clever = write_clever_random(folder, seed)
    reliable = write_reliable_unreliable(folder, seed)
    dual = write_rate_return(folder, seed)
    slopes = write_samples(folder, seed)
    neighbours = write_neighbours(folder, seed)
    page = format_page(clever, reliable, dual, slopes, neighbours)
    (folder / "README.md").write_text(page)


def format_page(
    clever: CleverRandomSummary,
    reliable: Sequence[FarSightedRow],
    dual: RateReturnSummary,
    slopes: Quantities,
    neighbours: Sequence[NeighbourRow],
) -> str:
    """The text of the page, from the numbers of its sections."""
    lines = [
        f"| {row.curiosity_discount:g} | {row.pi_stay_given_0:.4f} "
        f"| {row.p_state_is_0:.4f} | {row.bits:.4f} |"
        for row in reliable
    ]
    under_way = [
        f"{row.method} in {row.environment}" for row in neighbours if row.converged is False
    ]
    template = resources.files(__package__).joinpath("page.md").read_text(encoding="utf-8")
    return template.format(
        clever=clever,
        reliable_rows="\n".join(lines),
        limit_bits=reliable[-1].bits,
        dual=dual,
        slopes=slopes,
        under_way="; ".join(under_way) or "none",
    )
