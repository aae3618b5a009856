"""What the tests of engines have computed: small functions that any worker can import."""

import os
import signal
import sys
import time
from pathlib import Path

from deep_curiosity.experiments.runs import RunStoppedError
from deep_curiosity.training.interruption import catch_interruption


def square(number: int) -> int:
    return number**2


def process(_: object = None) -> int:
    return os.getpid()


def fail(message: str) -> None:
    raise ArithmeticError(message)


def leave() -> None:
    sys.exit(0)


def interrupt() -> None:
    raise KeyboardInterrupt


def stop() -> None:
    raise RunStoppedError("stopped")


def die_once(folder: Path) -> int:
    """Kill the own process at the first call, and count in a file how often it was called."""
    calls = folder / "calls"
    number = len(calls.read_text()) if calls.exists() else 0
    calls.write_text("x" * (number + 1))
    if number == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return number + 1


def wait_until_told(folder: Path) -> str:
    """Wait for SIGTERM or an interruption, and note it."""
    told: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda signum, frame: told.append(signum))
    (folder / "begun").touch()
    while not told:
        time.sleep(0.05)
    (folder / "saved").touch()
    return "saved"


def meet_once_told(folder: Path, name: str, other: str) -> bool:
    """Wait for SIGTERM, and then for another process that is told as well; whether it was."""
    told: list[int] = []
    signal.signal(signal.SIGTERM, lambda signum, frame: told.append(signum))
    (folder / f"{name} begun").touch()
    while not told:
        time.sleep(0.05)
    (folder / name).touch()
    for _ in range(200):
        if (folder / other).exists():
            return True
        time.sleep(0.05)
    return False


def wait_until_interrupted() -> str:
    """Wait for a request to stop, as a run does."""
    with catch_interruption() as interruption:
        while not interruption.requested:
            time.sleep(0.05)
    return "stopped"
