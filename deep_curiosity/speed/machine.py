"""Fitting a training process to its machine: matrix products, memory, device, compiler.

All of it concerns the whole process, so scripts do it and the library never does.
"""

import os
import shutil
import time
from typing import Literal

import torch

from deep_curiosity.speed.precision import FLOAT32_ERROR, matmul_error
from deep_curiosity.speed.malloc import settle_memory
from deep_curiosity.training.config import Settings

MatmulPrecision = Literal["highest", "high", "medium"]
PRECISIONS: tuple[MatmulPrecision, ...] = ("highest", "high", "medium")
WORTH_COMPILING = 5_000  # updates, after which what compiling took is won back


def prepare_machine(settings: Settings) -> MatmulPrecision:
    """Set threads, matrix precision and allocation for a run, and say so in a line.

    Returns:
        The precision, which with `"auto"` is for the clock to choose.
    """
    torch.set_num_threads(settings.threads)
    settle_memory()
    precision = choose_matmul_precision(settings.matmul_precision, settings.device)
    torch.set_float32_matmul_precision(precision)
    error = matmul_error(settings.device)
    how = "compiled" if should_compile(settings) else "eager"
    print(f"Matrix products {precision}, relative error {error:.1e}; updates {how}", flush=True)
    return precision


def choose_matmul_precision(asked: str, device: str = "cpu") -> MatmulPrecision:
    """The precision asked for, or with `"auto"` the fastest that is float32 on this machine."""
    before = torch.get_float32_matmul_precision()
    rates: dict[MatmulPrecision, float] = {}
    for precision in PRECISIONS:
        if asked == precision:
            return precision
        torch.set_float32_matmul_precision(precision)
        if matmul_error(device) < FLOAT32_ERROR:
            rates[precision] = matmul_rate(device=device)
    torch.set_float32_matmul_precision(before)
    return max(rates, key=lambda precision: rates[precision])


def matmul_rate(
    members: int = 4, size: int = 256, *, device: str = "cpu", repeats: int = 20
) -> float:
    """Floating-point operations per second of a batched product, the best of some repeats."""
    left, right = torch.randn(2, members, size, size, device=device)
    seconds = []
    for _ in range(repeats):
        wait_for(device)
        started = time.perf_counter()
        torch.bmm(left, right)
        wait_for(device)
        seconds.append(time.perf_counter() - started)
    return 2 * members * size**3 / min(seconds)


def should_compile(settings: Settings) -> bool:
    """Whether the updates of a run are to be compiled; `"auto"` asks if it is worth its time."""
    if settings.compile != "auto":
        return settings.compile == "on"
    num_updates = (settings.total_steps - settings.learning_starts) * settings.update_to_data
    return num_updates >= WORTH_COMPILING and _has_compiler(settings.device)


def _has_compiler(device: str) -> bool:
    if torch.device(device).type != "cpu":
        return True  # triton brings its own
    return shutil.which(os.environ.get("CXX", "g++")) is not None


def wait_for(device: str) -> None:
    """Let the work that was handed to a GPU end, so that a clock may be read."""
    if torch.device(device).type == "cuda":
        torch.cuda.synchronize()
