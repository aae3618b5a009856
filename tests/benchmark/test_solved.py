import math
from dataclasses import replace

import pytest

from deep_curiosity.benchmark import solved
from deep_curiosity.benchmark.solved import Args, flags_of, summary_of, time_to_solved
from deep_curiosity.experiments.studies.comparisons import MAZE, MOUNTAIN_CAR, PENDULUM
from deep_curiosity.experiments.tables import read_table
from deep_curiosity.training.command_line import parse

TRAINS = """
import sys, time
from pathlib import Path
out = Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
rows = "step,eval/return", "500,", "1000,50.0", "2000,{last}", "3000,99.0"
(out / "progress.csv").write_text("\\n".join(rows))
time.sleep({seconds})
sys.exit({status})
"""


@pytest.fixture
def checkout(tmp_path):
    """Makes a checkout whose training leaves such evaluations."""

    def make(*, last, seconds=0, status=0):
        folder = tmp_path / f"checkout{last}"
        (folder / "scripts").mkdir(parents=True)
        text = TRAINS.format(last=last, seconds=seconds, status=status)
        (folder / "scripts" / "train.py").write_text(text)
        return folder

    return make


EASY = replace(MOUNTAIN_CAR, solved_return=70.0)


def test_a_run_is_timed_until_its_first_evaluation_that_is_enough_and_ended(checkout, tmp_path):
    measured = time_to_solved(checkout(last=70.0, seconds=600), EASY, 0, tmp_path)
    assert measured["step"] == 2000 and 0 < measured["seconds"] < 60


def test_a_run_that_does_not_solve_its_task_has_no_time(checkout, tmp_path):
    hard = replace(EASY, solved_return=99.5)
    assert time_to_solved(checkout(last=71.0), hard, 0, tmp_path) == {
        "seconds": None,
        "step": None,
    }


def test_a_run_that_fails_is_told_with_what_it_said(checkout, tmp_path):
    folder = checkout(last="nan", status="'no such task'")
    with pytest.raises(RuntimeError, match="must train, but said: no such task"):
        time_to_solved(folder, replace(EASY, solved_return=math.inf), 0, tmp_path)


@pytest.mark.parametrize("task", [PENDULUM, MAZE, MOUNTAIN_CAR], ids=lambda task: task.name)
def test_the_flags_say_what_the_task_is(task, tmp_path):
    config = parse([*flags_of(task, 3), "--out", str(tmp_path)], description="", prog="").config
    env_id = config.environment.env_id
    assert config == task.config.override(seed=3, out=tmp_path, env_id=env_id)
    assert task.config.environment.env_id in env_id


def test_every_checkout_has_its_turns_and_a_row_for_each(checkout, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(solved, "TASKS", (EASY, PENDULUM))
    here = checkout(last=70.0)
    monkeypatch.setattr(solved, "__file__", str(here / "package" / "benchmark" / "solved.py"))
    out = tmp_path / "solved"
    solved.main(Args({"before": checkout(last=60.0)}, seeds=2, workers=1, out=out))
    rows = read_table(tmp_path / "solved.csv")
    assert [(row["task"], row["checkout"], row["seed"]) for row in rows[:4]] == [
        (EASY.name, "default", "0"),
        (EASY.name, "before", "0"),
        (PENDULUM.name, "default", "0"),
        (PENDULUM.name, "before", "0"),
    ]
    assert [row["step"] for row in rows] == ["2000", "3000", "", ""] * 2
    assert (tmp_path / "solved.png").stat().st_size > 0
    table = (tmp_path / "solved.md").read_text()
    assert f"| {PENDULUM.name} | before | 0 of 2 | never |" in table
    assert table in capsys.readouterr().out


def test_a_run_that_never_solves_counts_as_slower_than_any():
    row = {"task": "a", "checkout": "default"}
    rows = [row | {"seconds": seconds} for seconds in (4.0, None, 8.0)]
    assert summary_of(rows).splitlines()[-1] == "| a | default | 2 of 3 | 8 [4, never] |"


def test_another_checkout_has_the_command_and_a_name_of_its_own(checkout, tmp_path):
    with pytest.raises(ValueError, match="got default "):
        Args({"default": checkout(last=1.0)})
    with pytest.raises(
        ValueError, match="`beside` must each be a name of its own, and the folder"
    ):
        Args({"mine": tmp_path})
    with pytest.raises(ValueError, match="`seeds` must be at least 1, got 0"):
        Args(seeds=0)
