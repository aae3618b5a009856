from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from importlib import import_module
from multiprocessing import get_context

import pytest

from deep_curiosity.experiments.engines import base
from deep_curiosity.experiments.engines.base import Outcome, make_job
from deep_curiosity.experiments.engines.local import ExecutorEngine, LocalEngine
from deep_curiosity.training.interruption import is_interrupted
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


def test_all_that_runs_is_told_to_stop_before_any_is_waited_for(tmp_path):
    names = [("a", "b"), ("b", "a")]
    with LocalEngine(2) as engine:
        futures = engine.submit(
            [make_job(functions.meet_once_told, tmp_path, *each) for each in names]
        )
        wait_until(lambda: len([*tmp_path.glob("* begun")]) == 2)
    assert [future.result().result for future in futures] == [True, True]


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


@pytest.mark.parametrize("workers", ["2", 1.5, True])
def test_workers_are_counted_in_whole_numbers(workers):
    with pytest.raises(TypeError, match=f"`workers` must be a whole number, got {workers!r}"):
        LocalEngine(workers)


def test_a_worker_that_is_told_to_stop_while_it_starts_begins_nothing(tmp_path):
    with LocalEngine(1) as engine:
        (future,) = engine.submit([make_job(functions.wait_until_told, tmp_path)])
        wait_until(lambda: engine._all[0]._pool is not None)
    with pytest.raises((BrokenExecutor, CancelledError, RuntimeError)):
        future.result(timeout=60)
    assert not (tmp_path / "begun").exists()


def test_a_worker_that_was_told_to_stop_is_not_started():
    with LocalEngine(1) as engine:
        worker = engine._all[0]
        worker.stop()
        with pytest.raises(CancelledError):
            worker.run(make_job(functions.square, 2))
    assert worker._pool is None


def test_a_pool_that_breaks_loses_what_it_does_not_take(tmp_path):
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as executor,
        ExecutorEngine(executor) as engine,
    ):
        (lost,) = engine.submit([make_job(functions.die_once, tmp_path)])
        with pytest.raises(BrokenExecutor):
            lost.result()
        (refused,) = engine.submit([make_job(functions.square, 2)])
        with pytest.raises(BrokenExecutor):
            refused.result()


def test_a_run_in_a_thread_is_told_to_stop():
    with ThreadPoolExecutor(1) as executor:
        with ExecutorEngine(executor) as engine:
            running, waiting = engine.submit([make_job(functions.wait_until_interrupted)] * 2)
            wait_until(running.running)
        assert running.result(timeout=60) == Outcome("stopped")
        assert waiting.cancelled()
        assert not executor.submit(is_interrupted).result()


def test_a_file_of_the_user_s_own_is_loaded_where_a_job_is_done(tmp_path, monkeypatch):
    (tmp_path / "beside_it.py").write_text("NUMBER = 5")
    path = tmp_path / "file_that_travels.py"
    path.write_text(
        "import gymnasium\nfrom beside_it import NUMBER\n"
        "gymnasium.register('Travelled-v0', 'gymnasium.envs.classic_control:PendulumEnv')\n"
        "def find(_): return gymnasium.spec('Travelled-v0').id, NUMBER, __name__\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(base, "_own_modules", {})
    module = import_module(path.stem)
    base.send_along(module)
    job = make_job(module.find, None)
    path.unlink()  # its text has travelled
    monkeypatch.undo()  # a worker is not given the folder
    with LocalEngine(1) as engine:
        found = engine.submit([job])[0].result()
    assert found == Outcome(("Travelled-v0", 5, path.stem))
