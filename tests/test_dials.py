"""What `scripts/dials.py` makes of its runs, without any."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

DIALS = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "dials.py"), run_name="dials")
TASKS = ("PendulumSwingup", "PointMaze")


def rows_of(dial, return_at):
    """Two seeds at each place, the second better by one."""
    return [
        {"task": task, dial.x: place, "seed": seed}
        | {name: return_at(place) + seed for name in dial.columns}
        for seed in range(2)
        for task in dial.settings
        for place in dial.places
    ]


def test_a_dial_is_told_by_medians_ranges_and_rank():
    dial = DIALS["DIALS"]["horizon"]
    summary = DIALS["summary_of"](dial, rows_of(dial, lambda place: -place))
    assert "| PointMaze | 0.97 | -0.47 [-0.97, 0.03] |" in summary
    assert "- PointMaze: rank correlation of return with curiosity discount -1.00" in summary


def test_a_dial_of_names_has_no_rank():
    dial = DIALS["DIALS"]["battery"]
    summary = DIALS["summary_of"](dial, rows_of(dial, len))
    assert "| BatteryRover | battery | 7.5 [7, 8] |" in summary
    assert "rank" not in summary


@pytest.mark.parametrize("name", ["rate", "battery"])
def test_a_dial_is_drawn(tmp_path, name):
    dial = DIALS["DIALS"][name]
    DIALS["draw"](tmp_path / "dial.png", dial, rows_of(dial, lambda place: len(str(place))))
    assert (tmp_path / "dial.png").stat().st_size > 1_000


def test_what_a_task_does_not_have_is_left_blank():
    dial = DIALS["DIALS"]["horizon"]
    rows = rows_of(dial, float)
    for row in rows:
        row["coverage"] = row["coverage"] if row["task"] == "PointMaze" else np.nan
    summary = DIALS["summary_of"](dial, rows)
    assert "| PendulumSwingup | 0.5 | 1 [0.5, 1.5] | 1 [0.5, 1.5] |  |" in summary
    assert "| PointMaze | 0.5 | 1 [0.5, 1.5] | 1 [0.5, 1.5] | 1 [0.5, 1.5] |" in summary


def test_a_dial_is_turned_on_some_of_its_tasks():
    dial = DIALS["DIALS"]["horizon"]
    assert tuple(DIALS["chosen"](dial, ()).settings) == TASKS
    assert tuple(DIALS["chosen"](dial, TASKS[1:]).settings) == TASKS[1:]
    with pytest.raises(ValueError, match="`tasks` must be among PendulumSwingup, PointMaze, got"):
        DIALS["chosen"](dial, ("Hopper-v5",))


def test_cells_of_the_pendulum_tile_angle_and_speed():
    cell = DIALS["pendulum_cell"]
    cells = {
        cell(np.array([np.cos(angle), np.sin(angle), speed]))
        for angle in np.linspace(-np.pi, np.pi, 1_000)
        for speed in np.linspace(-4, 4, 100)
    }
    assert cells == {(angle, speed) for angle in range(24) for speed in range(16)}


def test_cells_of_a_room_are_counted_once_each():
    rows = torch.tensor(
        [[-1.0, -1.0, 9.0], [-0.81, -0.81, 9.0], [0.01, 1.0, 9.0], [1.0, 1.0, 9.0]]
    )
    assert DIALS["cell_share"](rows) == 3 / 100
