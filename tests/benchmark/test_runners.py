from functools import partial

import pytest

from deep_curiosity.benchmark.runners import Worker, import_runner, peak_megabytes


def test_a_worker_computes_in_a_process_of_its_own():
    worker = Worker(list)
    worker.call("append", 3)
    assert worker.call("count", 3).value == 1
    worker.close()


def test_a_missing_package_is_an_import_error():
    with pytest.raises(ImportError, match="no_such_package"):
        Worker(partial(import_runner, "no_such_package:Agent"))


@pytest.mark.slow
def test_stable_baselines_steps():
    pytest.importorskip("stable_baselines3")
    address = "deep_curiosity.benchmark.stable_baselines:StableBaselines"
    worker = Worker(partial(import_runner, address, "MountainCarContinuous-v0"))
    worker.call("fill", 300)
    assert worker.call("step", 2).seconds > 0
    worker.close()


def test_memory_is_that_of_this_process():
    assert 50 < peak_megabytes() < 100_000
