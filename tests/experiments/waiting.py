"""Waiting for what other processes do, so that a test which waits in vain fails."""

import time

PATIENCE = 120.0  # seconds


def wait_until(condition):
    ends = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < ends, "it took too long"
        time.sleep(0.05)
