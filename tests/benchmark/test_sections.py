from typing import get_args, get_type_hints

import pytest
import torch

from deep_curiosity.benchmark import run, sections
from deep_curiosity.benchmark.run import note_machine, run_benchmark, write_page
from deep_curiosity.benchmark.sections import SECTIONS, Benchmark, LeftOutError, Section
from deep_curiosity.benchmark.tables import read_rows
from deep_curiosity.experiments.tables import read_table


def test_every_section_can_be_chosen():
    (choices, _) = get_args(get_type_hints(Benchmark)["only"])
    assert get_args(choices) == tuple(SECTIONS)


def test_a_section_leaves_its_tables_and_its_text(tmp_path, monkeypatch, capsys):
    def measure(benchmark):
        return {"rows": [{"repeat": repeat} for repeat in range(benchmark.repeats)]}

    def refuse(benchmark):
        raise LeftOutError("there is nothing to measure")

    def text(out):
        return f"## Sizes\n\n{len(read_rows(out / 'rows.csv'))} rows\n"

    monkeypatch.setitem(SECTIONS, "scaling", Section(measure, text))
    run_benchmark(Benchmark(repeats=3, out=tmp_path, only="scaling"), "make bench")
    assert "## Sizes\n\n3 rows\n" in (tmp_path / "README.md").read_text()
    assert "```sh\nmake bench\n```" in (tmp_path / "README.md").read_text()
    monkeypatch.setitem(SECTIONS, "scaling", Section(refuse, text))
    run_benchmark(Benchmark(repeats=2, out=tmp_path, only="scaling"), "make bench")
    assert "scaling: left out, there is nothing to measure" in capsys.readouterr().out
    assert len(read_rows(tmp_path / "rows.csv")) == 3


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_its_section_is_left_out(tmp_path, capsys):
    run_benchmark(Benchmark(out=tmp_path, only="cuda"), "make bench")
    assert "cuda: left out, torch sees no GPU" in capsys.readouterr().out


def test_narrow_agents_are_all_of_one_width(monkeypatch):
    given = {}

    def measure(runners, own, *, repeats, steps):
        given.update(runners=runners, own=own)
        return [], []

    monkeypatch.setattr(sections, "measure_agents", measure)
    tables = sections.measure_narrow_agents(Benchmark(only="narrow"))
    assert list(tables) == ["narrow", "narrow_processes"]
    assert {config.agent.hidden_dim for config in given["own"].values()} == {64}
    theirs = [runner for name, runner in given["runners"].items() if name not in given["own"]]
    assert len(theirs) >= 2 and all(runner.args[-1] == 64 for runner in theirs)
    for name, config in given["own"].items():
        assert given["runners"][name].args == (config,)


def test_a_machine_is_noted_once_for_each_section(tmp_path):
    for command in ("first", "second"):
        note_machine(tmp_path / "machine.csv", "bonus", command)
    (row,) = read_rows(tmp_path / "machine.csv")
    assert row["section"] == "bonus" and row["command"] == "second" and row["cores"] >= 1


def test_a_commit_of_digits_alone_is_kept_as_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "source_commit", lambda: "0054877")
    for section in ("vector", "bonus"):
        note_machine(tmp_path / "machine.csv", section, "make bench")
    rows = read_table(tmp_path / "machine.csv")
    assert [row["commit"] for row in rows] == ["0054877", "0054877"]


def test_the_committed_page_is_that_of_the_committed_tables(tmp_path, request):
    committed = request.config.rootpath / "docs" / "benchmark"
    for path in committed.glob("*.csv"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    write_page(tmp_path)
    assert (tmp_path / "README.md").read_text() == (committed / "README.md").read_text()
