"""Jobs of a Slurm cluster, submitted as arrays through submitit."""

import threading
from collections.abc import Sequence
from concurrent.futures import Future
from itertools import groupby
from pathlib import Path
from typing import Any

from deep_curiosity.experiments.engines.base import Engine, Job, Outcome
from deep_curiosity.requirements import require

POLLING_SECONDS = 2.0  # from one look at the files of the jobs to the next
DAY = 24 * 60  # minutes; submitit's own limit is five of them


class SlurmEngine(Engine):
    """An array of Slurm jobs; a preempted one is queued again, and goes on.

    Args:
        folder: For the files of the jobs, on a disk that all nodes share.
        cluster: `None` takes Slurm where it is installed, and processes of this machine where it
            is not; `"local"` takes those.
        parameters: Of submitit's `update_parameters`, such as `slurm_partition` or `timeout_min`.

    Raises:
        ImportError: If submitit is missing, with the command that installs it.
    """

    def __init__(self, folder: Path, *, cluster: str | None = None, **parameters: Any) -> None:
        require("submitit", extra="slurm")
        import submitit

        self._executor = submitit.AutoExecutor(folder=folder, cluster=cluster)
        self._executor.update_parameters(**{"timeout_min": DAY} | parameters)
        own = parameters.get("gpus_per_node")
        self._gpus = parameters.get(f"{self._executor.cluster}_gpus_per_node", own)
        self._pending: dict[Future[Outcome], Any] = {}
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._poller = threading.Thread(target=self._poll, daemon=True)
        self._poller.start()

    def submit(self, jobs: Sequence[Job]) -> list[Future[Outcome]]:
        """Submit the jobs, as one array for each kind of need."""
        futures: list[Future[Outcome]] = []
        for needs, alike in groupby(jobs, key=self._needs):
            self._executor.update_parameters(**needs)
            if needs["gpus_per_node"] is not None:  # which submitit keeps for later arrays
                self._gpus = self._gpus or 0
            for submitted in self._executor.map_array(Requeued(), [*alike]):
                future: Future[Outcome] = Future()
                with self._lock:
                    self._pending[future] = submitted
                futures.append(future)
        return futures

    def _needs(self, job: Job) -> dict[str, int | None]:
        """All that jobs differ in; `None` leaves to Slurm what was never asked for."""
        gpus = self._gpus if job.device == "cpu" else 1
        return {"cpus_per_task": job.threads, "gpus_per_node": gpus}

    def _poll(self) -> None:
        """Tell the futures what has become of their jobs."""
        while not self._closed.wait(POLLING_SECONDS):
            with self._lock:
                pending = [*self._pending.items()]
            for future, submitted in pending:
                if submitted.done():
                    self._end(future, submitted)

    def _end(self, future: "Future[Outcome]", submitted: Any) -> None:
        with self._lock:
            del self._pending[future]
        try:
            future.set_result(submitted.result())
        except Exception as error:  # there is no result: the job was lost
            future.set_exception(error)

    def close(self) -> None:
        """Cancel the jobs that still wait or run."""
        self._closed.set()
        self._poller.join()
        for submitted in self._pending.values():
            submitted.cancel(check=False)


class Requeued:
    """Does a job, and tells submitit to submit it again where Slurm takes the node away."""

    def __call__(self, job: Job) -> Outcome:
        """Do the job."""
        return job.run()

    def checkpoint(self, job: Job) -> Any:
        """What is submitted instead at a preemption: the same, since a run goes on by itself."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, job)
