import sys
from concurrent.futures import Future
from types import SimpleNamespace

import pytest

from deep_curiosity.experiments.engines.base import Outcome, make_job
from deep_curiosity.experiments.engines.ray import RayEngine
from deep_curiosity.experiments.execution import Ended, Execution
from tests.experiments.engines import functions
from tests.experiments.waiting import wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_jobs_are_done_by_other_processes_and_what_raises_is_told(ray_engine):
    jobs = [make_job(functions.square, 3), make_job(functions.fail, "no")]
    jobs.append(make_job(functions.process))
    squared, failed, process = (future.result() for future in ray_engine.submit(jobs))
    assert (squared, failed) == (Outcome(9), Outcome(error="ArithmeticError: no"))
    assert process.result != functions.process()


def test_as_many_are_done_at_a_time_as_have_their_threads(ray_engine):
    assert ray_engine.capacity(make_job(functions.square, 3)) == 2
    assert ray_engine.capacity(make_job(functions.square, 3, threads=2)) == 1
    assert ray_engine.capacity(make_job(functions.square, 3, threads=64)) == 1


def test_a_job_whose_worker_dies_is_done_by_another(ray_engine, tmp_path):
    execution = Execution(ray_engine, [make_job(functions.die_once, tmp_path)], lambda number: 0)
    assert [each for each in execution if each is not None] == [Ended(0, Outcome(2))]


def test_what_runs_is_told_to_stop(ray_engine, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_engine, "_owned", False)  # it goes on for other tests
    ray_engine.submit([make_job(functions.wait_until_told, tmp_path)])
    wait_until((tmp_path / "begun").exists)
    ray_engine.close()
    assert (tmp_path / "saved").exists()


@pytest.fixture
def pretended(monkeypatch):
    """A cluster of eight cores and two GPUs; what tasks ask for is noted."""
    asked = []

    class Reference:
        future = Future

    class Task:
        def options(self, **options):
            asked.append(options)
            return self

        def remote(self, job):
            return Reference()

    ray = SimpleNamespace(
        __spec__=object(),
        is_initialized=lambda: True,
        remote=lambda function: Task(),
        cluster_resources=lambda: {"CPU": 8.0, "GPU": 2.0},
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    return asked


def test_runs_share_a_gpu_and_no_more_are_given_than_fit(pretended):
    engine = RayEngine(runs_per_gpu=3)
    on_gpu, on_cpu = (make_job(functions.square, 3, device=device) for device in ("cuda", "cpu"))
    assert (engine.capacity(on_gpu), engine.capacity(on_cpu)) == (6, 8)
    engine.submit([on_gpu])
    assert (pretended[0]["num_cpus"], pretended[0]["num_gpus"]) == (1, pytest.approx(1 / 3))
    assert pretended[0]["max_retries"] == 0 and pretended[0]["scheduling_strategy"] == "SPREAD"
    with pytest.raises(ValueError, match="`runs_per_gpu` must be at least 1, got 0"):
        RayEngine(runs_per_gpu=0)
