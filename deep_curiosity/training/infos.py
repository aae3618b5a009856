"""What several environments tell beside their observations: joined, and read entry by entry."""

from collections.abc import Mapping, Sequence
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deep_curiosity.training.interfaces import Info

NUMBERS = (np.ndarray, np.generic, bool, int, float)
"""Types of numbers, and of arrays of them."""


def joined(infos: Sequence[Info]) -> dict[str, Any]:
    """Infos of several environments as one, in which every entry has their axis in front.

    Numbers become an array of a type that holds them all, and so do arrays of numbers of one
    shape; where one is not told, NaN stands among real numbers and False among flags. All else
    becomes an array of objects, dictionaries among them, with `None` where one is not told. Who
    has told an entry `name`, an entry `_name` says.

    Example:
        >>> joined([{"charge": 1}, {"charge": 0.5}, {}])["charge"].tolist()
        [1.0, 0.5, nan]
    """
    entries: dict[str, Any] = {}
    masks: dict[str, Any] = {}
    for name in dict.fromkeys(name for info in infos for name in info):
        is_there = np.array([name in info for info in infos])
        entries[name] = _side_by_side([info.get(name) for info in infos], is_there)
        masks[f"_{name}"] = is_there
    return entries | masks


def after_reset(mask: NDArray[np.bool_], start: Info, before: Info) -> dict[str, Any]:
    """Infos that belong to the present observations, once some environments have begun anew.

    Args:
        mask: Which of them have.
        start: Infos of their reset.
        before: Infos of all environments before it.
    """
    present: dict[str, Any] = {}
    start, before = (
        {name: value for name, value in info.items() if np.shape(value)[:1] == mask.shape}
        for info in (start, before)
    )
    if mask.all():  # of which no mask need be kept
        return start
    for name in dict.fromkeys((*start, *before)):
        if _is_mask(name, start) or _is_mask(name, before):
            continue
        told = np.where(mask, is_told(start, name), is_told(before, name))
        if told.any():
            present[name] = _chosen(mask, start.get(name), before.get(name), told)
            present[f"_{name}"] = told
    return present


def is_told(info: Info, name: str) -> NDArray[np.bool_]:
    """Whether each environment tells an entry, `(num_envs,)`; `()` where that is true of all."""
    mask = info.get(f"_{name}")
    if name in info and isinstance(mask, np.ndarray) and mask.dtype == bool:
        return mask
    return np.array(name in info)


def _is_mask(name: str, info: Mapping[str, Any]) -> bool:
    return str(name).startswith("_") and name[1:] in info


def _chosen(mask: NDArray[np.bool_], new: Any, old: Any, told: NDArray[np.bool_]) -> Any:
    """The new values of an entry where the mask is, the old ones elsewhere."""
    kinds = {(np.shape(value), np.asarray(value).dtype) for value in (new, old)}
    if len(kinds) == 1 and np.asarray(new).dtype != object:
        return np.where(mask.reshape(-1, *[1] * (np.ndim(new) - 1)), new, old)
    values = [
        (new if is_new else old)[index] if told[index] else None
        for index, is_new in enumerate(mask)
    ]
    return _side_by_side(values, told)


def _side_by_side(values: Sequence[Any], told: NDArray[np.bool_]) -> NDArray[Any]:
    """Values of an entry, one for each environment; those that are not told may be anything."""
    given = list(compress(values, told))
    if set(map(type, given)) in ({float}, {int}, {bool}) and len(given) == len(values):
        return np.array(given)
    numbers = _one_array(given)
    if numbers is not None and len(given) == len(values):
        return numbers
    if numbers is not None and numbers.dtype.kind in "fb":
        blank = False if numbers.dtype.kind == "b" else np.nan
        full = np.full((len(values), *numbers.shape[1:]), blank, numbers.dtype)
        full[told] = numbers
        return full
    objects: NDArray[Any] = np.full(len(values), None, dtype=object)
    for index, value in enumerate(values):
        if told[index]:
            objects[index] = value.copy() if isinstance(value, np.ndarray) else value
    return objects


def _one_array(values: Sequence[Any]) -> NDArray[Any] | None:
    """Numbers, or arrays of them, in one array; `None` where they do not fit into one."""
    if not all(isinstance(value, NUMBERS) for value in values):
        return None
    arrays = [np.asarray(value) for value in values]
    fit = len({array.shape for array in arrays}) == 1
    return np.stack(arrays) if fit and all(a.dtype.kind in "biuf" for a in arrays) else None
