"""Choosing settings by the command line; the search itself is a stand-in."""

import pytest

from deep_curiosity.cli import main

pytest.importorskip("optuna")


@pytest.fixture
def found(monkeypatch, tmp_path):
    """Have a search in this folder leave some files, by their endings; what it was asked."""
    monkeypatch.chdir(tmp_path)
    asked = []

    def find(*endings):
        def tune(search, *, out, **options):
            asked.append(options | {"out": out})
            for ending in endings:
                out.with_name(f"{out.name}{ending}").touch()

        monkeypatch.setattr("deep_curiosity.experiments.tuner.tune", tune)
        return asked

    return find


def test_the_files_that_are_named_at_the_end_are_there(found, capsys):
    asked = found(".json", ".csv", ".png")
    assert main(["tune", "agent", "--out", "gamma0.1", "--trials", "3"]) == 0
    assert capsys.readouterr().out == (
        "best settings in gamma0.1.json, trials in gamma0.1.csv, picture in gamma0.1.png\n"
    )
    assert asked[0]["trials"] == 3


def test_where_no_trial_was_complete_no_best_settings_are_named(found, capsys):
    found(".csv")
    assert main(["tune", "agent", "--out", "gamma0.1"]) == 1
    assert capsys.readouterr().out == "no trial was complete; trials in gamma0.1.csv\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "best.json"], "`out` must be a path of a file without its suffix, got best"),
        (["--out", "folder"], "`out` must be a file, got folder.json, which is a folder"),
        (["--out", "file/best"], "`out` must be a folder, got file, where file is a file"),
        (["--runs", "file"], "`runs` must be a folder, got file, where file is a file"),
    ],
    ids=str,
)
def test_what_could_not_be_written_is_refused_before_anything_is_tried(
    found, refusal, tmp_path, arguments, message
):
    asked = found()
    (tmp_path / "file").touch()
    (tmp_path / "folder.json").mkdir()
    assert message in refusal("tune", "agent", *arguments)
    assert not asked


def test_what_is_not_of_a_search_or_no_storage_is_answered_in_one_line(
    refusal, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    answer = refusal("tune", "agent", "--storage", "garbage")
    assert (
        answer.startswith("error: `storage` must be the URL of a database")
        and "'garbage'" in answer
    )
    (tmp_path / "mine.json").write_text("mine")
    answer = refusal("tune", "agent", "--out", "mine")
    assert answer.startswith("error: `out` must name new files, or those of a search")
    assert (tmp_path / "mine.json").read_text() == "mine"
