"""Processes that run cells of a study, and end with the process that started them."""

import multiprocessing
import os
import signal
import threading
from multiprocessing.connection import wait

PATIENCE = 0.5
"""Seconds from one request to end to the next."""


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
