"""Argument checks: each error names the argument, the rule and the value received."""

import numbers
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import is_dataclass
from functools import wraps
from inspect import Signature, signature
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, get_args, get_origin

import numpy as np
from jaxtyping import AbstractArray, Float

SUM_TOLERANCE = 1e-8  # sums of a thousand float64 probabilities stray by about 1e-13
ROUNDINGS = 10  # of each of the numbers that are summed, where these are less exact
LARGEST_LOG = 1e-6  # of a probability, which rounding may bring above one
MOST = 2**20  # of whatever is counted: a table of more has no place in memory
MAY_BE_INFINITE = ("log_", "score", "value", "divergence", "target")  # beginnings of names
DISTRIBUTIONS = (
    *("transition", "policy", "log_policy", "state_distribution", "start", "chain"),
    *("probability", "distribution", "channel"),
)
INFINITE_ANSWERS = ("kl_divergence", "curiosity", "curious_score")  # where nothing leads, say

Parameters = ParamSpec("Parameters")
Answer = TypeVar("Answer")
_is_inside: ContextVar[bool] = ContextVar("is_inside", default=False)


def checked(function: Callable[Parameters, Answer]) -> Callable[Parameters, Answer]:
    """Lets a function check its arguments by their annotations, and its answer.

    Numbers and arrays must be what they are annotated to be; axes of one name have one size; no
    array may hold NaN, nor infinity unless it is a logarithm or a score. An answer that is NaN is
    refused, and so is one that is infinite though all that was given is finite, unless it is a
    logarithm or a divergence. What one function calls inside another is not checked again.
    """
    known = signature(function)

    @wraps(function)
    def door(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Answer:
        if _is_inside.get():
            return function(*args, **kwargs)
        given = known.bind(*args, **kwargs).arguments
        check_arguments(known, given)
        token = _is_inside.set(True)
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                answer = function(*args, **kwargs)
        finally:
            _is_inside.reset(token)
        _check_answer(function.__name__, answer, given)
        return answer

    return door


def check_arguments(known: Signature, given: Mapping[str, Any]) -> None:
    """Raises unless arguments are what the annotations of a signature say."""
    sizes: dict[str, tuple[int, str]] = {}
    for name, value in given.items():
        if name != "self":
            _check_annotated(name, value, known.parameters[name].annotation, sizes)


def check_positive(name: str, value: float) -> None:
    """Raises unless `value` is positive and finite."""
    check_number(name, value)
    if not 0 < value < np.inf:
        raise ValueError(f"`{name}` must be positive and finite, got {value}.")


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raises unless `value` lies in the closed interval from `low` to `high`."""
    check_number(name, value)
    if not low <= value <= high:
        raise ValueError(f"`{name}` must lie in [{low}, {high}], got {value}.")


def check_at_least(name: str, value: int, least: int) -> None:
    """Raises unless the count `value` is a whole number, `least` or more."""
    check_whole(name, value)
    if value < least:
        raise ValueError(f"`{name}` must be at least {least}, got {value}.")
    if value > MOST:
        raise ValueError(f"`{name}` must be at most {MOST}, got {value}.")


def check_whole(name: str, value: Any) -> None:
    """Raises unless `value` is a whole number."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError(f"`{name}` must be a whole number, got {value!r}.")


def check_number(name: str, value: Any) -> None:
    """Raises unless `value` is a real number."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"`{name}` must be a number, got {value!r}.")
    if value != value:
        raise ValueError(f"`{name}` must be a number, got nan.")


def check_index(name: str, value: Any, size: int) -> None:
    """Raises unless `value` is the number of one of `size` states or actions, from 0."""
    check_whole(name, value)
    if not 0 <= value < size:
        raise ValueError(f"`{name}` must lie in [0, {size - 1}], got {value}.")


def check_fits(name: str, array: np.ndarray, other: np.ndarray) -> None:
    """Raises unless `array` can be broadcast against another."""
    try:
        np.broadcast_shapes(array.shape, other.shape)
    except ValueError as error:
        raise ValueError(
            f"`{name}` must fit the other argument, of shape {other.shape}, got {array.shape}."
        ) from error


def check_shape(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raises unless `array` has the given shape."""
    if array.shape != shape:
        raise ValueError(f"`{name}` must have shape {shape}, got {array.shape}.")


def check_finite(name: str, array: np.ndarray) -> None:
    """Raises unless every entry of `array` is finite."""
    if not np.isfinite(array).all():
        raise ValueError(f"`{name}` must be finite, got {array[~np.isfinite(array)][0]}.")


def check_not_negative(name: str, array: np.ndarray) -> None:
    """Raises if an entry of `array` is negative."""
    if array.min() < 0:
        raise ValueError(f"`{name}` must not be negative, got {array.min()}.")


def check_distribution(name: str, probability: Float[np.ndarray, "*batch outcomes"]) -> None:
    """Raises unless `probability` is non-negative and sums to one along its last axis."""
    check_finite(name, probability)
    if probability.size == 0:
        raise ValueError(f"`{name}` must have an outcome, got shape {probability.shape}.")
    check_not_negative(name, probability)
    total = probability.sum(-1)
    worst = total.flat[np.abs(total - 1).argmax()]
    precision = np.finfo(np.result_type(probability, np.float16)).eps  # of whole numbers too
    if abs(worst - 1) > max(SUM_TOLERANCE, ROUNDINGS * probability.shape[-1] * precision):
        raise ValueError(f"`{name}` must sum to 1 along its last axis, got {worst}.")


def fixed_copy(array: np.ndarray) -> np.ndarray:
    """A copy that cannot be written to: neither a caller nor a callee can change it later."""
    copied = array.copy()
    copied.setflags(write=False)
    return copied


def _check_annotated(
    name: str, value: Any, annotation: Any, sizes: dict[str, tuple[int, str]]
) -> None:
    """Raises unless a value is what its annotation says, as far as that can be told."""
    options = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    if value is None and NoneType in options:
        return
    arrays = [option for option in options if _is_array(option)]
    if float in options and (not arrays or not isinstance(value, np.ndarray)):
        check_number(name, value)
        if name != "rate" and not np.isfinite(value):  # no rate is no limit
            raise ValueError(f"`{name}` must be finite, got {value}.")
    elif int in options:
        check_whole(name, value)
    elif arrays:
        _check_array(name, value, arrays[0], sizes)
    elif get_origin(options[0]) is Callable or options[0] is Callable:
        if not callable(value):
            raise TypeError(f"`{name}` must be a function, got {value!r}.")
    else:
        kind = get_origin(options[0]) or options[0]
        if isinstance(kind, type) and not isinstance(value, kind):
            raise TypeError(f"`{name}` must be a {kind.__name__}, got {value!r}.")


def _is_array(option: Any) -> bool:
    return isinstance(option, type) and issubclass(option, AbstractArray)


def _check_array(
    name: str, value: Any, annotation: Any, sizes: dict[str, tuple[int, str]]
) -> None:
    axes = annotation.dim_str.split()
    if not isinstance(value, np.ndarray):
        raise TypeError(f"`{name}` must be an array of ({', '.join(axes)}), got {value!r}.")
    if value.dtype.name not in annotation.dtypes:
        kind = "truth values" if "bool" in annotation.dtypes else "real numbers"
        raise TypeError(f"`{name}` must be an array of {kind}, got {value.dtype}.")
    named = [axis for axis in axes if not axis.startswith("*")]
    if value.ndim < len(named) or (value.ndim > len(named) and len(named) == len(axes)):
        raise ValueError(f"`{name}` must have axes ({', '.join(axes)}), got {value.shape}.")
    if value.size == 0:
        raise ValueError(f"`{name}` must have no empty axis, got {value.shape}.")
    for axis, size in zip(named, value.shape[value.ndim - len(named) :], strict=True):
        expected, other = sizes.setdefault(axis, (size, name))
        if size != expected:
            raise ValueError(
                f"`{name}` must have {expected} {axis}, as `{other}` has, got shape {value.shape}."
            )
    _check_entries(name, value)


def _check_entries(name: str, value: np.ndarray) -> None:
    """Raises if an array holds what its name does not stand for."""
    if value.dtype == bool:
        return
    if not name.startswith(MAY_BE_INFINITE):
        check_finite(name, value)
    if np.isnan(value).any():
        raise ValueError(f"`{name}` must hold numbers, got nan.")
    if name in DISTRIBUTIONS:
        check_distribution(name, np.exp(value) if name.startswith("log_") else value)
    if name == "weight":
        check_not_negative(name, value)
    if name.startswith("log_") and name != "log_weight" and value.max() > LARGEST_LOG:
        raise ValueError(
            f"`{name}` must hold logs of probabilities, at most 0, got {value.max()}."
        )


def _check_answer(function: str, answer: Any, given: Mapping[str, Any]) -> None:
    """Raises if an answer is no number, naming the argument that is largest."""
    if isinstance(answer, tuple) or is_dataclass(answer):
        parts = answer if isinstance(answer, tuple) else vars(answer).values()
        for part in parts:  # a temperature may be infinite, and the log of a probability
            _check_answer(f"log {function}", part, given)
    if not isinstance(answer, float | np.ndarray) or np.asarray(answer).dtype.kind != "f":
        return
    sizes = {name: _largest(value) for name, value in given.items()}
    may_be_infinite = "log" in function or function in INFINITE_ANSWERS
    is_sound = not np.isnan(answer).any() and (
        may_be_infinite or np.isfinite(answer).all() or not np.isfinite([*sizes.values()]).all()
    )
    if not is_sound:
        name = max(sizes, key=lambda name: sizes[name])
        raise ValueError(
            f"`{name}` must leave {function} with a finite answer, got up to {sizes[name]:g}."
        )


def _largest(value: Any) -> float:
    """Largest size among the entries of an argument, 0 where it has none."""
    if not isinstance(value, numbers.Real | np.ndarray):
        return 0.0
    return float(np.abs(np.asarray(value, float)).max(initial=0.0))
