from concurrent.futures import BrokenExecutor, ThreadPoolExecutor

import pytest

from deep_curiosity.experiments.engines.base import Outcome, make_job
from deep_curiosity.experiments.engines.local import ExecutorEngine, LocalEngine
from tests.experiments.engines import functions
from tests.experiments.waiting import wait_until


def test_jobs_are_done_in_processes_that_stay():
    with LocalEngine(1) as engine:
        squares = [make_job(functions.square, number) for number in (2, 3)]
        assert [future.result() for future in engine.submit(squares)] == [Outcome(4), Outcome(9)]
        asked = engine.submit([make_job(functions.process)] * 2)
        pids = {future.result().result for future in asked}
    assert len(pids) == 1 and pids != {functions.process()}


def test_what_raises_is_told_in_words_and_a_death_concerns_one_job_alone(tmp_path):
    jobs = [
        make_job(functions.die_once, tmp_path),
        make_job(functions.fail, "no"),
        make_job(functions.stop),
    ]
    with LocalEngine(1) as engine:
        assert engine.capacity(jobs[0]) == 1
        lost, failed, stopped = engine.submit(jobs)
        with pytest.raises(BrokenExecutor):
            lost.result()
        assert failed.result() == Outcome(error="ArithmeticError: no")
        assert stopped.result() == Outcome(error="RunStoppedError: stopped", stopped=True)
        assert engine.submit([jobs[0]])[0].result().result == 2


def test_what_runs_is_told_to_stop_and_what_waits_is_forgotten(tmp_path):
    with LocalEngine(1) as engine:
        running, waiting = engine.submit([make_job(functions.wait_until_told, tmp_path)] * 2)
        wait_until((tmp_path / "begun").exists)
    assert running.result().result == "saved"
    assert waiting.cancelled()


def test_any_executor_is_an_engine_and_stays_open():
    with ThreadPoolExecutor(1) as executor:
        engine = ExecutorEngine(executor)
        with engine:
            job = make_job(functions.square, 3)
            assert engine.capacity(job) is None
            assert engine.submit([job])[0].result() == Outcome(9)
        assert executor.submit(functions.square, 4).result() == 16


def test_without_workers_nothing_is_done():
    with pytest.raises(ValueError, match="`workers` must be at least 1, got 0"):
        LocalEngine(0)
