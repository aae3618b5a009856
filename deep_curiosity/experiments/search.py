"""What a search for settings is: tasks, the settings that vary, and how returns are compared."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deep_curiosity.configuration import flat
from deep_curiosity.experiments.study import CHOSEN, Task, as_tasks, check_folders, check_seeds
from deep_curiosity.experiments.tables import check_outputs
from deep_curiosity.training.config import config_key

ENDINGS = (".json", ".csv", ".png")
"""Of the files that a search writes: best settings, table of trials, figure."""


@dataclass(frozen=True)
class Search:
    """Settings to choose for all tasks at once, by the score of tasks x seeds.

    Args:
        tasks: What is to be learned.
        space: Flat name of every setting that varies, to an `optuna.distributions` object.
        ranges: Name of each task to the returns that count as 0 and as 1, such as those of a
            uniformly random and of a good policy.
        seeds: Number of seeds of every trial on each task.
        first_seed: The first of them; what is found is reported on other ones.
    """

    tasks: Sequence[Task]
    space: Mapping[str, Any]
    ranges: Mapping[str, tuple[float, float]]
    seeds: int = 2
    first_seed: int = 1_000

    def __post_init__(self) -> None:
        """Check that every task can be scored, and every setting be set.

        Raises:
            TypeError: If a setting is none of the tasks', its values are no distribution, or a
                choice is neither text, a number, True, False nor None, as Optuna keeps no other;
                or tasks, space or ranges are none, or a count is no whole number.
            ValueError: If there is nothing to choose, a task has no range, or a setting cannot
                have a value that may be drawn, as far as that is known without all the others.
        """
        object.__setattr__(self, "tasks", as_tasks(self.tasks))
        for name in ("space", "ranges"):
            if not isinstance(getattr(self, name), Mapping):
                raise TypeError(
                    f"`{name}` must have entries by name, got {getattr(self, name)!r}."
                )
        if not self.space or not self.tasks:
            raise ValueError(
                "`space` and `tasks` must have an entry each, "
                f"got {len(self.space)} and {len(self.tasks)}."
            )
        check_seeds(self.seeds, self.first_seed)
        check_folders([task.name for task in self.tasks])
        if chosen := sorted(set(self.space) & set(CHOSEN)):
            raise ValueError(
                "`space` must leave to the search what it gives each run of its own, "
                f"got {', '.join(chosen)}."
            )
        for task in self.tasks:
            ends = self.ranges.get(task.name)
            if not _are_rising(ends):
                raise ValueError(
                    f"`ranges` must give two rising returns for {task.name}, got {ends!r}."
                )
            if unknown := sorted(set(self.space) - set(flat(task.config))):
                raise TypeError(
                    f"`space` must hold settings of {task.name}, got {', '.join(unknown)}."
                )
        self._check_space()

    def _check_space(self) -> None:
        """Refuse what is no distribution, or has an end that no run can have."""
        from optuna.distributions import BaseDistribution  # who has values to give has Optuna

        for name, values in self.space.items():
            if not isinstance(values, BaseDistribution):
                raise TypeError(
                    f"`space` must hold distributions of Optuna, got {values!r} for {name}."
                )
            for choice in getattr(values, "choices", ()):
                if not isinstance(choice, str | bool | int | float | None):
                    raise TypeError(
                        "`space` must hold choices that are text, numbers, True, False or None, "
                        f"got {choice!r} for {name}."
                    )
        for task in self.tasks:
            for name, values in self.space.items():
                for end in _ends(values):
                    self._check_end(task, name, end)

    def _check_end(self, task: Task, name: str, end: Any) -> None:
        """Refuse an end that a run can have neither alone nor with an end of another setting."""
        error = _refusal(task, {name: end})
        others = [
            {other: value}
            for other, values in self.space.items()
            if other != name
            for value in _ends(values)
        ]
        if error is not None and all(_refusal(task, {name: end} | each) for each in others):
            raise type(error)(
                f"`space` must hold what runs of {task.name} can have, got {name} {end!r}: {error}"
            ) from error

    def identity(self) -> dict[str, Any]:
        """What makes the search the one it is, by name, as JSON takes it."""
        return {
            "tasks": {task.name: config_key(task.config.to_json()) for task in self.tasks},
            "space": {name: repr(values) for name, values in self.space.items()},
            "ranges": {task.name: self.ranges[task.name] for task in self.tasks},
            "seeds": [int(self.first_seed), int(self.seeds)],
        }

    def normalise(self, task: str, value: float) -> float:
        """A return of a task on the scale of all."""
        low, high = self.ranges[task]
        return (value - low) / (high - low)


def _are_rising(ends: Any) -> bool:
    """Whether they are two numbers, the second above the first."""
    try:
        low, high = ends
        return bool(-math.inf < low < high < math.inf)
    except (TypeError, ValueError):  # not two, no numbers
        return False


def _ends(distribution: Any) -> Sequence[Any]:
    """Both ends of a distribution of numbers, or all choices."""
    choices: Sequence[Any] | None = getattr(distribution, "choices", None)
    return (distribution.low, distribution.high) if choices is None else choices


def _refusal(task: Task, values: Mapping[str, Any]) -> TypeError | ValueError | None:
    """Why no run of a task can have these settings; nothing where one can."""
    try:
        task.config.override(**values)
    except (TypeError, ValueError) as error:
        return error
    return None


def check_out(out: Path) -> None:
    """Refuse to write over files that are none of a search's.

    Raises:
        FileExistsError: Naming them.
    """
    owner = "a search, which has a table of trials"
    check_outputs(out, ENDINGS, column="trial", owner=owner)
