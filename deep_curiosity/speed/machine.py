"""Fitting a training process to its machine for as long as it trains, and restoring it after."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Literal

import torch

from deep_curiosity.speed.config import SpeedConfig
from deep_curiosity.speed.malloc import memory_kept
from deep_curiosity.speed.precision import FLOAT32_ERROR, matmul_error

MatmulPrecision = Literal["highest", "high", "medium"]
PRECISIONS: tuple[MatmulPrecision, ...] = ("highest", "high", "medium")
RATE_ROUNDS = 4  # of measuring each precision
FAR_BEHIND = 1.5  # times as fast, which no noise of a clock makes
WORTH_COMPILING = 5_000  # updates, after which what compiling took is won back
EAGER_UPDATES = 500  # of `"auto"` before the graph is made, so that a run is soon seen to learn


@contextmanager
def fitted_machine(config: SpeedConfig) -> Iterator[MatmulPrecision]:
    """Set threads, matrix precision and allocation inside the block, as they were behind it.

    Yields:
        The precision of matrix products, which `"auto"` leaves to what the machine is good at.
    """
    threads, precision = torch.get_num_threads(), torch.get_float32_matmul_precision()
    with ExitStack() as stack:
        if config.keep_memory:
            stack.enter_context(memory_kept())
        try:
            torch.set_num_threads(config.threads)
            chosen = choose_matmul_precision(config.matmul_precision, config.device)
            torch.set_float32_matmul_precision(chosen)
            yield chosen
        finally:
            torch.set_num_threads(threads)
            torch.set_float32_matmul_precision(precision)


def choose_matmul_precision(wanted: str, device: str = "cpu") -> MatmulPrecision:
    """The precision wanted, or with `"auto"` the highest that no other leaves far behind.

    Each rounds in its own way, so that two runs of one seed are the same only where both have the
    same one: the noise of a clock may not choose between two that are about as fast. Where torch's
    own choice is a bad one, another that is float32 as well is twice as fast.
    """
    for precision in PRECISIONS:
        if wanted == precision:
            return precision
    before = torch.get_float32_matmul_precision()
    rates: dict[MatmulPrecision, float] = {}
    for _ in range(RATE_ROUNDS):  # in turns, so that what disturbs the machine disturbs them all
        for precision in PRECISIONS:
            torch.set_float32_matmul_precision(precision)
            if matmul_error(device) < FLOAT32_ERROR:
                rates[precision] = max(rates.get(precision, 0.0), matmul_rate(device=device))
    torch.set_float32_matmul_precision(before)
    fastest = max(rates.values())
    return next(precision for precision, rate in rates.items() if FAR_BEHIND * rate >= fastest)


def matmul_rate(
    members: int = 4, size: int = 256, *, device: str = "cpu", repeats: int = 5
) -> float:
    """Floating-point operations per second of a batched product, the best of some repeats."""
    generator = torch.Generator().manual_seed(0)  # leaves the global stream where it is
    left, right = torch.randn(2, members, size, size, generator=generator).to(device)
    seconds = []
    for _ in range(repeats):
        wait_for(device)
        started = time.perf_counter()
        torch.bmm(left, right)
        wait_for(device)
        seconds.append(time.perf_counter() - started)
    return 2 * members * size**3 / min(seconds)


def should_compile(config: SpeedConfig, num_updates: float) -> bool:
    """Whether so many updates are to be compiled; `"auto"` does where it is worth its time."""
    if config.compile != "auto":
        return config.compile == "on"
    return num_updates >= WORTH_COMPILING and _has_compiler(config.device)


def _has_compiler(device: str) -> bool:
    if torch.device(device).type != "cpu":
        return True  # triton brings its own
    return shutil.which(os.environ.get("CXX", "g++")) is not None


def wait_for(device: str) -> None:
    """Let the work that was handed to a GPU end, so that a clock may be read."""
    if torch.device(device).type == "cuda":
        torch.cuda.synchronize()
