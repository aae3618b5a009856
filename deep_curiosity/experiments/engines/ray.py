"""Tasks of a Ray cluster, or of Ray on this machine."""

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

from deep_curiosity.experiments.engines.base import Engine, Job, Outcome
from deep_curiosity.requirements import require
from deep_curiosity.transitions import check_counts

STOPPING_SECONDS = 60.0  # in which a run that is told to stop has saved itself


class RayEngine(Engine):
    """Tasks spread over the nodes of a Ray cluster.

    Ray is not asked to repeat what was lost: whoever gives out the jobs sees to that, on every
    engine alike.

    Args:
        address: Of a running cluster, such as `"auto"`; `None` starts Ray on this machine.
        runs_per_gpu: How many runs share a GPU, where their device is one.
        options: Of `ray.init`, such as `runtime_env`, which brings the package to nodes that have
            it not.

    Raises:
        ImportError: If Ray is missing, with the command that installs it.
        TypeError: If the runs of a GPU are no whole number.
        ValueError: If no run would fit on a GPU.
    """

    def __init__(
        self, address: str | None = None, *, runs_per_gpu: int = 1, **options: Any
    ) -> None:
        check_counts(runs_per_gpu=runs_per_gpu)
        require("ray", extra="ray")
        import ray

        self._ray = ray
        self._runs_per_gpu = runs_per_gpu
        self._owned = not ray.is_initialized()
        if self._owned:
            own = {} if address else {"include_dashboard": False}
            ray.init(address=address, **{"log_to_driver": False} | own | options)
        self._task = ray.remote(_do)
        self._running: set[Any] = set()

    def capacity(self, job: Job) -> int:
        """How many such jobs the nodes that are there at present have room for, one at least."""
        there = self._ray.cluster_resources()
        needed = self._needs(job)
        fitting = [
            int(there.get(name, 0) / needed[key])
            for key, name in (("num_cpus", "CPU"), ("num_gpus", "GPU"))
            if needed[key]
        ]
        return max(1, min(fitting))

    def _needs(self, job: Job) -> dict[str, float]:
        gpus = 0.0 if job.device == "cpu" else 1 / self._runs_per_gpu
        return {"num_cpus": float(job.threads), "num_gpus": gpus}

    def submit(self, jobs: Sequence[Job]) -> list[Future[Outcome]]:
        """Give every job to Ray as a task."""
        return [self._submit(job) for job in jobs]

    def _submit(self, job: Job) -> Future[Outcome]:
        task = self._task.options(
            **self._needs(job), max_retries=0, scheduling_strategy="SPREAD", name="run"
        )
        reference = task.remote(job)
        self._running.add(reference)
        future: Future[Outcome] = reference.future()
        future.add_done_callback(lambda _: self._running.discard(reference))
        return future

    def close(self) -> None:
        """Interrupt what still runs, let it save itself, and leave the cluster."""
        running = [*self._running]
        for reference in running:
            self._ray.cancel(reference)
        if running:
            self._ray.wait(running, num_returns=len(running), timeout=STOPPING_SECONDS)
        if self._owned:
            self._ray.shutdown()


def _do(job: Job) -> Outcome:
    return job.run()
