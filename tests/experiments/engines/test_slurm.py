"""Slurm's part is played by submitit's own executor of processes of this machine."""

import gc
import sys
from types import SimpleNamespace

import pytest

from deep_curiosity.experiments.engines.base import Outcome, make_job
from deep_curiosity.experiments.execution import Ended, Execution
from tests.experiments.engines import functions
from tests.experiments.waiting import wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture
def engine(tmp_path, monkeypatch):
    pytest.importorskip("submitit")
    from deep_curiosity.experiments.engines import slurm

    monkeypatch.setattr(slurm, "POLLING_SECONDS", 0.1)
    with slurm.SlurmEngine(tmp_path / "slurm", cluster="local") as engine:
        yield engine
    del engine
    gc.collect()  # so that warnings about the processes of submitit fall into these tests


def test_an_array_of_jobs_is_done_and_a_lost_one_again(engine, tmp_path):
    jobs = [make_job(functions.fail, "no"), make_job(functions.die_once, tmp_path)]
    assert engine.capacity(jobs[0]) is None
    ended = [each for each in Execution(engine, jobs, lambda number: 0) if each is not None]
    assert sorted(ended) == [Ended(0, Outcome(error="ArithmeticError: no")), Ended(1, Outcome(2))]


def test_what_is_preempted_is_submitted_again_as_it_was(engine):
    from deep_curiosity.experiments.engines.slurm import Requeued

    job = make_job(functions.square, 3)
    again = Requeued().checkpoint(job)
    assert again.function(*again.args) == Outcome(9)


def test_jobs_are_cancelled_where_the_engine_is_left(engine, tmp_path):
    engine.submit([make_job(functions.wait_until_told, tmp_path)])
    wait_until((tmp_path / "begun").exists)
    (job,) = engine._pending.values()
    engine.close()
    wait_until(job.done)  # submitit kills it where it has not ended in a second: it need not save


@pytest.fixture
def asked(monkeypatch):
    """What each array asks for, of a submitit that keeps its parameters, as the true one does."""
    asked = []

    class AutoExecutor:
        cluster = "slurm"

        def __init__(self, **options):
            self.parameters = {}

        def update_parameters(self, **parameters):
            self.parameters |= {name: one for name, one in parameters.items() if one is not None}

        def map_array(self, function, jobs):
            asked.append(dict(self.parameters))
            return [SimpleNamespace(done=lambda: False, cancel=lambda check: None) for _ in jobs]

    submitit = SimpleNamespace(__spec__=object(), AutoExecutor=AutoExecutor)
    monkeypatch.setitem(sys.modules, "submitit", submitit)
    return asked


@pytest.mark.parametrize(
    ("own", "gpus"),
    [
        ({}, [None, 0]),  # a cluster that knows no GPUs may refuse even none of them
        ({"gpus_per_node": 2}, [2, 2]),
        ({"gpus_per_node": 2, "slurm_gpus_per_node": 3}, [3, 3]),
    ],
)
def test_a_job_without_a_gpu_asks_for_none_after_one_with_it(asked, tmp_path, own, gpus):
    from deep_curiosity.experiments.engines.slurm import SlurmEngine

    devices = ["cpu", "cuda", "cpu"]
    with SlurmEngine(tmp_path, **own) as engine:
        engine.submit([make_job(functions.square, 3, device=device) for device in devices])
    first, last = gpus
    assert [each.get("gpus_per_node") for each in asked] == [first, 1, last]
