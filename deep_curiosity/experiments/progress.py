"""One live line for many runs: done, running and failed, steps per second of all, time left."""

import os
import time
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from deep_curiosity.experiments.study import Cell
from deep_curiosity.training.log import PROGRESS

LOOKING_SECONDS = 5.0  # from one look into the folders to the next
TAIL = 8_192  # bytes of progress.csv, more than its last row has


class Progress:
    """The line, on standard error, read from the folders of the runs, wherever these compute.

    Args:
        cells: The runs.
    """

    def __init__(self, cells: Sequence[Cell]) -> None:
        self._folders = [cell.folder for cell in cells]
        self._totals = [cell.planned.run.total_steps for cell in cells]
        self._open = set(range(len(cells)))
        self._steps = [self.step_of(number) for number in self._open]
        self._next = 0.0
        self._bar = tqdm(
            total=sum(self._totals), initial=sum(self._steps), unit=" steps", smoothing=0.0
        )

    def __enter__(self) -> "Progress":
        """The line itself."""
        return self

    def __exit__(self, *raised: object) -> None:
        """Leave the line as it is."""
        self._bar.close()

    def step_of(self, number: int) -> int:
        """Step that a run has written down last, at most its total."""
        return min(latest_step(self._folders[number]), self._totals[number])

    def end(self, number: int) -> None:
        """Count a run as ended, with all its steps."""
        self._open.discard(number)
        self._steps[number] = self._totals[number]

    def show(self, running: int, failed: int) -> None:
        """Renew the line, where it is time."""
        if time.monotonic() < self._next and self._open:
            return
        for number in self._open:
            self._steps[number] = self.step_of(number)
        count = len(self._totals)
        done = count - len(self._open) - failed
        text = f"{done} of {count} done, {running} running, {failed} failed"
        self._bar.set_description(text, refresh=False)
        self._bar.n = sum(self._steps)
        self._bar.refresh()
        self._next = time.monotonic() + LOOKING_SECONDS


def latest_step(folder: Path) -> int:
    """Step of the newest whole row of a run's progress.csv, zero without any."""
    try:
        with (folder / PROGRESS).open("rb") as file:
            end = file.seek(0, os.SEEK_END)
            file.seek(max(0, end - TAIL))
            lines = file.read().split(b"\n")[1:-1]  # the first is the header, or cut
    except OSError:
        return 0
    steps = [line.partition(b",")[0] for line in lines]
    return max((int(step) for step in steps if step.isdigit()), default=0)
