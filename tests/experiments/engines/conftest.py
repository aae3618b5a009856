"""Ray of two cores on this machine, for the tests that need it."""

import pytest


@pytest.fixture(scope="session")
def ray_engine():
    pytest.importorskip("ray")
    from deep_curiosity.experiments.engines.ray import RayEngine

    with RayEngine(num_cpus=2, object_store_memory=2**27) as engine:
        yield engine
