import csv

from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.experiments.tables import (
    markdown_table,
    median_and_range,
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
NAMED = Study([Task("maze", Config())], {"a": {}, "b": {}}, columns=("evaluation_return",))


def test_markdown():
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"


def test_a_value_that_is_missing_counts_as_later_than_any():
    assert median_and_range([100, None, 300]) == "300 [100, never]"
    assert median_and_range([1.0, 2.0]) == "1.5 [1, 2]"


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
