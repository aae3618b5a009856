"""What happened in a run so far, kept in a form that a checkpoint can hold."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from deep_curiosity.training.collector import Episode
from deep_curiosity.training.infos import is_told
from deep_curiosity.training.interfaces import Info

EPISODE_LISTS = ("episodes", "evaluations")
NUM_RECENT = 10  # episodes over which returns and success are averaged


@dataclass
class RunLog:
    """Episodes, evaluations and visited cells, by step."""

    step: int = 0
    episodes: list[Episode] = field(default_factory=list)
    """Of training."""
    evaluations: list[Episode] = field(default_factory=list)
    """Of all evaluations, one after the other."""
    evaluation_step: int | None = None
    """Of the newest evaluation."""
    evaluation_size: int = NUM_RECENT
    """Episodes in the newest evaluation."""
    first_success_step: int | None = None
    cells: dict[int, int] = field(default_factory=dict)
    """Visited cell to the step at which it was first visited."""
    learning_steps: int = 0
    """Environment steps taken since learning has begun."""
    learning_seconds: float = 0.0
    """That they took, updates included."""
    wall_seconds: float = 0.0

    def on_step(self, info: Info) -> None:
        """Note what the infos of the environments say of the step just taken."""
        if self.first_success_step is None and any(_told(info, "is_success")):
            self.first_success_step = self.step
        for cell in _told(info, "cell"):
            # else the word means something else in this task
            if isinstance(cell, int | np.integer) and not isinstance(cell, bool):
                self.cells.setdefault(int(cell), self.step)

    def on_evaluated(self, episodes: Sequence[Episode]) -> None:
        """Note the episodes of an evaluation at the present step."""
        self.evaluations.extend(episodes)
        self.evaluation_step, self.evaluation_size = self.step, len(episodes)

    @property
    def latest_evaluation(self) -> list[Episode]:
        """Episodes of the newest evaluation, be it a scheduled one or the last of a run."""
        return self.evaluations[-self.evaluation_size :]

    @property
    def steps_per_second(self) -> float:
        """Environment steps per second, updates included, evaluation and start-up not."""
        return self.learning_steps / self.learning_seconds if self.learning_seconds else math.nan

    def coverage(self, num_cells: int | None) -> float | None:
        """Share of the task's cells visited in training, `None` where it has none."""
        return None if num_cells is None else len(self.cells) / num_cells

    @property
    def defines_success(self) -> bool:
        """Whether the task has spoken of success, which some tasks do at a success alone."""
        reported = (episode.success for episode in (*self.episodes, *self.evaluations))
        return not all(map(math.isnan, reported))

    @property
    def broken_episodes(self) -> int:
        """Episodes, of training and evaluation, in which the environment gave NaN or infinity."""
        return sum(episode.broken for episode in (*self.episodes, *self.evaluations))

    def summary(self, num_cells: int | None) -> dict[str, Any]:
        """The figures by which runs are compared."""
        evaluation = self.latest_evaluation
        return {
            "evaluation_return": mean_return(evaluation, num_recent=len(evaluation)),
            "evaluation_step": self.evaluation_step,
            "training_return": mean_return(self.episodes),
            "mean_training_return": mean_return(self.episodes, num_recent=len(self.episodes)),
            "success_rate": success_rate(
                evaluation, num_recent=len(evaluation), is_defined=self.defines_success
            ),
            "broken_episodes": self.broken_episodes,
            "first_success_step": self.first_success_step,
            "coverage": self.coverage(num_cells),
            "steps_per_second": _or_none(self.steps_per_second),
            "wall_seconds": self.wall_seconds,
        }

    def state_dict(self) -> dict[str, Any]:
        """Plain lists and numbers."""
        episodes = {name: [tuple(e) for e in getattr(self, name)] for name in EPISODE_LISTS}
        return asdict(self) | episodes

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> "RunLog":
        """Restore what `state_dict` gave."""
        episodes = {name: [Episode(*e) for e in state[name]] for name in EPISODE_LISTS}
        return cls(**state | episodes)


def mean_return(episodes: Sequence[Episode], num_recent: int = NUM_RECENT) -> float | None:
    """Mean return of the newest episodes, `None` without any; those that broke do not count."""
    returns = [episode.episode_return for episode in episodes[-num_recent:] if not episode.broken]
    return sum(returns) / len(returns) if returns else None


def success_rate(
    episodes: Sequence[Episode], num_recent: int = NUM_RECENT, *, is_defined: bool = False
) -> float | None:
    """Share of successes among the newest episodes, `None` where the task defines none.

    Args:
        episodes: In their order.
        num_recent: Episodes that count.
        is_defined: Whether the task is known to define success: an episode without a word of it
            then had none. So it is, too, where another of these episodes has a word of it.
    """
    successes = [episode.success for episode in episodes]
    if not successes or (not is_defined and all(map(math.isnan, successes))):
        return None
    return float(np.nan_to_num(successes[-num_recent:]).mean())


def _told(info: Info, name: str) -> list[Any]:
    """What the environments say under a name that say anything."""
    told = np.ravel(np.asarray(info.get(name, ()))[is_told(info, name)])
    if told.dtype != object:
        return told.tolist()
    of_each = (np.ravel(value) if isinstance(value, np.ndarray) else [value] for value in told)
    return [value for values in of_each for value in values]


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
