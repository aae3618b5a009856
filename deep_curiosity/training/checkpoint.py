"""Checkpoints that survive a crash while they are written, and tell when they are damaged."""

import hashlib
import os
import secrets
import warnings
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor, nn

from deep_curiosity.training.lease import LeaseError

NEWEST = "checkpoint.pt"
PREVIOUS = "checkpoint.previous.pt"
ASIDE = f"{NEWEST}.damaged"
DIGEST_MARK = b"sha256 of all before: "
DIGEST_LENGTH = 64  # hexadecimal digits, behind the mark, at the end of the file
CHUNK = 2**20


class DamagedError(ValueError):
    """A checkpoint is not what was written."""


class _Hashed:
    """A file whose content is hashed as it is written."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._hash = hashlib.sha256()
        self.error: OSError | None = None
        """Why something could not be written, which torch does not say."""

    def write(self, content: bytes | memoryview) -> int:
        """Write and hash."""
        self._hash.update(content)
        try:
            return self._file.write(content)
        except OSError as error:
            self.error = error
            raise

    def flush(self) -> None:
        """Flush, as torch asks for."""
        self._file.flush()

    def finish(self) -> None:
        """Write the digest, and see to it that all is on the disk."""
        self._file.write(DIGEST_MARK + self._hash.hexdigest().encode())
        self._file.flush()
        os.fsync(self._file.fileno())


def save_checkpoint(
    folder: Path, state: dict[str, Any], *, check: Callable[[], None] = lambda: None
) -> None:
    """Write beside the newest checkpoint, then rename: the old one stands until the new is whole.

    Args:
        folder: Receives it.
        state: What is kept.
        check: Asked once all is written whether it may take the place of what is there; raises
            where it may not.

    Raises:
        OSError: If the disk is full or cannot be written; the checkpoints there are untouched.
    """
    for orphan in folder.glob(f"{NEWEST}.*.partial"):  # of a process that was killed
        orphan.unlink(missing_ok=True)
    partial = folder / f"{NEWEST}.{secrets.token_hex(4)}.partial"
    hashed = None
    try:
        with partial.open("wb") as file:
            hashed = _Hashed(file)
            torch.save(state, hashed)  # type: ignore[arg-type]  # it writes and flushes alone
            hashed.finish()
        check()
    except (OSError, RuntimeError) as error:  # torch reports a full disk as a RuntimeError
        partial.unlink(missing_ok=True)
        if isinstance(error, LeaseError):
            raise
        reason = error if hashed is None or hashed.error is None else hashed.error
        raise OSError(f"the checkpoint in {folder} could not be written: {reason}") from error
    newest = folder / NEWEST
    with suppress(FileNotFoundError):
        newest.replace(folder / PREVIOUS)
    partial.replace(newest)
    sync_folder(folder)


def load_checkpoint(
    folder: Path, *, mend: bool = False, argument: str = "folder"
) -> dict[str, Any]:
    """Read the newest checkpoint, or, with a warning, the one before it where that is damaged.

    Args:
        folder: Of the run.
        mend: Put the one before in the place of a newest one that is damaged, so that it is not
            lost when the next is saved. The damaged one is put aside: what could not be read may
            be readable another time.
        argument: That named the folder, for errors.

    Raises:
        FileNotFoundError: If the folder holds no checkpoint, or none that is whole.
    """
    damage: list[str] = []
    for name in (NEWEST, PREVIOUS):
        path = folder / name
        try:
            state = _read(path)
        except FileNotFoundError:
            continue
        except (DamagedError, OSError) as error:
            damage.append(str(error))
            continue
        if damage:
            warnings.warn(f"{damage[0]}; continuing from {path}.", stacklevel=2)
            if mend:
                with suppress(FileNotFoundError):
                    (folder / NEWEST).replace(folder / ASIDE)
                path.replace(folder / NEWEST)
        return state
    raise FileNotFoundError(
        f"`{argument}` must name a folder with a readable checkpoint, got {folder}: "
        f"{'; '.join(damage) or 'it holds none'}."
    )


def load_weights(part: nn.Module, weights: Mapping[str, Tensor], folder: Path) -> None:
    """Give a part, of the sizes that settings say, the weights that were kept beside them.

    Args:
        part: Receives them.
        weights: Of the same part, as it was when they were written.
        folder: Of the run, for errors.

    Raises:
        ValueError: If they are of other sizes: the settings are no longer those of the run.
    """
    try:
        part.load_state_dict(weights)
    except RuntimeError as error:
        kind, *reasons = str(error).splitlines()  # one for every tensor
        raise ValueError(
            f"`config.json` in {folder} must hold the settings that the weights beside it were "
            f"learned with, got others: {(reasons or [kind])[0].strip()}"
        ) from None


def usual_observation_of(state: dict[str, Any]) -> Tensor | None:
    """Sizes that a run has found usual, `(observation_dim,)`; `None` where it is too old."""
    usual: Tensor | None = state["collector"].get("usual_observation")
    return usual


def has_checkpoint(folder: Path) -> bool:
    """Whether a folder holds a checkpoint, be it whole or damaged."""
    return any((folder / name).exists() for name in (NEWEST, PREVIOUS))


def sync_folder(folder: Path) -> None:
    """Have the system keep what was renamed in a folder, where it can be told to."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _read(path: Path) -> dict[str, Any]:
    """A checkpoint whose digest is right.

    Raises:
        DamagedError: If it is not, naming the file and what is wrong.
        FileNotFoundError: If there is none.
    """
    try:
        _check_digest(path)
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
        if not isinstance(state, dict):
            raise ValueError(f"it holds a {type(state).__name__} and no state of a run")
    except OSError:
        raise
    except Exception as error:  # a truncated archive raises many kinds
        raise DamagedError(f"{path} is damaged ({type(error).__name__}: {error})") from error
    return state


def _check_digest(path: Path) -> None:
    """Compare the digest at the end of a file with its content; without one, its entries' own."""
    length = path.stat().st_size - len(DIGEST_MARK) - DIGEST_LENGTH
    with path.open("rb") as file:
        file.seek(max(length, 0))
        mark, digest = file.read(len(DIGEST_MARK)), file.read()
        if mark != DIGEST_MARK:
            _check_entries(path)
            return
        file.seek(0)
        if _sha256(file, length) != digest.decode(errors="replace"):
            raise ValueError("its content does not have the checksum it was written with")


def _sha256(file: BinaryIO, length: int) -> str:
    digest = hashlib.sha256()
    while length > 0 and (chunk := file.read(min(length, CHUNK))):
        digest.update(chunk)
        length -= len(chunk)
    return digest.hexdigest()


def _check_entries(path: Path) -> None:
    """Compare every entry of an archive, written without a digest, with its own checksum."""
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
    if damaged is not None:
        raise ValueError(f"its entry {damaged} does not have the checksum it was written with")
