"""Runners: what a benchmark asks of an agent, and the process in which each one lives.

Another agent joins by an adapter, a callable without arguments that makes a `Runner`, as
`stable_baselines.py` is one; `scripts/benchmark.py --peers NAME module:callable` takes it in.
"""

import importlib
import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch


@runtime_checkable
class Runner(Protocol):
    """An agent in its environment, with random actions behind it and updates ahead."""

    def fill(self, num_transitions: int) -> None:
        """Put transitions into replay, as if so many steps had been taken."""

    def step(self, num_steps: int) -> None:
        """Take environment steps, each followed by one update."""


def import_runner(address: str, *args: Any) -> Runner:
    """Import `module:callable` and call it, here and not earlier: its package may be missing."""
    module, name = address.split(":")
    runner: Runner = getattr(importlib.import_module(module), name)(*args)
    return runner


class Result(NamedTuple):
    """What a call of a worker gives back."""

    value: Any
    seconds: float
    """That the call took in the worker."""
    peak_megabytes: float
    """Largest resident memory of the worker so far."""


class Worker:
    """A process of its own in which an object lives, which computes only when it is called.

    Matrix precision, memory allocation and compiled code concern a whole process: so no runner
    profits or suffers from another's. Nothing is compiled beforehand; torch has one thread.

    Args:
        factory: Makes the object; may be pickled.

    Raises:
        ImportError: If the factory raises it.
    """

    def __init__(self, factory: Callable[[], object]) -> None:
        started = time.perf_counter()
        context = multiprocessing.get_context("spawn")
        self._pipe, end = context.Pipe()
        self._process = context.Process(target=_serve, args=(end, factory), daemon=True)
        self._process.start()
        end.close()
        self._receive()
        self.start_seconds = time.perf_counter() - started
        """From the start of the process, imports included, until the object was there."""

    def call(self, method: str, *args: Any) -> Result:
        """Call a method of the object.

        Raises:
            RuntimeError: If the worker fails; its own error is printed.
        """
        self._pipe.send((method, args))
        return self._receive()

    def close(self) -> None:
        """End the process."""
        self._pipe.send(None)
        self._process.join()

    def _receive(self) -> Result:
        try:
            result = self._pipe.recv()
        except EOFError as error:
            raise RuntimeError("a worker failed; its error is printed above.") from error
        if isinstance(result, ImportError):
            raise result
        assert isinstance(result, Result)
        return result


def _serve(pipe: Connection, factory: Callable[[], object]) -> None:
    with TemporaryDirectory() as cache:
        os.environ["TORCHINDUCTOR_CACHE_DIR"] = cache  # nothing is found that was compiled before
        torch.set_num_threads(1)
        try:
            runner = factory()
        except ImportError as error:
            pipe.send(error)
            return
        pipe.send(Result(None, 0.0, peak_megabytes()))
        while (request := pipe.recv()) is not None:
            method, args = request
            started = time.perf_counter()
            value = getattr(runner, method)(*args)
            pipe.send(Result(value, time.perf_counter() - started, peak_megabytes()))


def peak_megabytes() -> float:
    """Largest resident memory of this process so far; NaN where the system does not say it.

    `resource.getrusage` would count what the parent held when it started this process.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return int(lines["VmHWM"].split()[0]) * 1024 / 1e6
