import subprocess
import sys
from pathlib import Path

import pytest

from deep_curiosity.experiments.paper.clever_random import CleverRandomSummary
from deep_curiosity.experiments.paper.neighbours import NeighbourRow
from deep_curiosity.experiments.paper.page import format_page
from deep_curiosity.experiments.paper.rate_return import RateReturnSummary
from deep_curiosity.experiments.paper.reliable_unreliable import FarSightedRow
from deep_curiosity.experiments.paper.samples import Quantities

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs/paper"


def test_page_states_the_numbers_of_every_section():
    page = format_page(
        CleverRandomSummary(3e-8, 0.04, 0.98, 0.999999, 0.002, 10.0),
        [
            FarSightedRow(0.07, 0.5, 0.6464, 0.5858, 0.5644),
            FarSightedRow(0.07, 1, 0.75, 2 / 3, 0.585),
        ],
        RateReturnSummary(9.5, 0.9, 8.9, 9.9, 1.79),
        Quantities(-0.51, -0.46, -0.5, -0.33, -0.3),
        [
            NeighbourRow("grid", method, 1.0, 0.5, 0.2, 0.0, converged)
            for method, converged in (("R-MAX", None), ("curious", True), ("far-sighted", False))
        ],
    )
    assert "| 0.5 | 0.6464 | 0.5858 | 0.5644 |\n| 1 | 0.7500 | 0.6667 | 0.5850 |" in page
    for text in (
        "to within 3e-08",
        "any: 0.04 to 0.98",
        "reports 10.0 bits",
        "is 9.5000",
        "I({X, A}",
        "as they were then: far-sighted in grid.",
    ):
        assert text in page
    assert "Q-learning -0.30" in page


@pytest.mark.slow
def test_script_writes_the_tables_and_the_page_of_the_documentation(tmp_path):
    command = [sys.executable, ROOT / "scripts/paper.py", "--out", tmp_path / "paper"]
    subprocess.run(command, check=True)
    names = {path.name for path in (tmp_path / "paper").iterdir()}
    assert names == {path.name for path in DOCS.iterdir()}
    for name in names:
        if not name.endswith(".png"):
            assert (tmp_path / "paper" / name).read_bytes() == (DOCS / name).read_bytes()
