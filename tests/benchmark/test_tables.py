import pytest

from deep_curiosity.benchmark.tables import (
    grouped,
    rate_over,
    ratio,
    read_rows,
    size_name,
    slope,
    summarize,
)
from deep_curiosity.experiments.tables import write_table

ROWS = [
    {"runner": name, "repeat": repeat, "steps_per_second": rate}
    for name, rates in {"ours": (200.0, 100.0, 330.0), "theirs": (100.0, 100.0, 110.0)}.items()
    for repeat, rate in enumerate(rates)
]


def test_slope_is_the_exponent_of_a_power_law():
    values = [1.0, 2.0, 4.0, 8.0]
    assert slope(values, [3 * value**1.5 for value in values]) == pytest.approx(1.5)


def test_ratios_are_taken_within_a_round():
    assert summarize(ROWS[:3], rate_over(ROWS, "theirs")) == "2 [1, 3]"


def test_runners_may_stand_in_another_column():
    rows = [{"switched_off": row["runner"], **row} for row in ROWS]
    assert summarize(rows[:3], rate_over(rows, "theirs", "switched_off")) == "2 [1, 3]"


def test_one_column_over_another():
    assert ratio("bonus", "ensemble")({"bonus": 3.0, "ensemble": 2.0}) == 1.5


def test_groups_keep_their_order():
    assert list(grouped(ROWS[::-1], "runner")) == [("theirs",), ("ours",)]


def test_rows_come_back_from_a_file_with_gaps_empty(tmp_path):
    path = tmp_path / "rows.csv"
    write_table(path, [{"name": "plain", "ms": 1.5}, {"name": "other", "megabytes": 3.0}])
    assert read_rows(path) == [
        {"name": "plain", "ms": 1.5, "megabytes": ""},
        {"name": "other", "ms": "", "megabytes": 3.0},
    ]
    assert read_rows(tmp_path / "none.csv") == []


def test_a_size_is_named_without_its_prefix():
    assert size_name("num_members") == "members"
    assert size_name("batch_size") == "batch size"
