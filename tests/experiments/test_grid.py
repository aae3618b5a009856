import csv
import json
import math
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deep_curiosity import __version__
from deep_curiosity.experiments import grid, runs
from deep_curiosity.experiments.engines.base import Outcome
from deep_curiosity.experiments.engines.local import ExecutorEngine, LocalEngine
from deep_curiosity.experiments.grid import (
    Records,
    cells_of,
    collect,
    compare,
    output_path,
    overridden,
    part_of,
    run_study,
)
from deep_curiosity.experiments.study import Result, Study, Task
from deep_curiosity.training import Config, train
from deep_curiosity.training.log import open_folder
from deep_curiosity.training.source import source_commit
from tests.experiments.engines.elsewhere import ElsewhereEngine


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


def test_a_run_is_solved_by_its_last_evaluation_and_since_the_first_that_earns_enough(tmp_path):
    study = Study([Task("maze", Config(), 5.0), Task("open", Config())], {"default": {}}, seeds=2)
    returns = [1.0, 7.0, 4.0, 6.0]
    curve = [{"step": 10 * n, "evaluation_return": value} for n, value in enumerate(returns, 1)]
    ends = [
        Result([{"evaluation_return": points[-1]["evaluation_return"]}], points, {})
        for points in (curve, curve, curve[:1], curve[:3])  # seed by seed
    ]
    rows, _ = collect(cells_of(study, tmp_path / "runs"), dict(enumerate(ends)))
    assert [(row["task"], row["solved"], row["solved_step"]) for row in rows] == [
        ("maze", 1, 20),
        ("open", "", None),
        ("maze", 0, None),
        ("open", "", None),
    ]


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
    study = replace(small_study, columns=("evaluation_return",))
    records = Records(study, cells_of(study, tmp_path / "runs"), tmp_path / "out")
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
    configs = [cell.config for cell in cells_of(study, tmp_path / "runs")]
    assert {(c.run.total_steps, c.agent.hidden_dim) for c in configs} == {(24, 8)}
    assert {c.bonus.kind for c in configs} == {"curiosity", "none"}


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        (
            {"agents": {"odd": {"novelty": 1.0}}},
            TypeError,
            "agent 'odd' on pendulum: `novelty` is",
        ),
        ({"agents": {"odd": {"hunger": -1.0}}}, ValueError, "agent 'odd' on pendulum: `hunger`"),
        ({"agents": {"odd": {"seed": 3}}}, ValueError, "agent 'odd': `seed` must be left .*got 3"),
        ({"agents": {"odd": {"out": "a"}}}, ValueError, "agent 'odd': `out` must be left to"),
        ({"agents": {"odd": None}}, TypeError, "agent 'odd' must have settings .*got None"),
        ({"agents": {"": {}}}, ValueError, "`agents` must have names that .* got ''"),
        ({"agents": {"../a": {}}}, ValueError, "`agents` must have names that .*'../a'"),
        (
            {"agents": {"a": {}, "./a": {}}},
            ValueError,
            "`agents` must give each run a folder",
        ),
        ({"columns": ()}, ValueError, r"`columns` must have names, each of its own, got \(\)"),
        ({"columns": "area"}, TypeError, "`columns` must be a sequence of names, got 'area'"),
        ({"columns": ("area", "area")}, ValueError, "`columns` must have names, each of its own"),
        ({"label": "area"}, ValueError, "`label` must be a name of no column, got 'area'"),
        ({"label": "seed"}, ValueError, "`label` must be a name of no column, got 'seed'"),
        ({"columns": ("x",), "label": "x"}, ValueError, "`label` must be a name of no column"),
        ({"agents": {}}, ValueError, r"`agents` must have names, each of its own, got \[\]"),
        ({"agents": {0.5: {}, "0.5": {}}}, ValueError, "`agents` must have names, each of its"),
        ({"tasks": []}, ValueError, r"`tasks` must have names, each of its own, got \[\]"),
        ({"seeds": 0}, ValueError, "`seeds` must be at least 1, got 0"),
        ({"first_seed": -1}, ValueError, "`first_seed` must not be negative, got -1"),
        ({"seeds": "3"}, TypeError, "`seeds` must be a whole number, got '3'"),
        ({"seeds": 2.0}, TypeError, "`seeds` must be a whole number, got 2.0"),
        ({"seeds": True}, TypeError, "`seeds` must be a whole number, got True"),
        ({"first_seed": "3"}, TypeError, "`first_seed` must be a whole number, got '3'"),
        ({"tasks": 5}, TypeError, "`tasks` must be a sequence of tasks, got 5"),
        ({"tasks": ["a"]}, TypeError, "`tasks` must hold objects of Task, got 'a'"),
        ({"agents": ["a"]}, TypeError, r"`agents` must be settings by label, got \['a'\]"),
        ({"agents": {None: {}}}, TypeError, "`agents` must have names or numbers .* got None"),
        ({"agents": {math.nan: {}}}, ValueError, "`agents` must have labels that equal .*got nan"),
        ({"agents": {"a\0b": {}}}, ValueError, "`agents` must have names that folders can have"),
        ({"label": 3}, TypeError, "`label` must be text, got 3"),
        ({"measure": "x"}, TypeError, "`measure` must be a function, got 'x'"),
        ({"run": None}, TypeError, "`run` must be a function, got None"),
        ({"curves": "no"}, TypeError, "`curves` must be True or False, got 'no'"),
    ],
    ids=str,
)
def test_a_study_that_could_not_run_is_refused_before_anything_does(
    small_study, changes, error, message
):
    with pytest.raises(error, match=message):
        replace(small_study, **changes)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"seed": 3}, ValueError, "`seed` must be left to the study, .* got 3"),
        ({"out": "a"}, ValueError, "`out` must be left to the study"),
        ({"hidden_dmi": 8}, TypeError, "the nearest is hidden_dim"),
        ({"total_steps": 10}, ValueError, "`total_steps` must be above `learning_starts`"),
    ],
    ids=str,
)
def test_what_a_study_chooses_or_could_not_run_with_is_no_setting_of_all(
    small_study, values, error, message
):
    with pytest.raises(error, match=message):
        overridden(small_study, values)


def test_a_setting_that_one_agent_changes_is_none_of_all(small_study):
    message = "`bonus` must be left to the study, where it is chosen by none, got 'none'"
    with pytest.raises(ValueError, match=message):
        overridden(small_study, {"bonus": "none"})
    others = overridden(part_of(small_study, [], ["curiosity"]), {"bonus": "none"})
    assert others.tasks[0].config.bonus.kind == "none"


def test_a_setting_that_every_agent_changes_is_none_of_all(small_study):
    study = replace(small_study, agents={"a": {"hidden_dim": 8}, "b": {"hidden_dim": 16}})
    with pytest.raises(ValueError, match="`hidden_dim` must be left to the study"):
        overridden(study, {"hidden_dim": 32})


def test_the_name_of_the_table_may_have_a_point(small_study, tmp_path):
    with ThreadPoolExecutor(1) as executor:
        for name in ("rate-0.25", "rate-0.5"):
            study = replace(small_study, seeds=1, agents={"none": {"bonus": "none"}})
            out = tmp_path / name
            run_study(study, runs=tmp_path / "runs", out=out, executor=executor)
    for name in ("rate-0.25", "rate-0.5"):
        assert {f"{name}{suffix}" for suffix in (".csv", ".md", ".png")} <= {
            path.name for path in tmp_path.iterdir()
        }


def test_a_run_whose_settings_cannot_be_read_is_passed_over(small_study, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "config.json").write_bytes(b"\0\0")
    with pytest.warns(UserWarning, match=r"other is passed over: `config.json` must hold"):
        assert len(cells_of(small_study, tmp_path / "runs")) == 4


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
    with pytest.raises(ValueError, match=r"`agents` must be of the study, .*none, got nobody"):
        part_of(small_study, [], ["nobody"])
    with pytest.raises(ValueError, match="`tasks` must be named once each, got other, other"):
        part_of(small_study, ["other", "other"], [])


def test_seeds_begin_where_a_study_says(small_study, tmp_path):
    cells = cells_of(replace(small_study, first_seed=100), tmp_path / "runs")
    assert sorted({cell.seed for cell in cells}) == [100, 101]


@pytest.mark.parametrize("score", [None, float("nan")], ids=str)
def test_a_run_that_ends_without_a_return_is_not_solved(small_study, tmp_path, score):
    records = Records(small_study, cells_of(small_study, tmp_path / "runs"), tmp_path / "out")
    others = {name: 1.0 for name in small_study.columns}
    for number, value in enumerate((score, 1.0, 2.0, 3.0)):
        curve = [{"step": 20, "evaluation_return": -300.0}]
        row = others | {"evaluation_return": value}
        records.add(number, Outcome(Result([row], curve, {"version": "1"})))
    records.write()
    broken, whole, *_ = table(tmp_path / "out")
    assert (broken["solved"], broken["solved_step"]) == ("0", "")
    assert broken["evaluation_return"] == ("" if score is None else "nan")
    assert (whole["solved"], whole["evaluation_return"]) == ("1", "1")


def test_an_agent_with_a_run_without_a_value_is_not_compared(make_rows):
    agents = {"good": {}, "bad": {}, "lost": {}}
    study = Study([Task("maze", Config())], agents, columns=("first_success_step",))
    rows = make_rows(study, lambda agent: 10.0 if agent == "good" else 0.0)
    for row in rows:
        if (row["agent"], row["seed"]) == ("lost", 1):
            row["first_success_step"] = None
    (text, _) = compare(study, rows)
    assert "| bad | 1 [1, 1] |" in text and "lost" not in text
    first = replace(study, agents=dict(reversed(agents.items())))
    assert compare(first, rows)[0].startswith("Agents are not compared: two need")


def test_a_column_that_is_not_measured_is_refused_at_the_first_result(
    small_study, tmp_path, monkeypatch
):
    study = replace(small_study, columns=("evaluation_return", "nope"), curves=False, seeds=1)
    study = replace(study, measure=lambda config, summary: runs.measure_run(config, summary))
    places = {"runs": tmp_path / "runs" / "mine", "out": tmp_path / "out"}
    message = "`columns` must be measured, got 'nope'; there are solved, .*coverage"
    with pytest.raises(ValueError, match=message):
        run_study(study, **places, workers=1)
    assert not (tmp_path / "out.csv").exists()
    (finished,) = (tmp_path / "runs").rglob("summary.json")
    monkeypatch.setattr(runs, "train", None)
    assert (
        run_study(
            replace(study, columns=("evaluation_return", "solved_step")),
            **places,
            executor=ThreadPoolExecutor(1),
        )
        == 1
    )  # the other agent's, which would have to be trained
    assert [row["agent"] for row in table(tmp_path / "out")] == [finished.parent.parent.name]


def measured(cell):
    """A run without training: `lost` calls sys.exit, and `broken` raises."""
    if cell.agent == "lost":
        sys.exit(0)
    if cell.agent == "broken":
        raise ArithmeticError("too poor")
    return Result([{"evaluation_return": 1.0}], [], {"version": "1"})


def measured_with_curve(cell):
    curve = [{"step": 20, "evaluation_return": 1.0}]
    return Result([{"evaluation_return": 1.0}], curve, {"version": "1"})


@pytest.fixture
def quick_study(small_study):
    """The study of runs without training."""
    columns = ("evaluation_return",)
    return replace(small_study, agents={"good": {}}, columns=columns, run=measured, curves=False)


def run_quickly(study, out):
    with ThreadPoolExecutor(1) as executor:
        return run_study(study, runs=out.parent / "runs", out=out, executor=executor)


def test_a_run_that_calls_sys_exit_is_listed_and_the_others_go_on(quick_study, tmp_path):
    study = replace(quick_study, agents={"lost": {}, "good": {}})
    assert run_quickly(study, tmp_path / "out") == 2
    assert [row["agent"] for row in table(tmp_path / "out")] == ["good", "good"]
    assert "- failed: pendulum, lost, seed 1: SystemExit: 0" in (tmp_path / "out.md").read_text()


def test_a_study_whose_runs_all_fail_leaves_no_files_of_an_earlier_one(quick_study, tmp_path):
    out = tmp_path / "out"
    for study in (quick_study, replace(quick_study, curves=True)):
        assert run_quickly(quick_study, out) == 0
        (tmp_path / "out_together.png").touch()
        assert run_quickly(replace(study, agents={"broken": {}}), out) == 2
        summary = out.with_suffix(".md").read_text()
        assert "- failed: pendulum, broken, seed 0: ArithmeticError: too poor" in summary
        assert "good" not in summary and table(out) == []
        assert not out.with_suffix(".png").exists()
    assert not (tmp_path / "out_together.png").exists()
    assert run_quickly(quick_study, out) == 0  # over its own


def test_the_summary_of_a_study_that_is_not_at_its_end_says_so(quick_study, tmp_path):
    study = replace(quick_study, agents={"good": {}, "broken": {}})
    cells = cells_of(study, tmp_path / "runs")
    records = Records(study, cells, tmp_path / "out")
    records.add(0, Outcome(measured(cells[0])))
    records.add(1, Outcome(error="ArithmeticError: too poor"))
    records.write()
    assert "\n1 of 4 runs so far.\n\n- failed: " in (tmp_path / "out.md").read_text()
    records.add(2, Outcome(measured(cells[2])))
    records.add(3, Outcome(measured(cells[2])))
    records.write()
    assert "so far" not in (tmp_path / "out.md").read_text()


def test_what_runs_is_told_to_stop_before_the_summary_is_made(quick_study, tmp_path):
    class NotingEngine(ExecutorEngine):
        def close(self):
            assert not (tmp_path / "out.md").exists()
            (tmp_path / "closed").touch()
            super().close()

    with ThreadPoolExecutor(1) as executor:
        engine = NotingEngine(executor)
        run_study(quick_study, runs=tmp_path / "runs", out=tmp_path / "out", engine=engine)
    assert (tmp_path / "closed").exists() and (tmp_path / "out.md").exists()


def test_the_summary_is_there_where_a_figure_cannot_be_drawn(quick_study, tmp_path, monkeypatch):
    monkeypatch.setattr(grid, "plot_columns", None)
    with pytest.raises(TypeError):
        run_quickly(quick_study, tmp_path / "out")
    assert "| pendulum | good | 2 of 2 | 1 [1, 1] |" in (tmp_path / "out.md").read_text()


def test_a_column_that_no_run_can_have_is_refused_before_anything_runs(small_study, tmp_path):
    study = replace(small_study, columns=("nope",), curves=False)
    message = "`columns` must be measured, got 'nope'; there are solved, .*coverage"
    with pytest.raises(ValueError, match=message):
        run_study(study, runs=tmp_path / "runs", out=tmp_path / "out", engine=LocalEngine(1))
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"columns": ("note",)}, "`columns` must hold numbers, got 'note' with 'hello'"),
        ({"label": "note"}, "`label` must be no column of the rows, got 'note'"),
    ],
    ids=str,
)
def test_what_rows_cannot_show_is_refused_at_the_first(quick_study, tmp_path, changes, message):
    study = replace(quick_study, **changes)
    records = Records(study, cells_of(study, tmp_path / "runs"), tmp_path / "out")
    row = {"evaluation_return": 1.0, "note": "hello"}
    with pytest.raises(ValueError, match=message):
        records.add(0, Outcome(Result([row], [], {})))


def test_a_column_of_solved_runs_is_blank_where_no_return_solves_a_task(quick_study, tmp_path):
    tasks = [*quick_study.tasks, Task("open", Config())]
    study = replace(quick_study, tasks=tasks, columns=("evaluation_return", "solved"))
    records = Records(study, cells_of(study, tmp_path / "runs"), tmp_path / "out")
    for number, cell in enumerate(cells_of(study, tmp_path / "runs")):
        records.add(number, Outcome(measured(cell)))
    records.write()
    summary = (tmp_path / "out.md").read_text()
    assert "| open | good | - | 1 [1, 1] |  |" in summary
    assert "| pendulum | good | 2 of 2 | 1 [1, 1] | 1 [1, 1] |" in summary


def test_a_return_that_solves_a_task_must_be_a_number():
    for value in (None, "5", True):
        with pytest.raises(TypeError, match=f"`solved_return` of maze must be .*got {value!r}"):
            Task("maze", Config(), value)


def test_what_is_no_task_is_refused_by_name():
    with pytest.raises(TypeError, match="`name` of a task must be text, got 5"):
        Task(5, Config())
    with pytest.raises(TypeError, match=r"`config` of maze must be a Config, got \{'a': 1\}"):
        Task("maze", {"a": 1})


def test_tasks_may_come_from_a_generator_and_seeds_be_of_numpy(small_study, tmp_path):
    tasks = (task for task in small_study.tasks)
    study = replace(small_study, tasks=tasks, seeds=np.int64(2), first_seed=np.int32(1))
    assert [cell.seed for cell in cells_of(study, tmp_path / "runs")] == [1, 1, 2, 2]


def finish(config):
    open_folder(config)
    versions = {"deep-curiosity": "1", "commit": None}
    values = {"total_steps": config.run.total_steps, "versions": versions}
    (config.run.out / "summary.json").write_text(json.dumps(values))


def test_a_finished_run_is_read_where_it_lies_and_first_in_its_own_folder(small_study, tmp_path):
    places = small_study, tmp_path / "runs" / "z"
    own = cells_of(*places)[0]
    there = tmp_path / "runs" / "a"
    open_folder(own.config.override(out=there))
    assert cells_of(*places)[0].folder == own.folder  # the other is not finished
    (there / "config.json").unlink()
    finish(own.config.override(out=there))
    open_folder(own.config)
    assert cells_of(*places)[0].folder == there  # the own one is not finished
    (own.folder / "config.json").unlink()
    finish(own.config)
    assert cells_of(*places)[0].folder == own.folder


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (None, "TypeError: `run` must return a Result, got None"),
        (Result([1.0], [], {}), "TypeError: `rows` of a result must be a list of dictionaries"),
        (Result([{"seed": 1}], [], {}), "ValueError: `rows` must leave seed to the study"),
        (Result([], [{"step": 1}], {}), "ValueError: `curve` must have evaluation_return"),
    ],
)
def test_what_is_no_result_fails_alone(tmp_path, capsys, returned, message):
    def run(cell):
        return returned if cell.seed == 0 else Result([{"evaluation_return": 1.0}], [], {})

    study = Study(
        [Task("maze", Config())], {"a": {}}, seeds=2, columns=("evaluation_return",), run=run
    )
    with ThreadPoolExecutor(1) as executor:
        places = {"runs": tmp_path / "runs", "out": tmp_path / "table"}
        assert run_study(study, **places, executor=executor) == 1
    assert message in capsys.readouterr().err
    assert [row["seed"] for row in table(tmp_path / "table")] == ["1"]


def test_an_evaluation_without_a_return_solves_nothing():
    curve = [{"step": 1, "evaluation_return": None}, {"step": 2, "evaluation_return": 3.0}]
    study = Study([Task("maze", Config(), 2.0)], {"a": {}}, seeds=1)
    (cell,) = cells_of(study, Path("runs"))
    rows, _ = collect([cell], {0: Result([{"evaluation_return": 3.0}], curve, {})})
    assert (rows[0]["solved"], rows[0]["solved_step"]) == (1, 2)


def test_the_names_of_the_tables_columns_can_be_labels(tmp_path, make_rows):
    study = Study([Task("maze", Config())], {"a": {}}, label="column", columns=("area",))
    assert "| maze | a | 1 of 2 |" in grid.summary_of(study, make_rows(study, len))


def test_a_folder_where_no_run_can_be_is_refused_once_and_beforehand(quick_study, tmp_path):
    (tmp_path / "file").touch()
    places = {"runs": tmp_path / "file" / "runs", "out": tmp_path / "out"}
    message = r"`runs` must be a folder that can be written to, got .*file/runs: "
    with pytest.raises(OSError, match=message):
        run_study(quick_study, **places, engine=LocalEngine(1))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_neither_curves_nor_table_of_another_study_are_written_over(quick_study, tmp_path):
    study = replace(quick_study, run=measured_with_curve, curves=True)
    for _ in range(2):
        assert run_quickly(study, tmp_path / "mine") == 0  # over its own
    before = (tmp_path / "mine_curves.csv").read_bytes()
    with pytest.raises(
        FileExistsError, match=r"got .*mine_curves\.csv, which holds the curves of"
    ):
        run_quickly(quick_study, tmp_path / "mine_curves")
    assert (tmp_path / "mine_curves.csv").read_bytes() == before
    assert run_quickly(quick_study, tmp_path / "other") == 0
    assert run_quickly(quick_study, tmp_path / "other_curves") == 0
    assert run_quickly(quick_study, tmp_path / "other") == 0  # which has no curves
    with pytest.raises(
        FileExistsError, match=r"got .*other_curves\.csv, which holds the table of"
    ):
        run_quickly(study, tmp_path / "other")


def measured_in_its_folder(cell):
    cell.folder.mkdir(parents=True)
    return measured(cell)


def test_a_relative_folder_of_runs_is_the_caller_s_wherever_workers_are(
    quick_study, tmp_path, monkeypatch
):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    study = replace(quick_study, run=measured_in_its_folder)
    engine = ElsewhereEngine(tmp_path / "elsewhere")
    assert run_study(study, runs=Path("runs"), out=Path("out"), engine=engine) == 0
    assert [*(tmp_path / "elsewhere").iterdir()] == []
    assert (tmp_path / "here/runs/pendulum/good/seed1").is_dir()
    assert len(table(tmp_path / "here" / "out")) == 2


@pytest.mark.parametrize("kind", [Path, str])
def test_runs_and_tables_may_lie_below_the_home_folder(quick_study, tmp_path, monkeypatch, kind):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    study = replace(quick_study, run=measured_in_its_folder)
    with ThreadPoolExecutor(1) as executor:
        places = {"runs": kind("~/runs/b"), "out": kind("~/res/b")}
        assert run_study(study, **places, executor=executor) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "res"}
    assert len(table(tmp_path / "res" / "b")) == 2


@pytest.mark.parametrize("name", ["runs", "out"])
def test_what_is_no_path_is_refused_by_name(quick_study, tmp_path, name):
    places = {"runs": tmp_path / "runs", "out": tmp_path / "out"} | {name: 3}
    with pytest.raises(TypeError, match=f"`{name}` must be a path, got 3"):
        run_study(quick_study, **places)


@pytest.mark.parametrize("workers", ["2", 1.5, True])
def test_workers_that_are_no_whole_number_are_refused(quick_study, tmp_path, workers):
    message = f"`workers` must be a whole number, got {workers!r}"
    with pytest.raises(TypeError, match=message):
        run_study(quick_study, runs=tmp_path / "runs", out=tmp_path / "out", workers=workers)
