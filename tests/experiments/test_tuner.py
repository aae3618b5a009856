"""Trials are computed in this process, by a stand-in for training whose returns are a formula."""

import csv
import itertools
import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

optuna = pytest.importorskip("optuna")

from optuna.distributions import CategoricalDistribution, FloatDistribution  # noqa: E402

from deep_curiosity.experiments import tuner  # noqa: E402
from deep_curiosity.experiments.engines.local import ExecutorEngine  # noqa: E402
from deep_curiosity.experiments.runs import RunStoppedError  # noqa: E402
from deep_curiosity.experiments.search import Search  # noqa: E402
from deep_curiosity.experiments.study import Task  # noqa: E402
from deep_curiosity.training.command_line import parse  # noqa: E402
from deep_curiosity.training.lease import Lease, LeaseError  # noqa: E402
from tests.experiments.engines.elsewhere import ElsewhereEngine  # noqa: E402

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning"),
]


@pytest.fixture
def search(tiny):
    config = tiny.override(total_steps=60, evaluation_interval=20, learning_starts=10)
    space = {
        "learning_rate": FloatDistribution(1e-4, 1e-1, log=True),
        "batch_size": CategoricalDistribution((16, 32)),
    }
    tasks = [Task("easy", config), Task("hard", config.override(discount=0.9))]
    return Search(tasks, space, {"easy": (0.0, 10.0), "hard": (0.0, 1.0)}, seeds=2)


@pytest.fixture
def calls(monkeypatch):
    """Runs that were begun; their return falls with the distance of log rate from -2."""
    calls = []

    def run_once(config, on_evaluation):
        calls.append(config)
        config.run.out.mkdir(parents=True, exist_ok=True)
        best = {"easy": 10.0, "hard": 1.0}[config.run.out.parent.name]
        rate = config.agent.learning_rate
        for step in (20, 40, 60):
            value = best * (1 - abs(math.log10(rate) + 2)) * step / 60 + config.run.seed * 1e-6
            if on_evaluation(step, {"eval/return": value}):
                raise RunStoppedError("stopped")

    monkeypatch.setattr(tuner, "run_once", run_once)
    return calls


class CtrlC(ExecutorEngine):
    """Has its user press Ctrl-C once so many jobs were given to it."""

    def __init__(self, executor, after):
        super().__init__(executor)
        self.left = after

    def capacity(self, job):
        return 1

    def submit(self, jobs):
        self.left -= len(jobs)
        if self.left < 0:
            raise KeyboardInterrupt
        return super().submit(jobs)


@pytest.fixture
def search_in(search):
    def run(folder, trials=8, after=math.inf, **options):
        with ThreadPoolExecutor(1) as executor:
            return tuner.tune(
                search,
                trials=trials,
                runs=folder / "runs",
                engine=CtrlC(executor, after),
                **{"out": folder / "out" / "best"} | options,
            )

    return run


def told(study):
    return [
        (trial.number, trial.state.name, trial.params, trial.value, trial.intermediate_values)
        for trial in study.trials
    ]


def test_the_present_settings_come_first_and_better_ones_are_found(search_in, calls, tmp_path):
    study = search_in(tmp_path, trials=12)
    assert study.trials[0].params == {"learning_rate": 0.001, "batch_size": 32}
    assert study.best_value > study.trials[0].value == pytest.approx(0.0, abs=1e-2)
    best = json.loads((tmp_path / "out" / "best.json").read_text())
    assert best == study.best_params
    command = parse(["--settings", str(tmp_path / "out" / "best.json")], description="")
    assert command.config.agent.learning_rate == best["learning_rate"]
    with (tmp_path / "out" / "best.csv").open() as file:
        assert len([*csv.DictReader(file)]) == 12
    assert (tmp_path / "out" / "best.png").exists()


def test_a_trial_is_tasks_by_seeds_and_its_score_the_interquartile_mean(
    search_in, calls, tmp_path
):
    study = search_in(tmp_path, trials=1)
    assert len({config.run.out for config in calls}) == 4
    assert {config.run.seed for config in calls} == {1_000, 1_001}
    # at the rate 1e-3 returns are seed / 10^6; two runs are scaled by 10, and the middle two left
    assert study.trials[0].value == pytest.approx(((1_001e-6 / 10) + 1_000e-6) / 2)


@pytest.mark.parametrize("at_once", [1, 2])
def test_a_search_that_is_cut_off_twice_ends_with_the_same_trials(
    search_in, calls, tmp_path, at_once
):
    whole = search_in(tmp_path / "whole", at_once=at_once)
    for after in (6, 11):
        with pytest.raises(KeyboardInterrupt):
            search_in(tmp_path / "cut", after=after, at_once=at_once)
    cut = search_in(tmp_path / "cut", at_once=at_once)
    assert told(cut) == told(whole)
    assert "PRUNED" in {state for _, state, *_ in told(whole)}
    assert search_in(tmp_path / "cut").best_value == whole.best_value  # nothing is left to do


def interrupting(function, at):
    """The same function, in which its user presses Ctrl-C at one of its calls."""
    numbers = itertools.count(1)

    def interrupted(*arguments):
        if next(numbers) == at:
            raise KeyboardInterrupt
        return function(*arguments)

    return interrupted


@pytest.mark.parametrize(
    ("owner", "name", "at"), [(optuna.trial.Trial, "_suggest", 4), (tuner._Trial, "tell", 12)]
)
def test_a_search_that_is_cut_off_between_two_settings_or_trials_ends_with_the_same_trials(
    search_in, calls, tmp_path, monkeypatch, owner, name, at
):
    whole = search_in(tmp_path / "whole", trials=14, at_once=2)
    monkeypatch.setattr(owner, name, interrupting(getattr(owner, name), at))
    with pytest.raises(KeyboardInterrupt):
        search_in(tmp_path / "cut", trials=14, at_once=2)
    assert told(search_in(tmp_path / "cut", trials=14, at_once=2)) == told(whole)


def test_a_search_that_is_cut_off_before_it_writes_its_last_trial_writes_it_when_it_is_continued(
    search_in, calls, tmp_path, monkeypatch
):
    written = interrupting(tuner.write_search, at=3)
    monkeypatch.setattr(tuner, "write_search", written)
    with pytest.raises(KeyboardInterrupt):
        search_in(tmp_path, trials=3)
    search_in(tmp_path, trials=3)
    with (tmp_path / "out" / "best.csv").open() as file:
        assert len([*csv.DictReader(file)]) == 3


def test_a_poor_trial_is_stopped_and_none_where_none_may_be(search_in, calls, tmp_path):
    pruned = search_in(tmp_path / "pruned", trials=10)
    states = [trial.state.name for trial in pruned.trials]
    assert "PRUNED" in states[5:] and "PRUNED" not in states[:5]
    every = search_in(tmp_path / "every", trials=10, pruner="none")
    assert {trial.state.name for trial in every.trials} == {"COMPLETE"}


def test_a_trial_with_a_run_that_raises_has_failed_and_the_search_goes_on(
    search_in, calls, tmp_path, monkeypatch, capsys
):
    run_once = tuner.run_once

    def fail(config, on_evaluation):
        if config.agent.learning_rate == 0.001:
            raise ArithmeticError("too poor")
        return run_once(config, on_evaluation)

    monkeypatch.setattr(tuner, "run_once", fail)
    study = search_in(tmp_path, trials=3)
    assert [trial.state.name for trial in study.trials] == ["FAIL", "COMPLETE", "COMPLETE"]
    assert "ArithmeticError: too poor" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"space": {}}, "`space` and `tasks` must have an entry each, got 0 and 2"),
        ({"ranges": {"easy": (0.0, 1.0)}}, "`ranges` must give two rising returns for hard"),
        ({"space": {"novelty": None}}, "`space` must hold settings of easy, got novelty"),
        (
            {"space": {"learning_rate": (1e-4, 1e-2)}},
            r"`space` must hold distributions of Optuna, got \(0.0001, 0.01\) for learning_rate",
        ),
        (
            {"space": {"discount": FloatDistribution(0.9, 1.5)}},
            "`space` must hold what runs of easy can have, got discount 1.5: `discount` must be",
        ),
    ],
    ids=str,
)
def test_a_search_that_cannot_be_is_refused(search, change, message):
    from dataclasses import replace

    with pytest.raises((TypeError, ValueError), match=message):
        replace(search, **change)


def test_numbers_of_trials_are_checked(search_in, tmp_path):
    for name in ("trials", "at_once"):
        with pytest.raises(ValueError, match=f"`{name}` must be at least 1, got 0"):
            search_in(tmp_path, **{name: 0})


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"trials": "2"}, TypeError, "`trials` must be a whole number, got '2'"),
        ({"trials": 1.5}, TypeError, "`trials` must be a whole number, got 1.5"),
        ({"at_once": 1.5}, TypeError, "`at_once` must be a whole number, got 1.5"),
        ({"at_once": True}, TypeError, "`at_once` must be a whole number, got True"),
        ({"seed": -1}, ValueError, "`seed` must not be negative, got -1"),
        ({"seed": 2**32}, ValueError, "`seed` must be at most 4294967295, got 4294967296"),
        ({"seed": 0.5}, TypeError, "`seed` must be a whole number, got 0.5"),
        (
            {"pruner": "foo"},
            ValueError,
            "`pruner` must be one of median, hyperband, none, got 'foo'",
        ),
        ({"out": 3}, TypeError, "`out` must be a path, got 3"),
    ],
    ids=str,
)
def test_options_of_a_search_that_cannot_be_are_refused_by_name(
    search_in, calls, tmp_path, options, error, message
):
    with pytest.raises(error, match=message):
        search_in(tmp_path, **options)
    assert not calls


def test_a_relative_folder_of_trials_is_the_caller_s_wherever_workers_are(
    search, calls, tmp_path, monkeypatch
):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    engine = ElsewhereEngine(tmp_path / "elsewhere")
    study = tuner.tune(search, trials=1, runs=Path("runs"), out=Path("best"), engine=engine)
    assert [trial.state.name for trial in study.trials] == ["COMPLETE"]
    assert [*(tmp_path / "elsewhere").iterdir()] == []
    assert {path.name for path in Path("runs").iterdir()} == {"trials.db", "trial0000"}


def test_trials_and_best_settings_may_lie_below_the_home_folder(
    search, calls, tmp_path, monkeypatch
):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with ThreadPoolExecutor(1) as executor:
        engine = ExecutorEngine(executor)
        tuner.tune(search, trials=1, runs="~/runs/b", out=Path("~/res/b"), engine=engine)
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "res"}
    assert (tmp_path / "runs" / "b" / "trials.db").exists()
    assert (tmp_path / "res" / "b.json").exists()


def test_present_settings_that_differ_between_the_tasks_are_named(search, tmp_path):
    easy, hard = search.tasks
    faster = replace(hard, config=hard.config.override(learning_rate=0.01))
    message = (
        "`learning_rate` differs between the tasks, 0.001 of easy, 0.01 of hard. "
        "It has those of easy for all."
    )
    with pytest.warns(UserWarning, match=message):
        study = tuner.open_study(replace(search, tasks=[easy, faster]), tmp_path / "runs")
    assert study.trials[0].system_attrs["fixed_params"]["learning_rate"] == 0.001
    tuner.open_study(replace(search, tasks=[easy, faster]), tmp_path / "runs")  # said once


def test_present_settings_outside_the_search_space_are_named(search, tmp_path):
    space = {**search.space, "batch_size": CategoricalDistribution((64, 128))}
    message = "`batch_size` 32 is outside the search space. It is drawn instead."
    with pytest.warns(UserWarning, match=message):
        study = tuner.open_study(replace(search, space=space), tmp_path / "runs")
    assert study.trials == []


def test_searches_whose_names_end_in_a_number_keep_files_of_their_own(search_in, calls, tmp_path):
    for name in ("gamma0.1", "gamma0.2"):
        search_in(tmp_path / name, trials=1, out=tmp_path / name)
    found = {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert found == {
        f"gamma0.{number}{ending}" for number in (1, 2) for ending in (".csv", ".json", ".png")
    }


def test_a_file_of_something_else_is_left_alone_and_nothing_is_tried(search_in, calls, tmp_path):
    (tmp_path / "mine.json").write_text("mine")
    with pytest.raises(FileExistsError, match=r"`out` must name new files, .*mine\.json"):
        search_in(tmp_path, out=tmp_path / "mine")
    assert (tmp_path / "mine.json").read_text() == "mine" and not calls
    search_in(tmp_path, trials=1)
    search_in(tmp_path, trials=2)  # over its own


def test_a_trial_with_a_run_that_has_lost_its_evaluations_has_failed(
    search_in, calls, tmp_path, monkeypatch, capsys
):
    told = tuner._Trial.tell

    def lose_and_tell(trial, study):
        if trial.trial.number == 0:
            next(trial.folder.rglob(tuner.EVALUATIONS)).unlink()
        told(trial, study)

    monkeypatch.setattr(tuner._Trial, "tell", lose_and_tell)
    study = search_in(tmp_path, trials=2)
    assert [trial.state.name for trial in study.trials] == ["FAIL", "COMPLETE"]
    assert "no evaluation at its end is noted" in capsys.readouterr().err


def test_a_trial_that_failed_and_was_cut_off_has_failed_when_the_search_goes_on(
    search_in, calls, tmp_path, monkeypatch
):
    run_once = tuner.run_once

    def fail(config, on_evaluation):
        if config.run.seed == 1_001:  # the last runs of a trial; the others have come to their end
            raise ArithmeticError("too poor")
        return run_once(config, on_evaluation)

    monkeypatch.setattr(tuner, "run_once", fail)
    monkeypatch.setattr(tuner._Trial, "tell", interrupting(tuner._Trial.tell, at=1))
    with pytest.raises(KeyboardInterrupt):
        search_in(tmp_path, trials=1)
    assert [trial.state.name for trial in search_in(tmp_path, trials=1).trials] == ["FAIL"]


STORAGES = ["garbage", "", "garbage://x", "sqlite:////no/such/x.db", "mysql://x/y"]


@pytest.mark.parametrize("storage", STORAGES)
def test_a_storage_that_cannot_be_opened_is_refused(search_in, calls, tmp_path, storage):
    with pytest.raises(
        ValueError, match=f"`storage` must be the URL .*, got {storage!r}: "
    ) as got:
        search_in(tmp_path, storage=storage)
    assert "\n" not in str(got.value) and not calls


def test_lines_that_a_crash_has_torn_are_passed_over(tmp_path):
    (tmp_path / tuner.EVALUATIONS).write_text("[200, 2.0]\n[1[100, 1.0]\n3\n[200, 2.5]\n[300, 3")
    assert tuner.read_evaluations(tmp_path) == {200: 2.5}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seeds": 3}, "seeds"),
        ({"ranges": {"easy": (0.0, 20.0), "hard": (0.0, 1.0)}}, "ranges"),
        ({"space": {"learning_rate": FloatDistribution(1e-4, 1e-2, log=True)}}, "space"),
    ],
)
def test_trials_of_another_search_are_not_gone_on_with(search, search_in, tmp_path, changes, said):
    search_in(tmp_path, trials=1)
    tuner.open_study(search, tmp_path / "runs")  # the same goes on
    with pytest.raises(ValueError, match=f"got runs, whose {said} differ; name another folder"):
        tuner.open_study(replace(search, **changes), tmp_path / "runs")
    others = [replace(task, config=task.config.override(hidden_dim=4)) for task in search.tasks]
    with pytest.raises(ValueError, match="whose tasks differ"):
        tuner.open_study(replace(search, tasks=others), tmp_path / "runs")


def test_a_trial_of_which_a_run_returned_nan_is_very_poor():
    assert tuner.score_of([0.9, 0.9, 0.9, math.nan]) == tuner.VERY_POOR
    assert tuner.score_of([0.1, 0.5, 0.7, 0.9]) == pytest.approx(0.6)


def test_a_combination_that_no_run_can_have_is_a_failed_trial_and_the_search_goes_on(
    search, search_in, calls, tmp_path, capsys
):
    small, large = CategoricalDistribution((16, 64)), CategoricalDistribution((32, 128))
    rates = search.space["learning_rate"]
    space = {"batch_size": small, "replay_capacity": large, "learning_rate": rates}
    outside = "`batch_size` 32 is outside"
    with ThreadPoolExecutor(1) as executor, pytest.warns(UserWarning, match=outside):
        study = tuner.tune(
            replace(search, space=space),
            trials=12,
            runs=tmp_path / "runs",
            out=tmp_path / "best",
            engine=ExecutorEngine(executor),
            at_once=2,
        )
    failed = [trial for trial in study.trials if trial.state.name == "FAIL"]
    assert len(study.trials) == 12 and 0 < len(failed) < 12
    for trial in failed:
        assert (trial.params["batch_size"], trial.params["replay_capacity"]) == (64, 32)
        assert "64" in trial.user_attrs["reason"]
    assert f"trial{failed[0].number:04d}: `" in capsys.readouterr().err
    with (tmp_path / "best.csv").open() as file:
        assert sum(bool(row["reason"]) for row in csv.DictReader(file)) == len(failed)


def test_a_search_that_could_not_be_opened_leaves_its_folder_to_another(
    search, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(tuner, "_holds", None)
        with pytest.raises(TypeError):
            tuner.open_study(search, tmp_path / "runs")
    tuner.open_study(replace(search, seeds=3), tmp_path / "runs")


def test_where_all_trials_fail_no_best_settings_of_another_search_are_left(
    search_in, tmp_path, monkeypatch
):
    (tmp_path / "out").mkdir()
    for ending in (".json", ".png"):
        (tmp_path / "out" / f"best{ending}").touch()
    (tmp_path / "out" / "best.csv").write_text("trial,state\n0,complete\n")

    def fail(config, on_evaluation):
        raise ArithmeticError("too poor")

    monkeypatch.setattr(tuner, "run_once", fail)
    search_in(tmp_path, trials=2)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["best.csv"]
    with (tmp_path / "out" / "best.csv").open() as file:
        assert [row["reason"] for row in csv.DictReader(file)] == [
            "ArithmeticError: too poor",
            "ArithmeticError: too poor",
        ]


def test_a_very_poor_trial_is_left_out_of_the_picture(search_in, calls, tmp_path, monkeypatch):
    run_once, shown = tuner.run_once, []

    def diverge(config, on_evaluation):
        is_present = config.agent.learning_rate == 0.001
        run_once(
            config,
            (lambda step, _: on_evaluation(step, {"eval/return": math.nan}))
            if is_present
            else on_evaluation,
        )

    monkeypatch.setattr(tuner, "run_once", diverge)
    monkeypatch.setattr(tuner, "plot_search", lambda path, scores, _: shown.append(scores))
    study = search_in(tmp_path, trials=3)
    assert study.trials[0].value == tuner.VERY_POOR
    assert [math.isnan(score) for score in shown[-1]] == [True, False, False]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"space": {"seed": FloatDistribution(0, 1)}}, "`space` must leave to the search .* seed"),
        ({"seeds": 0}, "`seeds` must be at least 1, got 0"),
        ({"first_seed": -5}, "`first_seed` must not be negative, got -5"),
        ({"ranges": {"easy": (0.0, math.inf), "hard": (0.0, 1.0)}}, "`ranges` must give two"),
    ],
)
def test_a_search_that_cannot_be_is_refused_before_any_trial(search, changed, message):
    with pytest.raises((TypeError, ValueError), match=message):
        replace(search, **changed)


@pytest.mark.filterwarnings("ignore:Choices for a categorical distribution")
def test_choices_that_optuna_does_not_keep_are_refused(search):
    with pytest.raises(TypeError, match=r"text, numbers, True, False or None, got \(0,\)"):
        replace(search, space={"features": CategoricalDistribution(((0,), ()))})


def test_tasks_of_a_search_have_folders_of_their_own(search):
    with pytest.raises(ValueError, match="must give each run a folder of its own"):
        replace(search, tasks=[search.tasks[0]] * 2)
    with pytest.raises(ValueError, match="must have names that folders can have, got '/x'"):
        replace(search, tasks=[replace(search.tasks[0], name="/x")], ranges={"/x": (0.0, 1.0)})


def test_any_letters_may_be_in_the_path_of_the_runs(search, tmp_path):
    names = {"q?z", "q%20z", "q z#1"}
    for name in names:
        tuner.open_study(search, tmp_path / name)
        assert (tmp_path / name / "trials.db").stat().st_size
    assert {path.name for path in tmp_path.iterdir()} == names


def test_no_setting_weighs_where_all_scores_are_equal(search, tmp_path):
    study = tuner.open_study(search, tmp_path / "runs")
    for rate in (0.001, 0.01, 0.1):
        study.add_trial(
            optuna.create_trial(
                params={"learning_rate": rate, "batch_size": 16},
                distributions=dict(search.space),
                value=1.0,
            )
        )
    assert tuner.importances(study) == {}


def test_a_search_that_another_process_is_at_is_left_to_it(search_in, calls, tmp_path):
    (tmp_path / "runs").mkdir()
    lease = Lease(tmp_path / "runs")
    message = r"`runs` must be searched by one process at a time, got .*runs, which is held by pro"
    with pytest.raises(LeaseError, match=message):
        search_in(tmp_path, trials=1)
    assert not calls and not (tmp_path / "runs" / "trials.db").exists()
    lease.release()
    assert len(search_in(tmp_path, trials=1).trials) == 1
    assert not [*(tmp_path / "runs").glob("lease.*")]


@pytest.mark.parametrize("left", [b"garbage" * 99, None, b""], ids=["other", "cut", "empty"])
def test_trials_that_cannot_be_read_are_named_by_their_file(search, tmp_path, left):
    tuner.open_study(search, tmp_path / "runs")
    path = tmp_path / "runs" / "trials.db"
    path.write_bytes(path.read_bytes()[:5_000] if left is None else left)
    if left == b"":  # as if there were none
        assert len(tuner.open_study(search, tmp_path / "runs").trials) == 1
        return
    message = r"`runs` must hold trials that can be read, or none, got .*runs/trials\.db: "
    with pytest.raises(ValueError, match=message):
        tuner.open_study(search, tmp_path / "runs")


def test_a_folder_where_no_trial_can_be_is_refused(search_in, calls, tmp_path):
    (tmp_path / "runs").touch()
    with pytest.raises(OSError, match="`runs` must be a folder that can be written to, got "):
        search_in(tmp_path)
    assert not calls
