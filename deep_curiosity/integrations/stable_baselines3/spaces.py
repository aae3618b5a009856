"""What a bonus can be given of an environment: vectors, and actions between -1 and 1."""

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

CPU = torch.device("cpu")


def observed_space(space: spaces.Space, key: str | None) -> spaces.Box:
    """Space of the observations that the bonus is given.

    Args:
        space: Of the environment.
        key: Entry of a dictionary space; `None` where there is no dictionary.

    Raises:
        ValueError: If the key is missing, unknown or out of place, or the observation no vector.
    """
    if isinstance(space, spaces.Dict):
        if key not in space.spaces:
            keys = ", ".join(repr(name) for name in space.spaces)
            raise ValueError(f"`observation_key` must be one of {keys}, got {key!r}.")
        space = space[key]
    elif key is not None:
        raise ValueError(
            f"`observation_key` is for dictionary observations, got {key!r} for {space}."
        )
    return _vectors("observation_space", space)


def bounded_space(space: spaces.Space) -> spaces.Box:
    """The action space, if its actions can be scaled to [-1, 1].

    Raises:
        ValueError: If the actions are no vectors of bounded real numbers, or the range of one is
            empty or wider than float32 holds.
    """
    box = _vectors("action_space", space)
    if not np.issubdtype(box.dtype, np.floating):
        raise ValueError(f"`action_space` must be of a floating dtype, got {space}.")
    if not box.is_bounded():
        raise ValueError(f"`action_space` must be bounded, got {space}.")
    if not (box.low < box.high).all():
        raise ValueError(
            f"`action_space` must have `low` below `high` in every entry, got {space}."
        )
    with np.errstate(over="ignore"):
        width = box.high.astype(np.float32) - box.low.astype(np.float32)
    if not (np.isfinite(width) & (width > 0)).all():
        raise ValueError(
            f"`action_space` must have a finite and positive `high - low` in float32, got {space}."
        )
    return box


def scaled(action: np.ndarray, space: spaces.Box) -> np.ndarray:
    """Actions within the bounds of a space, brought to [-1, 1]."""
    dtype = np.promote_types(space.dtype, np.float32)  # narrower ones do not hold the width
    low, high = space.low.astype(dtype), space.high.astype(dtype)
    return (action - low) / (high - low) * 2.0 - 1.0


def batch_of(values: np.ndarray, device: torch.device = CPU) -> Tensor:
    """A copy of an array in the precision of the networks."""
    return torch.tensor(values, dtype=torch.float32, device=device)


def mask_of(flags: np.ndarray, device: torch.device = CPU) -> Tensor:
    """A copy of an array of flags, which the library stores as zeros and ones."""
    return torch.tensor(flags, device=device).bool()


def _vectors(name: str, space: spaces.Space) -> spaces.Box:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"`{name}` must be a Box of vectors (one axis), got {space}.")
    return space
