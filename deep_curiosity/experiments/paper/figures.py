"""Style of the figures, applied while a figure is drawn and restored afterwards."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

BLUE, ORANGE, GREEN, GREY = "#1f5fa8", "#d9731a", "#3a8f4d", "#777777"
STYLE: dict[Any, Any] = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
DOTS_PER_INCH = 130


@contextmanager
def open_figure(path: Path, width: float, height: float) -> Iterator[Figure]:
    """Yields an empty figure and saves it as PNG when the block ends.

    Args:
        path: File to write.
        width: Width in inches.
        height: Height in inches.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(
            figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1)
        )
        yield figure
        figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": None})
