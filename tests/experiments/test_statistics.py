import pytest

from deep_curiosity.training import Settings
from deep_curiosity.experiments.statistics import bootstrap, compare, draw_comparison
from deep_curiosity.experiments.grid import Task

TASKS = [Task("maze", Settings(), 50.0), Task("hill", Settings(), 90.0)]
RETURNS = {"bold": {"maze": [60, 70], "hill": [95, 10]}, "shy": {"maze": [0, 60], "hill": [0, 0]}}
ROWS = [
    {"task": task.name, "agent": agent, "solved": int(value >= task.solved_return)}
    | {"evaluation_return": value}
    for agent, returns in RETURNS.items()
    for task in TASKS
    for value in returns[task.name]
]


def test_the_interval_of_equal_values_is_a_point():
    assert bootstrap([[2.0, 2.0], [4.0, 4.0]]) == (3.0, 3.0, 3.0)


def test_the_interval_of_two_values_is_between_them():
    mean, low, high = bootstrap([[0.0, 1.0]])
    assert (mean, low, high) == (0.5, 0.0, 1.0)


def test_more_runs_narrow_the_interval():
    few, many = (bootstrap([[0.0, 1.0] * number]) for number in (3, 50))
    assert many[2] - many[1] < 0.5 * (few[2] - few[1])


def test_every_task_weighs_the_same_however_many_runs_it_has():
    assert bootstrap([[0.0] * 9, [1.0]])[0] == pytest.approx(0.5)


def test_the_table_begins_with_the_agent_that_solves_most():
    lines = compare(TASKS, ROWS).splitlines()
    assert lines[2].startswith("| bold | 75% [50%, 100%] | 65 [60, 70], 2 of 2 |")
    assert lines[3].startswith("| shy | 25%") and lines[3].endswith("0 [0, 0], 0 of 2 |")


def test_the_picture_is_drawn(tmp_path):
    draw_comparison(tmp_path / "picture.png", TASKS, ROWS)
    assert (tmp_path / "picture.png").stat().st_size > 5_000
