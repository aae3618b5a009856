"""Checkpoints that survive a crash while they are written."""

import os
import warnings
from pathlib import Path
from typing import Any

import torch

NEWEST = "checkpoint.pt"
PREVIOUS = "checkpoint.previous.pt"


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write beside the newest checkpoint, then rename: the old one stands until the new is whole.

    Raises:
        OSError: If the disk is full or cannot be written; the checkpoints there are untouched.
    """
    partial = folder / f"{NEWEST}.partial"
    try:
        with partial.open("wb") as file:
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())
    except (OSError, RuntimeError) as error:  # torch reports a full disk as a RuntimeError
        partial.unlink(missing_ok=True)
        raise OSError(f"the checkpoint in {folder} could not be written: {error}") from error
    newest = folder / NEWEST
    if newest.exists():
        newest.replace(folder / PREVIOUS)
    partial.replace(newest)


def load_checkpoint(folder: Path) -> dict[str, Any]:
    """Read the newest checkpoint, or, with a warning, the one before it where that is damaged.

    Raises:
        FileNotFoundError: If the folder holds no readable checkpoint.
    """
    damage = []
    for name in (NEWEST, PREVIOUS):
        path = folder / name
        if not path.exists():
            continue
        try:
            state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
        except Exception as error:  # a truncated archive raises many kinds
            damage.append(f"{path} is damaged ({type(error).__name__})")
            continue
        if damage:
            warnings.warn(f"{damage[0]}; continuing from {path}.", stacklevel=2)
        return state
    raise FileNotFoundError(
        f"`resume` must name a folder with a readable checkpoint, got {folder}: "
        f"{'; '.join(damage) or 'it holds none'}."
    )
