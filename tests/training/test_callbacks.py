import itertools
import json
import math

import numpy as np
import pytest
import torch

from deep_curiosity.training import continue_run, train
from deep_curiosity.training.callbacks import call, in_turn, stop_when_solved
from deep_curiosity.training.log import read_progress


def test_evaluations_and_rows_are_told_as_they_are_recorded(tiny):
    evaluations, rows = [], []
    train(
        tiny,
        on_evaluation=lambda step, values: evaluations.append((step, dict(values))),
        on_log=lambda step, values: rows.append((step, dict(values))),
        show_progress=False,
    )
    assert [step for step, _ in evaluations] == [40, 60]
    recorded = read_progress(tiny.run.out)
    assert evaluations[-1][1]["eval/return"] == float(recorded[-1]["eval/return"])
    assert [step for step, _ in rows] == [int(row["step"]) for row in recorded]
    assert rows[-1][1].keys() == recorded[-1].keys() - {"step"}
    assert rows[-1][1]["agent/critic_loss"] == float(recorded[-1]["agent/critic_loss"])


@pytest.mark.parametrize(("told", "stopped_at"), [("on_evaluation", 40), ("on_log", 20)])
def test_a_callback_stops_a_run_that_can_be_continued(tiny, told, stopped_at):
    tiny = tiny.override(learning_starts=10)
    stopped = train(tiny, show_progress=False, **{told: lambda step, values: True})
    assert stopped["total_steps"] == stopped_at and stopped["stopped_by"] == "callback"
    steps = []
    continued = continue_run(
        tiny.run.out, on_log=lambda step, values: steps.append(step), show_progress=False
    )
    assert continued["total_steps"] == 60 and continued["stopped_by"] is None
    assert steps == [step for step in (20, 40, 60) if step > stopped_at]


def test_what_a_callback_happens_to_return_is_no_wish_to_stop(tiny):
    with pytest.raises(TypeError, match=r"`on_log` must return True to stop, .* got \{'a': 1\}"):
        train(tiny, on_log=lambda step, values: {"a": 1}, show_progress=False)
    stopped = train(
        tiny.override(out=tiny.run.out / "b"), on_log=lambda *_: np.True_, show_progress=False
    )
    assert stopped["total_steps"] < tiny.run.total_steps


@pytest.mark.parametrize("answer", [np.zeros(2), torch.zeros(2)], ids=["array", "tensor"])
def test_numbers_that_are_neither_true_nor_false_are_no_answer(answer):
    with pytest.raises(TypeError, match="`on_log` must return True to stop, or False or None"):
        call(lambda step, values: answer, 0, {}, name="on_log")


@pytest.mark.parametrize("name", ["on_evaluation", "on_log"])
def test_what_cannot_be_called_is_refused_before_the_run_begins(tiny, name):
    with pytest.raises(TypeError, match=f"`{name}` must be a function of step and values, or No"):
        train(tiny, show_progress=False, **{name: 3})
    assert not tiny.run.out.exists()


def test_a_callback_that_asks_for_nothing_changes_nothing(tiny, tmp_path):
    other = tiny.override(out=tmp_path / "told")
    plain = train(tiny, show_progress=False)
    told = train(other, on_log=lambda *_: None, on_evaluation=lambda *_: 0, show_progress=False)
    timed = {"wall_seconds", "steps_per_second", "peak_memory_megabytes"}
    assert {k: v for k, v in plain.items() if k not in timed} == {
        k: v for k, v in told.items() if k not in timed
    }


@pytest.mark.parametrize(("wanted", "steps"), [(-1e9, 40), (1e9, 60)])
def test_a_solved_run_stops_at_the_evaluation_that_says_so(tiny, wanted, steps):
    train(tiny, on_evaluation=stop_when_solved(wanted), show_progress=False)
    assert json.loads((tiny.run.out / "summary.json").read_text())["total_steps"] == steps


def test_a_return_counts_as_solved_from_the_number_itself_and_never_unknown():
    solved = stop_when_solved(2.0)
    values = (1.9, 2.0, 2.1, math.nan)
    assert [solved(0, {"eval/return": value}) for value in values] == [False, True, True, False]
    with pytest.raises(ValueError, match="`stop_when_solved` must be a number, got nan"):
        stop_when_solved(math.nan)


def test_all_callbacks_in_turn_are_told_and_any_of_them_stops():
    told = []

    def note(answer):
        def noted(step, values):
            told.append((step, answer))
            return answer

        return noted

    assert in_turn(note(True), None, note(False))(7, {})
    assert not in_turn(note(None), note(False))(8, {})
    assert told == [(7, True), (7, False), (8, None), (8, False)]


@pytest.mark.parametrize(
    ("name", "fails_at"), [("on_evaluation", 40), ("on_log", 40), ("hunger", 33)]
)
def test_an_error_of_the_callers_own_function_loses_nothing(tiny, tmp_path, name, fails_at):
    whole = tiny.override(learning_starts=10, out=tmp_path / "whole", log_interval=5)
    halted = whole.override(out=tmp_path / "halted")
    steps = itertools.count()  # at which a hunger function is asked

    def works(*_):
        return None if name.startswith("on_") else 1.0

    def fails(step, values):
        if (step if name.startswith("on_") else next(steps)) >= fails_at:
            raise ConnectionError("the service is down")
        return works()

    train(whole, show_progress=False, **{name: works})
    with pytest.raises(ConnectionError, match="service") as raised:
        train(halted, show_progress=False, **{name: fails})
    (note,) = raised.value.__notes__
    way = f"--resume {halted.run.out}"
    if name == "hunger":
        way = f"deep_curiosity.continue_run('{halted.run.out}', hunger=...)"
    assert note == f"all up to step {fails_at} is saved; continue with {way}."
    continue_run(halted.run.out, show_progress=False, **{name: works})
    rows = [read_progress(config.run.out) for config in (whole, halted)]
    for row in (row for table in rows for row in table):
        del row["time/steps_per_second"]
    assert rows[0] == rows[1]


def test_a_hunger_function_that_raises_in_an_evaluation_is_told_apart_from_the_environment(tiny):
    def fails_for_one(observation, info):
        if len(observation) == 1:  # as in evaluations alone
            raise ConnectionError("the service is down")
        return np.ones(len(observation))

    with pytest.raises(ConnectionError, match="service") as raised:
        train(tiny.override(num_envs=2), show_progress=False, hunger=fails_for_one)
    (note,) = raised.value.__notes__
    assert note.startswith(f"all up to step {tiny.run.evaluation_interval} is saved; continue")
