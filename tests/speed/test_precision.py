import pytest
import torch

from deep_curiosity.speed import precision
from deep_curiosity.speed.precision import FLOAT32_ERROR, matmul_error, matmul_is_float32


def test_the_highest_precision_is_float32():
    torch.set_float32_matmul_precision("highest")
    assert matmul_is_float32() and 0 < matmul_error() < 1e-6


def test_products_that_are_not_float32_are_noticed(monkeypatch):
    monkeypatch.setattr(precision, "_measured_error", lambda switch, device: 10 * FLOAT32_ERROR)
    assert not matmul_is_float32()


@pytest.mark.parametrize("switch", ["highest", "high", "medium"])
def test_to_measure_leaves_the_switch_and_the_random_stream_alone(switch):
    precision._measured_error.cache_clear()
    torch.set_float32_matmul_precision(switch)
    random_state = torch.get_rng_state()
    assert 0 < matmul_error() < 1e-2
    assert torch.get_float32_matmul_precision() == switch
    assert torch.get_rng_state().equal(random_state)


def test_an_error_is_measured_once_for_each_switch():
    precision._measured_error.cache_clear()
    for switch in ("highest", "high", "highest"):
        torch.set_float32_matmul_precision(switch)
        matmul_error()
    assert precision._measured_error.cache_info().misses == 2
