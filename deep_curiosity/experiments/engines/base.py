"""What an engine is: it takes jobs, and gives a future for each, wherever they are computed."""

import pickle
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import ModuleType
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


class OwnModule(NamedTuple):
    """A file of the user's own, as it travels with jobs.

    Args:
        name: Of the module.
        path: Where it lies, perhaps on another machine.
        source: Its text.
    """

    name: str
    path: str
    source: str

    def load(self) -> None:
        """Make it the module of its name, so that what it registers is registered here too."""
        if self.name in sys.modules:
            return
        folder = str(Path(self.path).parent)
        if folder not in sys.path:
            sys.path.insert(0, folder)  # for what it imports itself
        module = ModuleType(self.name)
        module.__file__ = self.path
        sys.modules[self.name] = module
        try:
            exec(compile(self.source, self.path, "exec"), module.__dict__)
        except BaseException:
            del sys.modules[self.name]
            raise


_own_modules: dict[str, OwnModule] = {}


def send_along(module: ModuleType) -> None:
    """Let a module of the user's own travel with every job that is made from now on."""
    assert module.__file__ is not None
    path = Path(module.__file__).resolve()
    _own_modules[module.__name__] = OwnModule(module.__name__, str(path), path.read_text())
    cloudpickle.register_pickle_by_value(module)


class Job(NamedTuple):
    """A function and its arguments, packed for any machine, and what it needs there.

    Args:
        payload: The pickled function and arguments.
        threads: Cores.
        device: `cpu`, or a kind of accelerator.
        modules: Of the user's own, which are loaded before.
    """

    payload: bytes
    threads: int = 1
    device: str = "cpu"
    modules: tuple[OwnModule, ...] = ()

    def run(self) -> Outcome:
        """Do it, whatever comes: only the death of the worker is left for an engine to tell."""
        try:
            for module in self.modules:
                module.load()
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
    payload = cloudpickle.dumps((function, arguments))
    return Job(payload, threads, device, (*_own_modules.values(),))


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
