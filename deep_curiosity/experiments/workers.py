"""Processes that run cells of a study, and end with the process that started them."""

import multiprocessing
import os
import signal
import threading
from multiprocessing.connection import wait

PATIENCE = 0.5
"""Seconds from one request to end to the next."""


def check_guarded(name: str) -> None:
    """Refuse to give jobs to processes from a script that each of them reads anew.

    Args:
        name: Of the function that is called there.

    Raises:
        RuntimeError: If this process is one of them, which reads it.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # as its own check asks
        raise RuntimeError(
            f"`{name}` must be called below `if __name__ == '__main__':` in a script, got a call "
            "by a worker that reads the script anew."
        )


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
