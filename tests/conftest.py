"""One thread, and a random stream of its own for every test."""

from collections.abc import Iterator

import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def own_random_stream() -> Iterator[None]:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield
