import numpy as np
import pytest

from deep_curiosity.benchmark.figures import plot_slow, plot_vector
from deep_curiosity.benchmark.run import write_page
from deep_curiosity.benchmark.vector import (
    make_slow,
    measure_slow_environments,
    measure_vector_environments,
)
from deep_curiosity.experiments.tables import write_table
from deep_curiosity_envs import TASK_IDS


def test_a_section_leaves_table_picture_and_page(tmp_path):
    rows = measure_vector_environments(TASK_IDS[:1], (1, 2), repeats=2, steps=6)
    assert len(rows) == 4
    write_table(tmp_path / "vector.csv", rows)
    plot_vector(tmp_path / "vector.png", rows)
    machine = {"section": "vector", "cpu": "some CPU", "cores": 2, "torch": "2.13"}
    write_table(
        tmp_path / "machine.csv", [machine | {"precision": "highest", "command": "make bench"}]
    )
    write_page(tmp_path)
    page = (tmp_path / "README.md").read_text()
    assert f"| {TASK_IDS[0]} | 2 | " in page
    assert "Machine: some CPU, 2 cores, torch 2.13" in page
    assert "## Agents" not in page
    assert (tmp_path / "vector.png").stat().st_size > 5_000


@pytest.mark.slow
def test_slow_environments_leave_table_picture_and_page(tmp_path):
    rows = measure_slow_environments(TASK_IDS[0], 0.01, (1, 2), repeats=2, steps=6)
    assert [(row["num_envs"], row["repeat"]) for row in rows] == [(1, 0), (1, 1), (2, 0), (2, 1)]
    # no step can be faster than its sleep, whatever else the machine does
    assert all(row["sync_steps_per_second"] < 100 for row in rows)
    assert all(row["async_steps_per_second"] < 100 * row["num_envs"] for row in rows)
    write_table(tmp_path / "slow.csv", rows)
    plot_slow(tmp_path / "slow.png", rows)
    machine = {"section": "slow", "cpu": "some CPU", "cores": 2, "torch": "2.13"}
    write_table(
        tmp_path / "machine.csv", [machine | {"precision": "highest", "command": "make bench"}]
    )
    write_page(tmp_path)
    assert "| 10 | 2 | " in (tmp_path / "README.md").read_text()
    assert (tmp_path / "slow.png").stat().st_size > 5_000


def test_a_slow_task_sleeps_before_every_step_and_changes_nothing(monkeypatch):
    slept = []
    monkeypatch.setattr("time.sleep", slept.append)
    slow, task = make_slow(TASK_IDS[0], 0.5), make_slow(TASK_IDS[0], 0.0).unwrapped
    for each in (slow, task):
        each.reset(seed=0)
    action = np.array([0.5], np.float32)
    assert np.array_equal(slow.step(action)[0], task.step(action)[0])
    assert slept == [0.5]
