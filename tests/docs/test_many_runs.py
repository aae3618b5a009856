import csv
import re
from pathlib import Path

import pytest

from tests.docs.pages import run_blocks

PAGE = Path(__file__).parents[2] / "docs/many_runs.md"


def test_the_blocks_run_as_written(monkeypatch, tmp_path):
    pytest.importorskip("optuna")
    monkeypatch.chdir(tmp_path)
    names = run_blocks(PAGE)
    assert names["failed"] == 0
    with Path("results/mine.csv").open() as file:
        assert [row["agent"] for row in csv.DictReader(file)] == ["curiosity", "plain"]
    assert names["SEARCHES"]["mine"].seeds == 3


def test_every_file_that_is_linked_is_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)", PAGE.read_text())
    assert not [link for link in links if not (PAGE.parent / link).exists()]
