"""What an engine is: it takes jobs, and gives a future for each, wherever they are computed."""

import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple

import cloudpickle

from deep_curiosity.experiments.runs import RunStoppedError
from deep_curiosity.training.lease import LeaseError


class Outcome(NamedTuple):
    """How a job ended where its worker lived to tell.

    Args:
        result: What its function returned.
        error: Kind and text of what it raised instead; empty where it returned.
        stopped: Whether it came to a stop before its end, so that it can go on.
        held: Whether another process holds the folder of its run.
    """

    result: Any = None
    error: str = ""
    stopped: bool = False
    held: bool = False


class Job(NamedTuple):
    """A function and its arguments, packed for any machine, and what it needs there.

    Args:
        payload: The pickled function and arguments. Modules of the user's own travel inside.
        threads: Cores.
        device: `cpu`, or a kind of accelerator.
    """

    payload: bytes
    threads: int = 1
    device: str = "cpu"

    def run(self) -> Outcome:
        """Do it, whatever comes: only the death of the worker is left for an engine to tell."""
        try:
            function, arguments = pickle.loads(self.payload)
            return Outcome(function(*arguments))
        except (Exception, SystemExit) as error:  # also code of the user's that calls sys.exit
            return Outcome(
                error=f"{type(error).__name__}: {error}",
                stopped=isinstance(error, RunStoppedError),
                held=isinstance(error, LeaseError),
            )


def make_job(
    function: Callable[..., Any], *arguments: Any, threads: int = 1, device: str = "cpu"
) -> Job:
    """Pack a function and its arguments."""
    return Job(cloudpickle.dumps((function, arguments)), threads, device)


class Engine(ABC):
    """Where jobs are computed: a context, which leaves nothing running behind it.

    The future of a job ends with its `Outcome`, or with an error where its worker died.
    """

    def capacity(self, job: Job) -> int | None:
        """How many such jobs are computed at a time; `None` where the engine keeps the queue."""
        return None

    @abstractmethod
    def submit(self, jobs: Sequence[Job]) -> list[Future[Outcome]]:
        """Take jobs, in this order, and give a future for each."""

    @abstractmethod
    def close(self) -> None:
        """Tell jobs that still run to stop, forget those that wait, and free what was taken."""

    def __enter__(self) -> "Engine":
        """The engine itself."""
        return self

    def __exit__(self, *raised: object) -> None:
        """Close, however the block ends."""
        self.close()
