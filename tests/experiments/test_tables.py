import csv
import math
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from deep_curiosity.benchmark.run import INTRODUCTION, run_benchmark
from deep_curiosity.benchmark.sections import Benchmark
from deep_curiosity.experiments.grid import summary_of
from deep_curiosity.experiments.paper.page import TITLE, write_paper
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.experiments.tables import (
    check_outputs,
    check_page,
    markdown_table,
    median_and_range,
    one_for_each_run,
    read_table,
    summarize,
    write_table,
)
from deep_curiosity.training import Config

SWEEP = Study(
    [Task("maze", Config())],
    {value: {"curiosity_discount": value} for value in (0.0, 0.5, 0.9)},
    label="curiosity discount",
    columns=("evaluation_return",),
)
ROOT = Path(__file__).parents[2]
RANKS = {  # as the pages beside the tables have them
    "horizon": [
        "PendulumSwingup: rank correlation of return with curiosity discount 1.00",
        "PendulumSwingup: rank correlation of mean_training_return with curiosity discount 0.80",
        "PointMaze: rank correlation of return with curiosity discount 0.00",
        "PointMaze: rank correlation of mean_training_return with curiosity discount 0.45",
        "PointMaze: rank correlation of coverage with curiosity discount 0.70",
    ],
    "hunger": [
        "PendulumSwingup: rank correlation of return with hunger 0.98",
        "PendulumSwingup: rank correlation of coverage with hunger -0.90",
    ],
}
NAMED = Study([Task("maze", Config())], {"a": {}, "b": {}}, columns=("evaluation_return",))


def test_markdown():
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"


def test_a_value_that_is_missing_counts_as_later_than_any():
    assert median_and_range([100, None, 300]) == "300 [100, never]"
    assert median_and_range([1.0, 2.0]) == "1.5 [1, 2]"
    assert (
        median_and_range([math.nan, 5, 10]) == median_and_range([None, 5, 10]) == "10 [5, never]"
    )
    assert median_and_range([None, math.nan]) == "never"


def test_steps_that_some_run_never_reached_are_medians_for_every_agent():
    study = replace(NAMED, columns=("solved_step",))
    steps = {"a": [100.0, 200.0, 600.0], "b": [100.0, None, 300.0]}
    rows = [
        {"task": "maze", "agent": agent, "seed": seed, "solved": 1, "solved_step": step}
        for agent, own in steps.items()
        for seed, step in enumerate(own)
    ]
    lines = summarize(study, rows).splitlines()
    assert lines[0] == "| task | agent | runs solved | solved step, median and range |"
    assert [line.split(" | ")[-1] for line in lines[2:4]] == [
        "200 [100, 600] |",
        "300 [100, never] |",
    ]


def test_names_with_bars_and_line_breaks_leave_a_table_whole():
    assert markdown_table(["a|b"], [["1\n2"]]) == "| a\\|b |\n| --- |\n| 1 2 |"


def test_a_place_that_cannot_be_written_to_is_refused_before_anything_is_computed(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="`out` must name files in a folder that can be written to"):
        check_outputs(tmp_path / "file" / "table", (".csv",), column="task", owner="a study")


def test_a_table_keeps_every_column_and_six_digits(tmp_path):
    path = tmp_path / "new" / "table.csv"
    write_table(path, [{"a": 1, "b": 1 / 3}, {"a": 2, "c": "x"}])
    with path.open() as file:
        assert list(csv.DictReader(file)) == [
            {"a": "1", "b": "0.333333", "c": ""},
            {"a": "2", "b": "", "c": "x"},
        ]


def test_a_sweep_has_intervals_and_a_rank(make_rows):
    summary = summarize(SWEEP, make_rows(SWEEP, lambda value: -value))
    assert "| maze | 0.9 | 1 of 2 | -0.4 [-0.9, 0.1] |" in summary
    assert "rank correlation of evaluation_return with curiosity discount -1.00" in summary


def test_agents_with_names_have_no_rank(make_rows):
    summary = summarize(NAMED, make_rows(NAMED, lambda name: 7.0))
    assert "| maze | b | 1 of 2 | 7.5 [7, 8] |" in summary
    assert "rank" not in summary


def test_what_a_task_does_not_have_is_left_blank(make_rows):
    rows = [row | {"evaluation_return": None} for row in make_rows(NAMED, lambda name: 7.0)]
    assert "| maze | a | 1 of 2 |  |" in summarize(NAMED, rows)


def test_a_folder_of_the_same_page_may_be_written_again(tmp_path):
    check_page(tmp_path / "new", "# Benchmark")
    check_page(tmp_path, "# Benchmark")
    (tmp_path / "README.md").write_text(INTRODUCTION)
    (tmp_path / "vector.csv").write_text("agent\n")
    check_page(tmp_path, "# Benchmark")
    page = resources.files("deep_curiosity.experiments.paper").joinpath("page.md")
    assert page.read_text(encoding="utf-8").splitlines()[0] == TITLE


@pytest.mark.parametrize("name", ["README.md", "vector.csv"])
def test_a_folder_of_something_else_is_left_alone(tmp_path, name):
    (tmp_path / name).write_text("# Mine\n")
    with pytest.raises(FileExistsError, match="`out` must name a folder without a page"):
        check_page(tmp_path, "# Benchmark")
    with pytest.raises(NotADirectoryError, match=r"got .*, which is a file"):
        check_page(tmp_path / name, "# Benchmark")
    for write in (write_paper, lambda folder: run_benchmark(Benchmark(out=folder), "")):
        with pytest.raises(FileExistsError, match="`out` must name a folder without a page"):
            write(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "# Mine\n"


@pytest.mark.parametrize("value", [0.0, float("nan"), None], ids=str)
def test_a_column_without_an_order_has_no_rank(make_rows, value):
    rows = [row | {"evaluation_return": value} for row in make_rows(SWEEP, lambda value: value)]
    assert "rank" not in summarize(SWEEP, rows)


def test_a_sweep_with_equal_medians_has_the_rank_of_their_mean_ranks(make_rows):
    summary = summarize(SWEEP, make_rows(SWEEP, lambda value: min(value, 0.5)))
    assert "with curiosity discount 0.87" in summary


def test_the_published_ranks_are_those_of_their_tables():
    for name, lines in RANKS.items():
        rows = [
            {column: float(value) if column != "task" else value for column, value in row.items()}
            for row in read_table(ROOT / "docs" / "sweeps" / f"{name}.csv")
        ]
        _, label, _, *columns = rows[0]
        tasks = [Task(task, Config()) for task in dict.fromkeys(row["task"] for row in rows)]
        agents = {value: {} for value in dict.fromkeys(row[label] for row in rows)}
        study = Study(tasks, agents, label=label, columns=columns)
        solved = [row | {"solved": ""} for row in rows]
        assert [f"- {line}" for line in lines] == [
            line for line in summarize(study, solved).splitlines() if line.startswith("- ")
        ]


def test_a_return_that_is_missing_is_counted_and_not_above_all_others(make_rows):
    rows = make_rows(NAMED, lambda name: 7.0)
    rows[0]["evaluation_return"] = None
    assert "| maze | a | 1 of 2 | 8, 1 of 2 runs |" in summarize(NAMED, rows)
    steps = replace(NAMED, columns=("first_success_step",))
    late = [row | {"first_success_step": row["evaluation_return"]} for row in rows]
    assert "| maze | a | 1 of 2 | never [8, never] |" in summarize(steps, late)


def test_a_cost_of_each_step_is_no_step_that_is_reached(make_rows):
    study = replace(NAMED, columns=("energy_per_step",))
    rows = [row | {"energy_per_step": row["evaluation_return"]} for row in make_rows(NAMED, len)]
    rows[0]["energy_per_step"] = None
    assert "never" not in summarize(study, rows) and "1 of 2 runs" in summarize(study, rows)


def test_a_table_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    path = tmp_path / "table.csv"
    write_table(path, [{"task": 1}])

    def full(descriptor):
        raise OSError("No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_table(path, [{"task": 2}])
    assert path.read_text() == "task\n1\n"


def test_a_run_that_has_several_rows_counts_once():
    rows = [
        {"task": "maze", "agent": "a", "seed": seed, "solved": 1, "evaluation_return": value}
        for seed, values in enumerate([[0.0, 2.0, None], [3.0]])
        for value in values
    ]
    once = one_for_each_run(NAMED, rows)
    assert [row["evaluation_return"] for row in once] == [1.0, 3.0]
    summary = summary_of(NAMED, rows)
    assert "| maze | a | 2 of 2 | 2 [1, 3] |" in summary


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("evaluation_return", "a better than"),
        ("return_at_0.5", "a better than"),
        ("area", "a better than"),
        ("solved_step", "a has more than"),
        ("noisy_time", "a has more than"),
    ],
)
def test_an_agent_is_called_better_where_more_is_better(column, words):
    study = replace(NAMED, columns=(column,))
    rows = [
        {"task": "maze", "agent": agent, "seed": seed, "solved": "", column: 1.0}
        for agent in "ab"
        for seed in (0, 1)
    ]
    assert f"| {words} |" in summary_of(study, rows)
    alone = summary_of(study, [row for row in rows if row["seed"] == 0])
    assert words not in alone and "[" not in alone  # one run says nothing of another


def test_where_no_return_counts_as_solved_nothing_is_never_solved():
    study = replace(NAMED, columns=("evaluation_return", "solved_step"))
    rows = [
        {"task": "maze", "agent": agent, "seed": 0, "solved": "", "evaluation_return": 1.0}
        | {"solved_step": None}
        for agent in "ab"
    ]
    header, _, first, *_ = summarize(study, rows).splitlines()
    assert header == "| task | agent | runs solved | evaluation return | solved step |"
    assert first == "| maze | a | - | 1 |  |"
