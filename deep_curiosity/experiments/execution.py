"""Giving jobs to an engine, and those that were lost again, as long as they get further."""

import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import NamedTuple

from deep_curiosity.experiments.engines.base import Engine, Job, Outcome
from deep_curiosity.training.lease import STALE_AFTER

TICK = 1.0  # seconds from one look at the clock to the next
MOST_TRIES = 4  # of a job that gets no further
HELD_SECONDS = 20.0  # until a folder that another process holds is asked for again
HELD_TRIES = 3 + int(STALE_AFTER / HELD_SECONDS)  # until the lease of a dead one has run out


class Ended(NamedTuple):
    """A job that came to its end, well or not."""

    number: int
    outcome: Outcome


class _Attempts(NamedTuple):
    """How often a job was tried without getting further than a step."""

    step: int = -1
    tries: int = 0


class Execution:
    """Jobs on an engine, given out in order, as many at a time as it computes.

    A job whose worker died, or was told to stop, is given out again, before all others: the run
    behind it goes on from its checkpoint, and the last ones are not late. Where it gets no further
    it is given up; a job that raises is not tried again.

    Args:
        engine: Where they are computed.
        jobs: What is computed.
        step_of: From the number of a job to the step that its run has reached.
    """

    def __init__(self, engine: Engine, jobs: Sequence[Job], step_of: Callable[[int], int]) -> None:
        self._engine = engine
        self._jobs = jobs
        self._step_of = step_of
        self._waiting = deque(range(len(jobs)))
        self._delayed: list[tuple[float, int]] = []
        self._ended: SimpleQueue[tuple[int, Future[Outcome]]] = SimpleQueue()
        self._attempts = [_Attempts() for _ in jobs]
        self.running = 0
        """Jobs that the engine has at present."""

    def __iter__(self) -> Iterator[Ended | None]:
        """Every job as it ends, and nothing at every tick of the clock between."""
        while self._waiting or self._delayed or self.running:
            self._fill()
            try:
                number, future = self._ended.get(timeout=TICK)
            except Empty:
                yield None
                continue
            self.running -= 1
            outcome = _outcome_of(future)
            if not self._retry(number, outcome):
                yield Ended(number, outcome)

    def _fill(self) -> None:
        """Give the engine what it has room for."""
        due = [number for moment, number in self._delayed if moment <= time.monotonic()]
        self._delayed = [each for each in self._delayed if each[1] not in due]
        self._waiting.extendleft(due)
        room = len(self._waiting)
        if self._waiting:
            capacity = self._engine.capacity(self._jobs[self._waiting[0]])
            room = room if capacity is None else min(room, capacity - self.running)
        numbers = [self._waiting.popleft() for _ in range(room)]
        if numbers:
            self._submit(numbers)

    def _submit(self, numbers: Sequence[int]) -> None:
        self.running += len(numbers)
        futures = self._engine.submit([self._jobs[number] for number in numbers])
        for number, future in zip(numbers, futures, strict=True):
            future.add_done_callback(
                lambda ended, number=number: self._ended.put((number, ended))  # type: ignore[misc]
            )

    def _retry(self, number: int, outcome: Outcome) -> bool:
        """Whether a job is to be given out again, which is then seen to."""
        if not (outcome.stopped or outcome.held):
            return False
        step, before = self._step_of(number), self._attempts[number]
        tries = before.tries + 1 if step <= before.step else 1
        self._attempts[number] = _Attempts(step, tries)
        if tries >= (HELD_TRIES if outcome.held else MOST_TRIES):
            return False
        print(f"given out again at step {step}: {outcome.error}", file=sys.stderr, flush=True)
        if outcome.held:
            self._delayed.append((time.monotonic() + HELD_SECONDS, number))
        else:
            self._waiting.appendleft(number)
        return True


def _outcome_of(future: "Future[Outcome]") -> Outcome:
    """What a job says, or, where its worker cannot, that it was lost."""
    try:
        return future.result()
    except (Exception, SystemExit) as error:  # of an engine: its worker or its node died
        lines = str(error).strip().splitlines()  # Ray adds a page of its own state
        first = lines[0] if lines else ""
        return Outcome(error=f"{type(error).__name__}: {first}", stopped=True)
