"""Spaces of a task as a run writes them down, for whoever acts in it later, without gymnasium."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deep_curiosity.replay import as_float32

SPACES = "spaces.json"
ACHIEVED_GOAL, DESIRED_GOAL = "achieved_goal", "desired_goal"
"""Keys of the goals in a dictionary of observations."""


class Entry(NamedTuple):
    """An entry of a dictionary or tuple of observations."""

    path: tuple[str | int, ...]
    """Its key, or the keys and places that lead to it through dictionaries and tuples."""
    shape: tuple[int, ...]
    choices: tuple[int, ...] = ()
    """Of each number of an entry that holds choices, how many there are: it becomes as many zeros
    and ones; none for an entry of measured numbers."""
    starts: tuple[int, ...] = ()
    """Of each, the first of its choices."""

    @property
    def size(self) -> int:
        """Length of its part of the vector."""
        return sum(self.choices) if self.choices else math.prod(self.shape)


@dataclass(frozen=True)
class TaskSpaces:
    """What a task shows and takes, in units of its own."""

    observation_dim: int
    """Length of one observation, as a vector."""
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    action_dtype: str
    entries: tuple[Entry, ...] = ()
    """Of a dictionary or tuple of observations, in their order in the vector; none where it is an
    array."""

    def places(self, key: str) -> tuple[int, ...]:
        """Places in the vector of what a dictionary of observations has under a key."""
        sizes = [entry.size for entry in self.entries]
        return tuple(
            place
            for entry, size, end in zip(self.entries, sizes, accumulate(sizes), strict=True)
            if entry.path[0] == key
            for place in range(end - size, end)
        )

    def to_json(self) -> dict[str, Any]:
        """As JSON knows it."""
        return asdict(self) | {"entries": [entry._asdict() for entry in self.entries]}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "TaskSpaces":
        """Read what `to_json` gave."""
        entries = tuple(
            Entry(
                tuple(entry["path"]),
                tuple(entry["shape"]),
                tuple(entry.get("choices", ())),
                tuple(entry.get("starts", ())),
            )
            for entry in values["entries"]
        )
        low, high = tuple(values["action_low"]), tuple(values["action_high"])
        return cls(values["observation_dim"], low, high, values["action_dtype"], entries)

    def to_task(self, action: NDArray[np.floating]) -> NDArray[Any]:
        """Actions in [-1, 1] in units of the task, `(*batch, action_dim)`."""
        low, high = np.array(self.action_low), np.array(self.action_high)
        scaled = low + (high - low) * (action.astype(np.float64) + 1) / 2
        return np.clip(scaled, low, high).astype(self.action_dtype)

    def from_task(self, action: Any) -> NDArray[np.float32]:
        """Actions in units of the task in [-1, 1], cut where they are beyond its bounds."""
        low, high = np.array(self.action_low), np.array(self.action_high)
        scaled = 2 * (np.asarray(action, dtype=np.float64) - low) / (high - low) - 1
        return np.clip(scaled, -1, 1).astype(np.float32)

    def to_vector(self, observation: Any) -> NDArray[np.float32]:
        """An observation, or a batch of them, as vectors: dictionaries entry behind entry.

        Raises:
            TypeError: If it is not of real numbers.
            ValueError: If it is a dictionary and the task's are none, or it lacks an entry, or has
                not as many rows in every one.
        """
        is_tuple = isinstance(observation, tuple) and bool(self.entries)
        if not (isinstance(observation, Mapping) or is_tuple):
            return as_float32("observation", observation)
        if not self.entries:
            raise ValueError(
                "`observation` must be an array for a task whose observations are no dictionaries "
                f"of arrays, got a dictionary of {sorted(observation, key=str)}."
            )
        vectors = [_vector(observation, entry) for entry in self.entries]
        batches = [vector.shape[:-1] for vector in vectors]
        if len({*batches}) > 1:
            raise ValueError(
                f"`observation` must have the same batch in all its entries, got {batches}."
            )
        return np.concatenate(vectors, axis=-1)


def read_spaces(folder: Path) -> TaskSpaces | None:
    """Spaces of the run in a folder; `None` for a run that did not write them down.

    Raises:
        ValueError: If the file is damaged.
    """
    path = folder / SPACES
    if not path.exists():
        return None
    try:
        return TaskSpaces.from_json(json.loads(path.read_text()))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"`{SPACES}` must hold spaces in JSON, got {path}: {error}.") from error


def check_same_task(spaces: TaskSpaces, folder: Path) -> None:
    """Refuse a task whose vectors are not those of the run in a folder, where these are known.

    Raises:
        ValueError: If observations have another length, or actions another box or dtype.
    """
    own = read_spaces(folder)
    if own is None:
        return
    for name in ("observation_dim", "action_low", "action_high", "action_dtype"):
        had, has = getattr(own, name), getattr(spaces, name)
        if had != has:
            raise ValueError(
                f"`env_id` must name the task of the run in {folder}, whose {name} is {had}, "
                f"got one whose {name} is {has}."
            )


def _vector(observation: Any, entry: Entry) -> NDArray[np.float32]:
    """An entry of a dictionary, flattened behind the batch."""
    value, name = observation, ".".join(map(str, entry.path))
    for key in entry.path:
        try:
            value = value[key]
        except (IndexError, KeyError, TypeError) as error:
            has_keys = isinstance(observation, Mapping)
            there = sorted(observation, key=str) if has_keys else observation
            raise ValueError(
                f"`observation` must have the entry {name!r}, got {there}."
            ) from error
    array = as_float32(f"observation[{name!r}]", value)
    batch = array.shape[: array.ndim - len(entry.shape)]
    if array.shape != (*batch, *entry.shape):
        raise ValueError(
            f"`observation` must have the shape {entry.shape} in its entry {name!r}, "
            f"got {array.shape}."
        )
    flat = array.reshape(*batch, math.prod(entry.shape))
    if not entry.choices:
        return flat
    chosen = [
        flat[..., place, None] == np.arange(start, start + number)
        for place, (number, start) in enumerate(zip(entry.choices, entry.starts, strict=True))
    ]
    if not all(one.any(-1).all() for one in chosen):
        raise ValueError(
            f"`observation` must have one of the choices in its entry {name!r}, got {value}."
        )
    return np.concatenate(chosen, axis=-1).astype(np.float32)
