import csv
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from deep_curiosity import __version__
from deep_curiosity.experiments import runs
from deep_curiosity.experiments.engines.base import Outcome
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.grid import (
    Records,
    cells_of,
    compare,
    output_path,
    overridden,
    part_of,
    run_study,
)
from deep_curiosity.experiments.study import Result, Study, Task
from deep_curiosity.training import Config, train
from deep_curiosity.training.source import source_commit


def table(path):
    with path.with_suffix(".csv").open() as file:
        return list(csv.DictReader(file))


def test_a_study_leaves_table_curves_and_figure_and_repeats_no_run(
    small_study, tmp_path, monkeypatch
):
    out = tmp_path / "docs" / "sparse"
    places = {"runs": tmp_path / "runs" / "sparse", "out": out, "workers": 1}
    assert run_study(small_study, **places) == 0
    rows = table(out)
    assert [(row["agent"], row["seed"], row["solved"]) for row in rows] == [
        ("curiosity", "0", "1"),
        ("none", "0", "1"),
        ("curiosity", "1", "1"),
        ("none", "1", "1"),
    ]
    assert len((out.parent / "sparse_curves.csv").read_text().splitlines()) == 1 + 4 * 2
    assert "| pendulum | curiosity | 2 of 2 | " in out.with_suffix(".md").read_text()
    assert out.with_suffix(".png").exists()

    monkeypatch.setattr(runs, "train", None)
    with ThreadPoolExecutor(1) as executor:  # any executor serves, and sees the patch
        assert run_study(small_study, **places | {"executor": executor}) == 0
    assert table(out) == rows


def test_every_row_says_which_code_made_it_and_how_it_was_set(small_study, tmp_path):
    out = tmp_path / "out"
    with ThreadPoolExecutor(1) as executor:
        run_study(small_study, runs=tmp_path / "runs", out=out, executor=executor)
    for row in table(out):
        assert (row["version"], row["commit"]) == (__version__, source_commit())
        settings = json.loads(row["settings"])
        assert settings["total_steps"] == 40 and "discount" not in settings
        assert settings.get("bonus", "curiosity") == row["agent"]


def test_a_run_that_fails_is_listed_and_the_others_go_on(small_study, tmp_path, capsys):
    study = replace(small_study, agents={"lost": {"env_id": "NoSuchTask"}, "none": {}}, seeds=1)
    out = tmp_path / "out"
    with ThreadPoolExecutor(1) as executor:
        assert run_study(study, runs=tmp_path / "runs", out=out, executor=executor) == 1
    assert [row["agent"] for row in table(out)] == ["none"]
    assert "- failed: pendulum, lost, seed 0: ValueError: `env_id`" in (
        out.with_suffix(".md").read_text()
    )
    assert "failed: pendulum, lost, seed 0" in capsys.readouterr().err


def test_a_cut_off_run_is_continued(small_study, tmp_path):
    study = replace(small_study, seeds=1, agents={"none": {"bonus": "none"}})
    (cell,) = cells_of(study, tmp_path / "runs")
    runs.run_once(cell.config.override(total_steps=30))
    with ThreadPoolExecutor(1) as executor:
        run_study(study, runs=tmp_path / "runs", out=tmp_path / "out", executor=executor)
    assert [row["total_steps"] for row in table(tmp_path / "out")] == ["40"]


class InterruptedEngine(LocalEngine):
    """Has its user press Ctrl-C when the second run is given to it."""

    def __init__(self):
        super().__init__(1)
        self.given = 0

    def submit(self, jobs):
        self.given += len(jobs)
        if self.given == 2:
            raise KeyboardInterrupt
        return super().submit(jobs)


def test_ctrl_c_leaves_what_came_and_the_same_command_goes_on(small_study, tmp_path):
    places = {"runs": tmp_path / "runs", "out": tmp_path / "out"}
    with pytest.raises(KeyboardInterrupt):
        run_study(small_study, **places, engine=InterruptedEngine())
    assert len(table(tmp_path / "out")) == 1
    with ThreadPoolExecutor(1) as executor:
        assert run_study(small_study, **places, executor=executor) == 0
    assert len(table(tmp_path / "out")) == 4


def test_a_run_that_is_stopped_goes_on_in_the_same_study(small_study, tmp_path, monkeypatch):
    stopped = []

    def train_or_stop(config, **options):
        if not stopped:
            stopped.append(config)
            options["on_evaluation"] = lambda step, values: True
        return train(config, **options)

    monkeypatch.setattr(runs, "train", train_or_stop)
    study = replace(small_study, seeds=1, agents={"none": {"bonus": "none"}})
    with ThreadPoolExecutor(1) as executor:
        places = {"runs": tmp_path / "runs", "out": tmp_path / "out"}
        assert run_study(study, **places, executor=executor) == 0
    assert stopped and [row["total_steps"] for row in table(tmp_path / "out")] == ["40"]


def test_tables_are_written_as_results_come(small_study, tmp_path):
    cells = cells_of(small_study, tmp_path / "runs")
    records = Records(small_study, cells, tmp_path / "out")
    result = Result([{"evaluation_return": 1.0}], [], {"version": "1"})
    for number in (2, 0):
        records.add(number, Outcome(result))
        records.write_some()  # the second time nothing is due yet
    assert [row["seed"] for row in table(tmp_path / "out")] == ["1"]


@pytest.mark.parametrize("name", ["out.csv", "out.md", "out.png", "out_curves.csv"])
def test_files_that_are_none_of_a_study_are_left_alone(small_study, tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(FileExistsError, match=rf"`out` must name new files.*{name}"):
        run_study(small_study, runs=tmp_path / "runs", out=tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


def test_a_dot_in_the_path_is_no_suffix(tmp_path):
    assert output_path(tmp_path / "rate.0.5", ".md") == tmp_path / "rate.0.5.md"


def test_settings_of_all_runs_can_be_overridden(small_study, tmp_path):
    study = overridden(small_study, {"total_steps": 24, "hidden_dim": 8})
    configs = [cell.config for cell in cells_of(study, tmp_path)]
    assert {(c.run.total_steps, c.agent.hidden_dim) for c in configs} == {(24, 8)}
    assert {c.bonus.kind for c in configs} == {"curiosity", "none"}


def test_a_setting_that_does_not_exist_is_refused_before_anything_runs(small_study, tmp_path):
    study = replace(small_study, agents={"odd": {"novelty": 1.0}})
    with pytest.raises(TypeError, match="`novelty` is no setting here"):
        run_study(study, runs=tmp_path / "runs", out=tmp_path / "out")


def test_the_first_agent_is_compared_with_each_other(make_rows):
    study = Study([Task("maze", Config())], {"good": {}, "bad": {}}, columns=("area",))
    rows = make_rows(study, lambda agent: 10.0 if agent == "good" else 0.0)
    assert "| bad | 1 [1, 1] |" in compare(study, rows)[0]


def test_a_part_of_a_study_is_named_by_tasks_and_agents(small_study):
    other = replace(small_study.tasks[0], name="other")
    small_study = replace(small_study, tasks=[*small_study.tasks, other])
    part = part_of(small_study, ["other"], ["none"])
    assert [task.name for task in part.tasks] == ["other"]
    assert list(part.agents) == ["none"]
    assert part_of(small_study, [], []) == small_study
    with pytest.raises(ValueError, match="`agents` must be of the study, got nobody"):
        part_of(small_study, [], ["nobody"])


def test_seeds_begin_where_a_study_says(small_study, tmp_path):
    cells = cells_of(replace(small_study, first_seed=100), tmp_path)
    assert sorted({cell.seed for cell in cells}) == [100, 101]
