"""What a run leaves behind: settings, TensorBoard events, progress.csv, summary.json."""

import csv
import io
import json
import os
import secrets
import shutil
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any

from deep_curiosity.training.checkpoint import NEWEST, PREVIOUS
from deep_curiosity.training.config import Config, with_younger
from deep_curiosity.training.spaces import SPACES

CONFIG = "config.json"
PROGRESS = "progress.csv"
SUMMARY = "summary.json"
WEIGHTS = "policy.safetensors"  # of an exported policy, which is no run
WRITTEN = (CONFIG, SPACES, PROGRESS, SUMMARY, NEWEST, PREVIOUS, "run.png")
"""All that a run writes over, but for files with names of their own."""
ORPHAN_SECONDS = 3_600.0  # since the last byte: no file of ours takes as long from one to the next


def make_folder(folder: Path) -> None:
    """Make the folder of a run, and those above it.

    Raises:
        OSError: If a file is in its place, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            f"`out` must name a folder that is there or can be made, got {folder}: "
            f"{error.strerror}."
        ) from error


def open_folder(config: Config, folder: Path | None = None) -> Path:
    """Folder of the run, with its settings written; a folder that holds a run is left alone.

    Args:
        config: Settings of the run.
        folder: What its `out` names, where that could be another folder meanwhile.

    Raises:
        FileExistsError: If the folder already holds a run, or files that it would write over.
        OSError: If a file is in its place, or it cannot be made.
    """
    folder = config.run.out if folder is None else folder
    make_folder(folder)
    check_unused(folder)
    write_json(folder / CONFIG, config.to_json())
    return folder


def run_folders(path: Path) -> list[Path]:
    """Folders with settings below a path, in their order; links are followed."""
    found, been = [], set()
    for name, below, names in os.walk(path, followlinks=True):
        folder = Path(name)
        if folder.resolve() in been:  # a link leads back
            below.clear()
            continue
        been.add(folder.resolve())
        below.sort()  # so that of several ways the same one is taken again
        if CONFIG in names:
            found.append(folder)
    return sorted(found)


def check_unused(folder: Path) -> None:
    """Refuse a folder that holds a run, or files that a run would write over.

    Raises:
        FileExistsError: If it does, naming the files.
    """
    if (folder / CONFIG).exists():
        raise FileExistsError(
            f"`out` must not hold a run already, got {folder}; continue it with "
            f"--resume {folder}, in Python by continue_run, or choose another folder."
        )
    if there := [name for name in WRITTEN if (folder / name).exists()]:
        raise FileExistsError(
            f"`out` must hold no file that a run would write over, got {folder}, which holds "
            f"{', '.join(there)}; choose another folder."
        )


def read_config(folder: Path, name: str = "folder") -> Config:
    """Settings of the run in a folder; arguments as of `read_values`.

    Raises:
        FileNotFoundError: If the folder holds no run.
        ValueError: If they are none, naming the file and the setting; or of an exported policy.
    """
    if (folder / WEIGHTS).exists():
        raise ValueError(
            f"`{name}` must be the folder of a run, got {folder}, which is an exported policy: "
            "deep_curiosity.load takes it."
        )
    values = read_values(folder, name)
    return Config.from_json(values | {"out": str(folder)}, source=str(folder / CONFIG))


def read_values(folder: Path, name: str = "folder") -> dict[str, Any]:
    """Settings of the run in a folder, as they are written; younger ones as if they were.

    Args:
        folder: Of the run.
        name: Of the argument that was given the folder, for errors.

    Raises:
        FileNotFoundError: If the folder holds no run.
        ValueError: If the file does not hold settings by their names.
    """
    path = folder / CONFIG
    if not path.exists():
        raise FileNotFoundError(
            f"`{name}` must be the folder of a run, which has a {CONFIG}, got {folder}."
        )
    try:
        values = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=once_each)
        if not isinstance(values, dict):
            raise ValueError(f"not by name: {values!r}")
    except (RecursionError, ValueError) as error:  # no text, no JSON
        raise ValueError(f"`{CONFIG}` must hold settings in JSON, got {path}: {error}.") from error
    return with_younger(values)


def once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The entries of an object in JSON, each of which may be there once.

    Raises:
        ValueError: If one is there twice.
    """
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError(f"a name twice among {', '.join(name for name, _ in pairs)}")
    return values


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write whole or not at all."""
    write_text(path, json.dumps(values, indent=2, default=str) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write beside a file, then rename: what was there stands until the new is whole.

    Raises:
        OSError: If the disk is full or cannot be written; what was there is untouched.
    """
    with written_whole(path) as partial, partial.open("w", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def written_whole(path: Path, *, mark: str | None = None) -> Iterator[Path]:
    """Path beside a file or folder of what takes its place once it is written whole.

    Several processes may write one file: that of the last stands.

    Args:
        path: That is wanted.
        mark: In the name of what is being written, between stem and suffix; by default one that
            no other writer has, and what a process that was killed has left is removed.
    """
    if mark is None:
        _remove_orphans(path)
        mark = f"{secrets.token_hex(4)}.partial"
    partial = path.with_name(f"{path.stem}.{mark}{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    except BaseException:
        if partial.is_dir():
            shutil.rmtree(partial)
        else:
            partial.unlink(missing_ok=True)
        raise


def _remove_orphans(path: Path) -> None:
    """Remove what processes that were killed have left of a file; a living one's is younger."""
    token = "[0-9a-f]" * 8
    for orphan in path.parent.glob(f"{escape(path.stem)}.{token}.partial{escape(path.suffix)}"):
        with suppress(OSError):  # another process has removed it
            if time.time() - orphan.stat().st_mtime > ORPHAN_SECONDS:
                orphan.unlink()


class Log:
    """Writes the numbers of a run, each under one tag, to TensorBoard and to progress.csv.

    Args:
        folder: Of the run.
        resumed_at: Step the run continues from; what TensorBoard has behind it is dropped.
        progress: What progress.csv held at that step; rows written after it are dropped, and
            a file that does not begin with it is mended, with a warning.
    """

    def __init__(self, folder: Path, *, resumed_at: int | None = None, progress: str = "") -> None:
        self._path = folder / PROGRESS
        self.progress = progress
        """Content of progress.csv."""
        self._columns = progress.partition("\r\n")[0].split(",") if progress else []
        self._restore()
        from torch.utils.tensorboard import SummaryWriter

        purge_step = None if resumed_at is None else resumed_at + 1
        self._writer = SummaryWriter(str(folder), purge_step=purge_step)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write to TensorBoard."""
        for tag, value in values.items():
            self._writer.add_scalar(tag, value, step)

    def row(self, step: int, values: Mapping[str, float]) -> None:
        """Append a row to progress.csv; the first one names the columns."""
        text = ""
        if not self._columns:
            self._columns = ["step", *values]
            text = _csv_line(self._columns)
        text += _csv_line([step, *(values.get(name) for name in self._columns[1:])])
        with self._path.open("a", newline="") as file:
            file.write(text)
        self.progress += text

    def close(self) -> None:
        """Flush what TensorBoard holds back."""
        self._writer.close()

    def _restore(self) -> None:
        """Bring progress.csv to where the run continues; keep one that is damaged beside it."""
        there = self._path.read_bytes() if self._path.exists() else b""
        wanted = self.progress.encode()
        if there == wanted:
            self._path.touch()
            return
        if not there.startswith(wanted):
            kept = self._path.with_name(f"{PROGRESS}.damaged")
            if there:
                self._path.replace(kept)
            warnings.warn(
                f"{self._path} was {'damaged' if there else 'missing'}; it is mended from the "
                f"checkpoint{f', and what was there is in {kept}' if there else ''}.",
                stacklevel=2,
            )
        write_text(self._path, self.progress)


def _csv_line(values: Sequence[Any]) -> str:
    line = io.StringIO()
    csv.writer(line).writerow(values)
    return line.getvalue()


def read_progress(folder: Path) -> list[dict[str, str]]:
    """Rows of progress.csv, as written.

    Raises:
        ValueError: If the file is damaged, naming it and the row.
    """
    path = folder / PROGRESS
    if not path.exists():
        return []
    return parse_progress(path.read_text(errors="replace"), source=str(path))


def parse_progress(text: str, *, source: str) -> list[dict[str, str]]:
    """Rows of a text like that of progress.csv.

    Raises:
        ValueError: If a row is not as long as the first, or is no row of numbers.
    """
    rows = list(_rows(text))
    for number, row in enumerate(rows, 2):
        if not _is_whole(row):
            raise ValueError(
                f"a row must have a number in every column, got row {number} of {source}, which "
                "is damaged; --resume mends it from the checkpoint."
            )
    return rows


def progress_up_to(folder: Path, step: int) -> str:
    """Whole rows of progress.csv up to a step, below its header; damaged ones are left out."""
    path = folder / PROGRESS
    lines = path.read_text(errors="replace").splitlines() if path.exists() else []
    rows = zip(lines[1:], _rows("\n".join(lines)), strict=False)
    kept = [line for line, row in rows if _is_whole(row) and float(row["step"]) <= step]
    return "".join(f"{line}\r\n" for line in [*lines[:1], *kept]) if kept else ""


def _rows(text: str) -> csv.DictReader:
    return csv.DictReader(io.StringIO(text.replace("\0", "?"), newline=""))


def _is_whole(row: Mapping[str | None, Any]) -> bool:
    try:
        [float(value or "nan") for value in row.values()]
        return None not in row and None not in row.values() and float(row["step"]) >= 0
    except (TypeError, ValueError, KeyError):
        return False
