"""Ctrl-C that waits for the end of the step, so that what is saved is whole."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interruption:
    """Whether the user has requested a stop."""

    def __init__(self) -> None:
        self.requested = False

    def request(self, signum: int, frame: FrameType | None) -> None:
        """Note the first Ctrl-C; a second one stops at once.

        Raises:
            KeyboardInterrupt: At the second request.
        """
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def catch_interruption() -> Iterator[Interruption]:
    """Turn Ctrl-C into a request inside the block; threads other than the main one keep theirs."""
    interruption = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    previous = signal.signal(signal.SIGINT, interruption.request)
    try:
        yield interruption
    finally:
        signal.signal(signal.SIGINT, previous)
