"""Processes of this machine, and any executor of `concurrent.futures`."""

import os
import signal
from collections.abc import Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import suppress
from multiprocessing import get_context
from queue import SimpleQueue
from threading import Lock

from deep_curiosity.experiments.engines.base import Engine, Job, Outcome
from deep_curiosity.experiments.workers import follow_parent
from deep_curiosity.training.interruption import interrupt_thread, interruptible_thread
from deep_curiosity.transitions import check_counts


class LocalEngine(Engine):
    """Processes of this machine; where one dies, its run alone is lost.

    Args:
        workers: Processes at a time.

    Raises:
        TypeError: If the workers are no whole number.
        ValueError: If there is none.
    """

    def __init__(self, workers: int = 2) -> None:
        check_counts(workers=workers)
        self.workers = workers
        self._threads = ThreadPoolExecutor(workers)
        self._idle: SimpleQueue[_Worker] = SimpleQueue()
        self._all = [_Worker() for _ in range(workers)]
        for worker in self._all:
            self._idle.put(worker)

    def capacity(self, job: Job) -> int:
        """As many as there are workers."""
        return self.workers

    def submit(self, jobs: Sequence[Job]) -> list[Future[Outcome]]:
        """Have them done by the workers, in this order."""
        return [self._threads.submit(self._run, job) for job in jobs]

    def _run(self, job: Job) -> Outcome:
        worker = self._idle.get()  # there is one for every thread
        try:
            return worker.run(job)
        finally:
            self._idle.put(worker)

    def close(self) -> None:
        """Tell the workers to stop, and wait until what they do is saved."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._all:
            worker.stop()  # all of them, before any is waited for
        for worker in self._all:
            worker.wait()
        self._threads.shutdown()


class _Worker:
    """A process, started when it is needed, and again after it has died."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._pid = 0
        self._busy = False
        self._stopped = False
        self._lock = Lock()

    def run(self, job: Job) -> Outcome:
        """Have a job done.

        Raises:
            BrokenExecutor: If the process dies.
            CancelledError: If the worker was told to stop before.
        """
        try:
            return self._begin(self._started(), job).result()
        except BrokenExecutor:
            self._pool = None
            raise
        finally:
            self._busy = False

    def _started(self) -> ProcessPoolExecutor:
        with self._lock:
            if self._stopped:
                raise CancelledError
            if self._pool is not None:
                return self._pool
            pool = self._pool = ProcessPoolExecutor(1, get_context("spawn"), follow_parent)
        self._pid = pool.submit(os.getpid).result()  # takes seconds, in which it may be stopped
        return pool

    def _begin(self, pool: ProcessPoolExecutor, job: Job) -> Future[Outcome]:
        with self._lock:
            if self._stopped:
                raise CancelledError
            self._busy = True
            return pool.submit(job.run)

    def stop(self) -> None:
        """Tell the process to stop, which a run does after its present step."""
        with self._lock:
            self._stopped = True
            if self._busy:
                with suppress(ProcessLookupError):
                    os.kill(self._pid, signal.SIGTERM)

    def wait(self) -> None:
        """Wait until the process, which was told to stop, has ended."""
        if (pool := self._pool) is not None:
            pool.shutdown(cancel_futures=True)


class ExecutorEngine(Engine):
    """Any executor of `concurrent.futures`, such as Dask's; it is the caller's to close.

    Args:
        executor: Takes what can be pickled, or runs in this process.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._handed: list[tuple[_Handed, Future[Outcome]]] = []

    def submit(self, jobs: Sequence[Job]) -> list[Future[Outcome]]:
        """Hand them on; those that a broken executor does not take are lost."""
        return [self._submit(_Handed(job)) for job in jobs]

    def _submit(self, handed: "_Handed") -> Future[Outcome]:
        try:
            future = self._executor.submit(handed)
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        self._handed.append((handed, future))
        return future

    def close(self) -> None:
        """Take back what has not begun, and tell what runs in threads of this process to stop."""
        for handed, future in self._handed:
            if not future.cancel():
                handed.stop()


class _Handed:
    """A job that is handed on, and knows the thread that does it, if that is of this process."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._thread: int | None = None

    def __call__(self) -> Outcome:
        """Do it."""
        with interruptible_thread() as self._thread:
            try:
                return self._job.run()
            finally:
                self._thread = None

    def stop(self) -> None:
        """Tell it to stop, which a run does after its present step."""
        if (thread := self._thread) is not None:
            interrupt_thread(thread)
