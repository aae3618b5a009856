import csv
from dataclasses import replace

import pytest

from deep_curiosity.training import study
from deep_curiosity.training.log import open_folder
from deep_curiosity.experiments.grid import (
    Task,
    markdown_table,
    median_and_range,
    find_finished,
    run_once,
    run_study,
)


def test_markdown():
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"


def test_a_study_leaves_table_curves_and_picture_and_repeats_no_run(tiny, tmp_path, monkeypatch):
    task = Task(
        "pendulum",
        replace(tiny, total_steps=40, evaluation_interval=20, learning_starts=10),
        -100.0,
    )
    agents = {"curiosity": {}, "none": {"bonus": "none"}}
    out = tmp_path / "docs" / "sparse"
    arguments = {"seeds": (0, 1), "runs": tmp_path / "runs", "out": out, "workers": 1}
    rows = run_study([task], agents, **arguments)
    assert [(row["agent"], row["seed"], row["solved"]) for row in rows] == [
        ("curiosity", 0, 1),
        ("none", 0, 1),
        ("curiosity", 1, 1),
        ("none", 1, 1),
    ]
    with out.with_suffix(".csv").open() as file:
        table = list(csv.DictReader(file))
    assert float(table[3]["evaluation_return"]) == pytest.approx(
        rows[3]["evaluation_return"], 1e-4
    )
    assert out.with_suffix(".png").stat().st_size > 5_000
    assert len((out.parent / "sparse_curves.csv").read_text().splitlines()) == 1 + 4 * 2
    assert "| pendulum | curiosity | 2 of 2 | " in out.with_suffix(".md").read_text()

    monkeypatch.setattr(study, "train", None)
    assert run_study([task], agents, **arguments) == rows


def test_a_run_without_success_counts_as_later_than_any():
    assert median_and_range([100, None, 300]) == "300 [100, never]"
    assert median_and_range([1.0, 2.0]) == "1.5 [1, 2]"


def test_a_run_counts_as_solved_from_the_return_named(tiny, tmp_path):
    task = Task("pendulum", replace(tiny, total_steps=40), 1.0)
    arguments = {"seeds": (0,), "runs": tmp_path / "runs", "out": tmp_path / "out", "workers": 1}
    assert run_study([task], {"none": {"bonus": "none"}}, **arguments)[0]["solved"] == 0


def test_a_folder_with_a_run_of_other_settings_is_refused(tiny):
    run_once(replace(tiny, total_steps=30))
    with pytest.raises(FileExistsError, match="differs in batch_size, members; move it away"):
        run_once(replace(tiny, batch_size=16, members=3))
    assert run_once(replace(tiny, total_steps=40))["total_steps"] == 40  # the same run, merge_config


def test_a_job_goes_where_a_run_of_its_settings_lies(tiny, tmp_path):
    there = replace(tiny, env_id="PointMaze", out=tmp_path / "runs" / "some dial")
    open_folder(replace(there, matmul_precision="high"))
    jobs = [replace(there, seed=seed, out=tmp_path / "runs" / f"{seed}") for seed in range(2)]
    same, other = find_finished(jobs, tmp_path / "runs")
    assert same.out == there.out
    assert other == jobs[1]
