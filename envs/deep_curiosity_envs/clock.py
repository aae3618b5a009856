"""The clock that MuJoCo reads while it steps, and how to stop it."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


def _find_clock() -> ctypes.c_void_p | None:
    """MuJoCo's pointer to its clock, or None on a system that does not export it."""
    try:
        return ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._callbacks.__file__), "mjcb_time")
    except (AttributeError, OSError, ValueError):
        return None


_CLOCK = _find_clock()


@contextmanager
def clock_stopped() -> Iterator[None]:
    """Keep MuJoCo from reading the clock dozens of times in every physics step.

    MuJoCo's Python package times every stage for `MjData.timer`, which costs half of a small
    model's step, and has no switch for it; MuJoCo itself does so only where `mjcb_time` is set.
    """
    if _CLOCK is None:
        yield
        return
    clock, _CLOCK.value = _CLOCK.value, None
    try:
        yield
    finally:
        _CLOCK.value = clock
