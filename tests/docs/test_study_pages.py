"""The pages of the studies: each study has its command there, and each linked file is there."""

import re

import pytest

from deep_curiosity.experiments.studies import (
    FOLDERS,
    LIBRARIES,
    comparisons,
    illustrations,
    results,
    sweeps,
)
from tests.docs.pages import ROOT

PAGES = {
    "docs/study": [*comparisons.STUDIES, *illustrations.STUDIES, *LIBRARIES],
    "docs/sweeps": [*sweeps.STUDIES],
    "docs/results": [*results.STUDIES],
}


@pytest.mark.parametrize("folder", PAGES)
def test_every_study_has_its_command_on_its_page_and_no_other_is_there(folder):
    page = (ROOT / folder / "README.md").read_text()
    commands = re.findall(r"^deep-curiosity study (\w+)", page, flags=re.M)
    assert set(commands) == set(PAGES[folder])
    assert folder in {str(path) for path in FOLDERS.values()}


def test_make_figures_runs_every_study():
    recipe = (ROOT / "Makefile").read_text().partition("for study in ")[2].partition("; do")[0]
    words = re.findall(r'"(\w+) [^"]*"|(\w+)', recipe)
    assert {quoted or word for quoted, word in words} == {
        name
        for folder, names in PAGES.items()
        if folder != "docs/results"  # two cores compute them for nights
        for name in names
    }


@pytest.mark.parametrize("folder", PAGES)
def test_every_file_that_is_linked_is_there(folder):
    page = (ROOT / folder / "README.md").read_text()
    links = re.findall(r"\]\((?!https?:)([^)#]+)", page)
    assert not [link for link in links if not (ROOT / folder / link).exists()]
