"""The pages of the site: their programs run, their commands exist, their links lead somewhere."""

import re
import shlex
import sys

import pytest

from deep_curiosity.cli import COMMANDS, main
from tests.docs.pages import ROOT

pytestmark = pytest.mark.slow

DOCS = ROOT / "docs"
PAGES = [
    DOCS / "index.md",
    DOCS / "tutorial.md",
    DOCS / "faq.md",
    *sorted(DOCS.glob("guide/*.md")),
]
FENCE = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SHORT = "--learning-starts 100 --evaluation-episodes 1 --hidden-dim 16"
named = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)


def shortened(words):
    """A command of a page in a length that a test has time for."""
    if words[0] == "study":
        words = [*words, "--set", "total_steps=200", *"hidden_dim=16 learning_starts=100".split()]
    if words[0] == "check":
        words = [*words, "--num-steps", "300", "--num-updates", "5"]
    if words[0] == "train" and "--resume" not in words:
        del words[words.index("--hidden-dim") : words.index("--hidden-dim") + 2]
        words += SHORT.split()
    if "--total-steps" in words:
        place = words.index("--total-steps") + 1
        words[place] = "240" if "--resume" in words else "200"
    return words


@named
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    names = {"__name__": page.stem}
    for kind, text in FENCE.findall(page.read_text()):
        if kind == "python":
            exec(compile(text, str(page), "exec"), names)
            continue
        for line in text.splitlines():
            program, *words = shlex.split(line, comments=True) or [""]
            if program == "deep-curiosity":
                assert main(shortened(words)) == 0, line


@named
def test_commands_exist_and_links_lead_somewhere(page):
    text = page.read_text()
    for command in re.findall(r"`?deep-curiosity ([a-z]+)", text):
        assert command in COMMANDS
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", text)
    assert not [link for link in links if not (page.parent / link).exists()]


def test_every_page_is_in_the_contents():
    contents = "".join(re.findall(r"```{toctree}(.*?)```", (DOCS / "index.md").read_text(), re.S))
    listed = {name for name in contents.split() if (DOCS / f"{name}.md").exists()}
    there = {str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.md")}
    summaries = {name for name in there if (DOCS / f"{name}.csv").exists()}
    assert there - summaries - {"index", "benchmark/zen4/README"} <= listed
