"""Ctrl-C and SIGTERM that wait for the end of the step, so that what is saved is whole."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(KeyboardInterrupt):
    """A call of an environment was cut off, since the user has requested a stop."""


class Interruption:
    """Whether the user, or the system, has requested a stop."""

    def __init__(self) -> None:
        self.requested = False
        self.by = signal.SIGINT.name
        """Signal that a request came by; those of other threads are as good as Ctrl-C."""
        self.at_once = False
        """Whether a request cuts off what is being done."""

    def request(self, signum: int, frame: FrameType | None) -> None:
        """Note the first request; a second Ctrl-C stops at once.

        Raises:
            Interrupted: Where a request cuts off what is being done.
            KeyboardInterrupt: At the second Ctrl-C; SIGTERM may come as often as it will.
        """
        if self.requested and signum == signal.SIGINT:
            raise KeyboardInterrupt
        self.requested, self.by = True, signal.Signals(signum).name
        if self.at_once:
            self.at_once = False
            raise Interrupted


_caught: list[Interruption] = []
"""Those of the blocks that the main thread is in."""
_of_threads: dict[int, Interruption] = {}
"""Those of other threads, which hear no signal, by the number of the thread."""


@contextmanager
def catch_interruption() -> Iterator[Interruption]:
    """Turn Ctrl-C and SIGTERM into a request inside the block.

    Threads other than the main one hear no signal; who started one may `interrupt_thread`.
    """
    if threading.current_thread() is not threading.main_thread():
        with interruptible_thread() as number:
            yield _of_threads.setdefault(number, Interruption())
        return
    interruption = Interruption()
    previous = [signal.signal(number, interruption.request) for number in SIGNALS]
    _caught.append(interruption)
    try:
        yield interruption
    finally:
        _caught.pop()
        for number, handler in zip(SIGNALS, previous, strict=True):
            signal.signal(number, handler or signal.SIG_DFL)


def is_interrupted() -> bool:
    """Whether a stop was requested of the block that the thread is in."""
    if threading.current_thread() is threading.main_thread():
        return bool(_caught) and _caught[-1].requested
    own = _of_threads.get(threading.get_ident())
    return own is not None and own.requested


@contextmanager
def interruptible_thread() -> Iterator[int]:
    """Give the number by which the thread can be interrupted until the end of the block."""
    number = threading.get_ident()
    try:
        yield number
    finally:
        _of_threads.pop(number, None)


def interrupt_thread(number: int) -> None:
    """Request a stop of what another thread does, or is about to do."""
    _of_threads.setdefault(number, Interruption()).requested = True


@contextmanager
def cut_off_at_once() -> Iterator[None]:
    """Let a request that is caught cut off what is done inside the block, or was made before it.

    Raises:
        Interrupted: If there is one.
    """
    if not _caught or threading.current_thread() is not threading.main_thread():
        yield
        return
    interruption = _caught[-1]
    interruption.at_once = True
    try:
        if interruption.requested:
            raise Interrupted
        yield
    finally:
        interruption.at_once = False


@contextmanager
def terminated_like_interrupted() -> Iterator[None]:
    """Let SIGTERM raise `KeyboardInterrupt` inside the block, as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
