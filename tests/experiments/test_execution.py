"""An engine that ends jobs as a test says shows in which order they are given out, and again."""

from concurrent.futures import Future

import pytest

from deep_curiosity.experiments import execution
from deep_curiosity.experiments.engines.base import Engine, Job, Outcome
from deep_curiosity.experiments.execution import Ended, Execution

LOST = ConnectionError("the node is gone\nand this is its state")
LEFT = SystemExit(0)
STOPPED = Outcome(error="RunStoppedError: stopped", stopped=True)
HELD = Outcome(error="LeaseError: held", held=True)


class ScriptedEngine(Engine):
    """Ends every job at once, with the outcomes that are listed for it, one for each try."""

    def __init__(self, script, capacity=None):
        self.script = {number: [*outcomes] for number, outcomes in script.items()}
        self.given = []
        self.most = 0
        self._capacity = capacity

    def capacity(self, job):
        return self._capacity

    def submit(self, jobs):
        self.most = max(self.most, len(jobs))
        return [self._end(int(job.payload)) for job in jobs]

    def _end(self, number):
        self.given.append(number)
        future = Future()
        outcome = self.script[number].pop(0)
        if isinstance(outcome, Outcome):
            future.set_result(outcome)
        else:
            future.set_exception(outcome)
        return future

    def close(self):
        pass


def jobs(count):
    return [Job(str(number).encode()) for number in range(count)]


def ends(engine, count, step_of=lambda number: 0):
    return [each for each in Execution(engine, jobs(count), step_of) if each is not None]


def test_all_are_given_at_once_where_the_engine_keeps_the_queue():
    engine = ScriptedEngine({number: [Outcome(number)] for number in range(3)})
    assert ends(engine, 3) == [Ended(number, Outcome(number)) for number in range(3)]
    assert engine.most == 3


def test_no_more_are_given_than_are_computed_and_what_was_lost_comes_first():
    script = {0: [Outcome(0)], 1: [LOST, Outcome(1)], 2: [Outcome(2)], 3: [Outcome(3)]}
    engine = ScriptedEngine(script, capacity=2)
    found = ends(engine, 4)
    assert engine.most == 2
    assert engine.given == [0, 1, 2, 1, 3]
    assert sorted(found) == [Ended(number, Outcome(number)) for number in range(4)]


def test_what_raises_is_not_tried_again():
    failed = Outcome(error="ValueError: no")
    engine = ScriptedEngine({0: [failed], 1: [Outcome(1)]})
    assert ends(engine, 2) == [Ended(0, failed), Ended(1, Outcome(1))]


@pytest.mark.parametrize("lost", [LOST, LEFT, STOPPED])
def test_what_gets_no_further_is_given_up(lost):
    engine = ScriptedEngine({0: [lost] * 10})
    (ended,) = ends(engine, 1)
    assert len(engine.given) == execution.MOST_TRIES
    messages = {LOST: "ConnectionError: the node is gone", LEFT: "SystemExit: 0"}
    assert ended.outcome.error == messages.get(lost, STOPPED.error)


@pytest.mark.parametrize(("text", "reason"), [("\n \n  it broke\nthere", "it broke"), ("", "")])
def test_the_reason_of_what_is_lost_is_its_first_line_that_says_something(text, reason):
    engine = ScriptedEngine({0: [RuntimeError(text)] * 10})
    (ended,) = ends(engine, 1)
    assert ended.outcome.error == f"RuntimeError: {reason}"


def test_what_gets_further_is_tried_as_often_as_it_is_lost():
    engine = ScriptedEngine({0: [LOST] * 20 + [Outcome("done")]})
    assert ends(engine, 1, lambda number: len(engine.given)) == [Ended(0, Outcome("done"))]
    assert len(engine.given) == 21


def test_a_run_that_another_process_holds_is_asked_for_later(monkeypatch):
    monkeypatch.setattr(execution, "HELD_SECONDS", 0.02)
    monkeypatch.setattr(execution, "TICK", 0.01)
    engine = ScriptedEngine({0: [HELD] * 6 + [Outcome(0)], 1: [Outcome(1)]}, capacity=1)
    assert ends(engine, 2)[0] == Ended(1, Outcome(1))  # which has not waited for it
    assert engine.given.count(0) == 7 > execution.MOST_TRIES
    engine = ScriptedEngine({0: [HELD] * 100})
    assert ends(engine, 1) == [Ended(0, HELD)]
    assert len(engine.given) == execution.HELD_TRIES
