import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from deep_curiosity.experiments import torture as module
from deep_curiosity.experiments.torture import VARIANTS, torture


@pytest.fixture(autouse=True)
def threads_as_before():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def assert_unharmed(kills, seed):
    """In a process without the checks of types, which take longer than the runs."""
    script = Path(__file__).parents[2] / "scripts" / "torture.py"
    done = subprocess.run(
        [sys.executable, script, "--kills", str(kills), "--seed", str(seed), "--seconds", "3600"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    tallies = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(tallies) == len(VARIANTS)
    assert sum(tally["kills"] for tally in tallies) >= kills
    for fault in ("corrupt_checkpoints", "failed_resumes", "wrong_rows", "unequal_chains"):
        assert [tally[fault] for tally in tallies] == [0] * len(VARIANTS)


@pytest.mark.slow
def test_runs_that_are_killed_and_continued_are_as_if_they_were_not():
    assert_unharmed(kills=30, seed=0)


@pytest.mark.slow
def test_so_are_those_that_are_killed_a_thousand_times():
    assert_unharmed(kills=1_000, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["rows", "weights"])
def test_torture_finds_a_lost_row_and_another_end(tmp_path, monkeypatch, fault):
    monkeypatch.setattr(module, "VARIANTS", VARIANTS[:1])
    left = module._left

    def spoilt(folder):
        weights, rows = left(folder)
        if "chain" not in folder.name:
            return weights, rows
        if fault == "weights":
            return weights | {"learner": "of another run"}, rows
        return weights, rows[:-1]

    monkeypatch.setattr(module, "_left", spoilt)
    (tally,) = torture(tmp_path / "runs", kills=1, seed=0, seconds=0.0).values()
    assert (tally.wrong_rows > 0, tally.unequal_chains > 0) == (fault == "rows", fault != "rows")


def test_torture_finds_damaged_checkpoints_and_rows(tmp_path):
    config = module.tortured_config(1, "uniform").override(out=tmp_path / "run")
    process = module._begin(config)
    assert module._end(process, 120.0) == 0
    _, rows = module._left(config.run.out)
    assert module._corrupt(config.run.out) == 0
    assert module._is_start(config.run.out, rows)
    path = config.run.out / "progress.csv"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:2] * 2))
    assert not module._is_start(config.run.out, rows)
    newest = config.run.out / "checkpoint.pt"
    newest.write_bytes(newest.read_bytes()[:-200])
    assert module._corrupt(config.run.out) == 1
