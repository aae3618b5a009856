"""What a caller is told of a run in progress: functions of step and values that may stop it."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Callback = Callable[[int, Mapping[str, float]], bool | None]
"""From the step and the values at it, by their tags, to whether the run is to stop. A value that
is not known, such as the success rate of a task that defines none, is NaN."""
CALLBACK = "callback"
"""What a run is said to be `stopped_by` where one of these asked to."""


def check_callbacks(**callbacks: Callback | None) -> None:
    """Refuse what cannot be called, by the names of the arguments, before a run begins.

    Raises:
        TypeError: If one is neither a function nor `None`.
    """
    for name, callback in callbacks.items():
        if callback is not None and not callable(callback):
            raise TypeError(
                f"`{name}` must be a function of step and values, or None, got {callback!r}."
            )


def call(
    callback: Callback | None, step: int, values: Mapping[str, float] | None, *, name: str
) -> bool:
    """Tell a callback, if there is news; whether it asks to stop.

    Args:
        callback: What is told.
        step: Of the news.
        values: The news.
        name: Of the argument that it was given by, for errors.

    Raises:
        TypeError: If it returns something else that counts as true: what a lambda happens to
            return, such as a number of characters written, is no wish to stop.
    """
    if callback is None or values is None:
        return False
    answer = callback(step, values)
    stops = _counts_as_true(answer)
    if stops and not isinstance(answer, bool | np.bool_):
        raise TypeError(
            f"`{name}` must return True to stop, or False or None to go on, got {answer!r}."
        )
    return stops


def _counts_as_true(answer: Any) -> bool:
    try:
        return bool(answer)
    except (RuntimeError, ValueError):  # an array or a tensor of several numbers
        return True


def stop_when_solved(solved_return: float) -> Callback:
    """Callback that stops a run at the first evaluation whose mean return reaches a number.

    Raises:
        ValueError: If the number is NaN, which no return reaches.
    """
    if math.isnan(solved_return):
        raise ValueError(f"`stop_when_solved` must be a number, got {solved_return}.")

    def is_solved(step: int, values: Mapping[str, float]) -> bool:
        return values["eval/return"] >= solved_return

    return is_solved


def in_turn(*callbacks: Callback | None) -> Callback:
    """Callback that tells several, all of them, and stops where one asks to."""

    def tell_all(step: int, values: Mapping[str, float]) -> bool:
        return any([call(callback, step, values, name="callbacks") for callback in callbacks])

    return tell_all
