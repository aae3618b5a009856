"""What a search for settings is: tasks, the settings that vary, and how returns are compared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deep_curiosity.configuration import flat
from deep_curiosity.experiments.study import Task
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
            TypeError: If a setting is none of the tasks'.
            ValueError: If there is nothing to choose, or a task has no range.
        """
        if not self.space or not self.tasks:
            raise ValueError(
                "`space` and `tasks` must have an entry each, "
                f"got {len(self.space)} and {len(self.tasks)}."
            )
        for task in self.tasks:
            low, high = self.ranges.get(task.name, (0.0, 0.0))
            if not low < high:
                raise ValueError(
                    f"`ranges` must give two rising returns for {task.name}, got {low} and {high}."
                )
            if unknown := sorted(set(self.space) - set(flat(task.config))):
                raise TypeError(
                    f"`space` must hold settings of {task.name}, got {', '.join(unknown)}."
                )

    def identity(self) -> dict[str, Any]:
        """What makes the search the one it is, by name, as JSON takes it."""
        return {
            "tasks": {task.name: config_key(task.config.to_json()) for task in self.tasks},
            "space": {name: repr(values) for name, values in self.space.items()},
            "ranges": {task.name: self.ranges[task.name] for task in self.tasks},
            "seeds": [self.first_seed, self.seeds],
        }

    def normalise(self, task: str, value: float) -> float:
        """A return of a task on the scale of all."""
        low, high = self.ranges[task]
        return (value - low) / (high - low)


def check_out(out: Path) -> None:
    """Refuse to write over files that are none of a search's.

    Raises:
        FileExistsError: Naming them.
    """
    owner = "a search, which has a table of trials"
    check_outputs(out, ENDINGS, column="trial", owner=owner)
