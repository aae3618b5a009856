"""An engine whose workers have another working directory than the caller, as on a cluster."""

import os
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path

from deep_curiosity.experiments.engines.base import Engine, Job, Outcome


class ElsewhereEngine(Engine):
    """Computes jobs in this process, one after another, each in a folder."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder

    def submit(self, jobs: Sequence[Job]) -> list[Future[Outcome]]:
        return [self._compute(job) for job in jobs]

    def _compute(self, job: Job) -> Future[Outcome]:
        future: Future[Outcome] = Future()
        here = Path.cwd()
        os.chdir(self.folder)
        try:
            future.set_result(job.run())
        finally:
            os.chdir(here)
        return future

    def close(self) -> None:
        """There is nothing to free."""
