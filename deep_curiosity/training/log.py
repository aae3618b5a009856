"""What a run leaves behind: settings, TensorBoard events, progress.csv, summary.json."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deep_curiosity.training.config import Config

CONFIG = "config.json"
PROGRESS = "progress.csv"
SUMMARY = "summary.json"


def open_folder(config: Config) -> Path:
    """Folder of the run, with its settings written; a folder that holds a run is left alone.

    Raises:
        FileExistsError: If the folder already holds a run.
    """
    folder = config.run.out
    if (folder / CONFIG).exists():
        raise FileExistsError(
            f"`out` must not hold a run already, got {folder}; continue it with "
            f"--resume {folder}, or choose another folder."
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / CONFIG, config.to_json())
    return folder


def read_config(folder: Path) -> Config:
    """Settings of the run in a folder.

    Raises:
        FileNotFoundError: If the folder holds no run.
        ValueError: If they are none, naming the file and the setting.
    """
    values = read_values(folder)
    return Config.from_json(values | {"out": str(folder)}, source=str(folder / CONFIG))


def read_values(folder: Path) -> dict[str, Any]:
    """Settings of the run in a folder, as they are written.

    Raises:
        FileNotFoundError: If the folder holds no run.
        ValueError: If the file does not hold settings by their names.
    """
    path = folder / CONFIG
    if not path.exists():
        raise FileNotFoundError(f"a run must have a {CONFIG}, got {folder}, which has none.")
    try:
        values = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_once_each)
        if not isinstance(values, dict):
            raise ValueError(f"not by name: {values!r}")
    except (RecursionError, ValueError) as error:  # no text, no JSON
        raise ValueError(f"`{CONFIG}` must hold settings in JSON, got {path}: {error}.") from error
    return values


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError(f"a name twice among {', '.join(name for name, _ in pairs)}")
    return values


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write whole or not at all."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(values, indent=2, default=str) + "\n")
    partial.replace(path)


class Log:
    """Writes the numbers of a run, each under one tag, to TensorBoard and to progress.csv.

    Args:
        folder: Of the run.
        start: Step the run continues from; rows written after it are dropped.
    """

    def __init__(self, folder: Path, *, start: int = 0) -> None:
        self._path = folder / PROGRESS
        self._rows = [row for row in read_progress(folder) if float(row["step"]) <= start]
        self._columns = list(self._rows[0]) if self._rows else []
        self._write_all()
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=start + 1 if start else None)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write to TensorBoard."""
        for tag, value in values.items():
            self._writer.add_scalar(tag, value, step)

    def row(self, step: int, values: Mapping[str, float]) -> None:
        """Append a row to progress.csv; the first one names the columns."""
        if not self._columns:
            self._columns = ["step", *values]
            self._write_all()
        with self._path.open("a", newline="") as file:
            csv.writer(file).writerow([step, *(values.get(name) for name in self._columns[1:])])

    def close(self) -> None:
        """Flush what TensorBoard holds back."""
        self._writer.close()

    def _write_all(self) -> None:
        with self._path.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(self._rows)


def read_progress(folder: Path) -> list[dict[str, str]]:
    """Rows of progress.csv, as written."""
    path = folder / PROGRESS
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
