"""Processes that run cells of a study, and end with the process that started them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess

from deep_curiosity.training.interruption import terminated_like_interrupted

PATIENCE = 0.5
"""Seconds from one request to end to the next."""


@contextmanager
def worker_processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of this machine, which end with the block, with this process, or by a signal.

    Where the block is left by an error, by Ctrl-C or by SIGTERM, each run in progress leaves its
    checkpoint first. So it does where this process is killed.
    """
    others = multiprocessing.active_children()
    context = multiprocessing.get_context("spawn")
    with (
        terminated_like_interrupted(),
        ProcessPoolExecutor(workers, mp_context=context, initializer=follow_parent) as pool,
    ):
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            end([child for child in multiprocessing.active_children() if child not in others])
            raise


def end(processes: Sequence[BaseProcess]) -> None:
    """Request of processes to end until they have: a run that trains saves before it does."""
    while alive := [process for process in processes if process.is_alive()]:
        for process in alive:
            process.terminate()
        alive[0].join(PATIENCE)


def follow_parent() -> None:
    """Have this process end when the one that started it does, and leave Ctrl-C to that one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    while True:  # a run in progress notes the first and saves; after it, the next one ends all
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(PATIENCE)
