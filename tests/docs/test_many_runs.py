import csv
import re
import statistics
from pathlib import Path

import pytest

from deep_curiosity.benchmark.tables import grouped, median, rate_over, read_rows
from tests.docs.pages import ROOT, run_blocks, text_of

PAGE = ROOT / "docs/many_runs.md"


@pytest.mark.slow
def test_the_blocks_run_as_written(monkeypatch, tmp_path):
    pytest.importorskip("optuna")
    monkeypatch.chdir(tmp_path)
    names = run_blocks(PAGE)
    assert names["failed"] == 0
    with Path("results/mine.csv").open() as file:
        assert [row["agent"] for row in csv.DictReader(file)] == ["curiosity", "plain"]
    assert names["SEARCHES"]["mine"].seeds == 3
    assert names["run"].summary["total_steps"] == 160


def test_every_file_that_is_linked_is_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)", PAGE.read_text())
    assert not [link for link in links if not (PAGE.parent / link).exists()]


BENCHMARK = PAGE.parent / "benchmark"


def rates(table, column, **where):
    """Median of a column of the benchmark for each number of environments."""
    rows = [
        row
        for row in read_rows(BENCHMARK / f"{table}.csv")
        if all(row[name] == value for name, value in where.items())
    ]
    return {int(num): median(own, column) for (num,), own in grouped(rows, "num_envs").items()}


def assert_said(sentence):
    assert sentence in text_of(PAGE)


def test_what_is_said_of_slow_environments_is_what_was_measured():
    together = [f"{rate:.0f}" for rate in rates("slow", "async_steps_per_second").values()]
    alone = {f"{rate:.0f}" for rate in rates("slow", "sync_steps_per_second").values()}
    assert_said(
        "sleeps 20 ms, a process each gives {} steps per second with 1 environment, {} with 2, "
        "{} with 4, {} with 8 and {} with 16, and one by one they stay at {}".format(
            *together, " or ".join(sorted(alone))
        )
    )


def test_what_is_said_of_quick_steps_and_of_updates_is_what_was_measured():
    tasks = {row["task"] for row in read_rows(BENCHMARK / "vector.csv")}
    quick = [1e6 / rates("vector", "sync_steps_per_second", task=task)[1] for task in tasks]
    assert_said(f"take {min(quick):.0f} to {max(quick):.0f} microseconds for a step")
    rows = read_rows(BENCHMARK / "agents.csv")
    (update,) = (
        median(own, "update_ms")
        for (runner,), own in grouped(rows, "runner").items()
        if runner == "curious, compiled"
    )
    assert_said(f"compiled update of the curious agent takes {update:.1f} ms")
    left = {num: 1e3 * num / (20 + num * update) for num in (1, 4, 16)}
    assert_said(
        f"at most {left[1]:.0f} are left with 1 environment, {left[4]:.0f} with 4, {left[16]:.0f} "
        f"with 16, and never more than {1e3 / update:.0f}"
    )


def test_what_is_said_of_engines_is_what_was_measured():
    eight, short, long = (
        read_rows(BENCHMARK / f"engines{name}.csv") for name in ("_eight", "_short", "")
    )
    of_eight, of_four, bare, longer = (
        [rate_over(rows, "local, 1 worker")(row) for row in rows if row["runner"] == runner]
        for rows, runner in (
            (eight, "local, 2 workers"),
            (short, "local, 2 workers"),
            (short, "processes, 2"),
            (long, "local, 2 workers"),
        )
    )
    done = median_and_ends(of_eight).replace("times", "times what one does")
    assert_said(f"In {len(of_eight)} rounds of eight runs")
    assert_said(f"two workers do {done}")
    assert_said(f"in {len(of_four)} rounds of four")
    assert_said(f"it is {median_and_ends(of_four)}")
    assert_said(f"without an engine do {median_and_ends(bare)}".replace("times", "times as much"))
    assert_said(f"it is {median_and_ends(longer)}")
    every = [*of_eight, *of_four, *longer]
    assert_said(f"Over all {len(every)} rounds the median is {statistics.median(every):.2f}.")
    of_local = rate_over(long, "local, 2 workers")
    more = sorted(100 / of_local(row) - 100 for row in long if row["runner"] == "ray, 2 workers")
    assert_said(
        f"Ray needs {statistics.median(more):.1f} % more time than the local engine, between "
        f"{more[0]:.1f} % and {more[-1]:.1f} %"
    )


def median_and_ends(times):
    return f"{statistics.median(times):.2f} times, between {min(times):.2f} and {max(times):.2f}"
