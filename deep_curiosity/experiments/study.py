"""What a study is: tasks, agents by the settings they change, and what is measured of each run."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any

from deep_curiosity.configuration import check_range
from deep_curiosity.experiments.runs import MEASURED, measure_run, run_own
from deep_curiosity.training.config import Config
from deep_curiosity.transitions import check_flags, is_whole_number

Row = dict[str, Any]
Agents = dict[str | float, dict[str, Any]]
"""Label of each agent to the settings that it changes."""
CHOSEN = ("out", "seed")
"""Settings that a study chooses for each of its runs."""
OF_ROWS = (
    "task",
    "seed",
    "step",
    "solved",
    "solved_step",
    "version",
    "commit",
    "settings",
    "area",
)
"""Columns of tables and curves, besides those that are measured of every run."""


@dataclass(frozen=True)
class Task:
    """A task of a study, and when it counts as solved.

    Args:
        name: In tables and figures.
        config: Settings of its runs, but for what an agent changes and the seed.
        solved_return: Evaluation return from which a run counts as solved; NaN where none does.
        is_shown_apart: Whether it is left out of what is said of all tasks together, such as a
            task on which the default was chosen.

    Raises:
        TypeError: If the name is no text, the settings are no Config, or the return is no number.
    """

    name: str
    config: Config
    solved_return: float = math.nan
    is_shown_apart: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no task, and a return that no other can be compared with."""
        if not isinstance(self.name, str):
            raise TypeError(f"`name` of a task must be text, got {self.name!r}.")
        if not isinstance(self.config, Config):
            raise TypeError(f"`config` of {self.name} must be a Config, got {self.config!r}.")
        value = self.solved_return
        if isinstance(value, bool) or not isinstance(value, Real):
            raise TypeError(
                f"`solved_return` of {self.name} must be a number, or NaN, got {value!r}."
            )


@dataclass(frozen=True)
class Study:
    """Tasks x agents x seeds.

    Args:
        tasks: What is to be learned.
        agents: Label of each agent, a name or the value of what is swept, to the settings that it
            changes, by their flat names.
        seeds: Number of seeds, the same ones for all, so that agents are paired.
        first_seed: The first of them; defaults are chosen on other seeds than are reported.
        label: What the labels of the agents say, such as `"agent"` or `"hunger"`.
        columns: What of the rows goes into summary and figure.
        measure: From the settings of a finished run and its summary to rows of the table.
        run: Sees to one cell; another library's agents have a function of their own.
        curves: Whether the figure shows learning curves instead of the columns.

    Raises:
        TypeError: If tasks or agents are none, an agent changes a setting that there is not, or
            gives it a wrong type; label or columns are no names, `measure` or `run` is no
            function, `curves` neither True nor False, or a count is no whole number.
        ValueError: If there is no task or agent, two have one name or one folder, a number is out
            of range, an agent's settings cannot be, or the label or columns are none.
    """

    tasks: Sequence[Task]
    agents: Agents
    seeds: int = 5
    first_seed: int = 0
    label: str = "agent"
    columns: Sequence[str] = ("evaluation_return", "mean_training_return", "first_success_step")
    measure: Callable[[Config, Row], list[Row]] = measure_run
    run: Callable[["Cell"], "Result"] = run_own
    curves: bool = False

    def __post_init__(self) -> None:
        """Refuse what could not be run, before anything is."""
        object.__setattr__(self, "tasks", as_tasks(self.tasks))
        check_seeds(self.seeds, self.first_seed)
        check_flags(curves=self.curves)
        self._check_functions()
        self._check_labels()
        tasks, agents = [task.name for task in self.tasks], [str(label) for label in self.agents]
        for name, known in (("tasks", tasks), ("agents", agents)):
            if not known or len(set(known)) < len(known):
                raise ValueError(f"`{name}` must have names, each of its own, got {known}.")
        check_folders(tasks, agents)
        self._check_columns()
        self._check_agents()
        if self.run is run_own:
            self._check_settings()

    @property
    def joint(self) -> "Study":
        """The study of the tasks of which something is said together; of all where none is."""
        tasks = [task for task in self.tasks if not task.is_shown_apart]
        return replace(self, tasks=tasks or self.tasks)

    def _check_functions(self) -> None:
        """Refuse what could not be called once there is a run."""
        for name in ("measure", "run"):
            if not callable(value := getattr(self, name)):
                raise TypeError(f"`{name}` must be a function, got {value!r}.")

    def _check_columns(self) -> None:
        """Refuse columns that are no names, and a label that is one of the rows' columns."""
        columns = self.columns
        if isinstance(columns, str) or not all(isinstance(name, str) for name in columns):
            raise TypeError(f"`columns` must be a sequence of names, got {columns!r}.")
        if not columns or len(set(columns)) < len(columns):
            raise ValueError(f"`columns` must have names, each of its own, got {columns!r}.")
        if not isinstance(self.label, str):
            raise TypeError(f"`label` must be text, got {self.label!r}.")
        if not self.label or self.label in (*OF_ROWS, *MEASURED, *columns):
            raise ValueError(f"`label` must be a name of no column, got {self.label!r}.")

    def _check_labels(self) -> None:
        """Refuse agents that have no labels, or labels by which they could not be told apart."""
        if not isinstance(self.agents, Mapping):
            raise TypeError(f"`agents` must be settings by label, got {self.agents!r}.")
        for label in self.agents:
            if not isinstance(label, str | Real):
                raise TypeError(f"`agents` must have names or numbers as labels, got {label!r}.")
            if label != label:
                raise ValueError(f"`agents` must have labels that equal themselves, got {label}.")

    def _check_agents(self) -> None:
        """Refuse agents without settings by name, and settings that the study chooses."""
        for label, settings in self.agents.items():
            if not isinstance(settings, Mapping):
                raise TypeError(f"agent {label!r} must have settings by name, got {settings!r}.")
            for name in CHOSEN:
                if name in settings:
                    raise ValueError(
                        f"agent {label!r}: `{name}` must be left to the study, which gives each "
                        f"run its own, got {settings[name]!r}."
                    )

    def _check_settings(self) -> None:
        """Refuse settings of an agent that its runs could not have."""
        for task in self.tasks:
            for label, settings in self.agents.items():
                try:
                    task.config.override(**settings)
                except (TypeError, ValueError) as error:
                    raise type(error)(f"agent {label!r} on {task.name}: {error}") from error


def as_tasks(tasks: Iterable[Task]) -> Sequence[Task]:
    """Tasks that can be gone through again and again, whatever gives them.

    Raises:
        TypeError: If they are none.
    """
    if not isinstance(tasks, Iterable):
        raise TypeError(f"`tasks` must be a sequence of tasks, got {tasks!r}.")
    tasks = tasks if isinstance(tasks, Sequence) else [*tasks]
    for task in tasks:
        if not isinstance(task, Task):
            raise TypeError(f"`tasks` must hold objects of Task, got {task!r}.")
    return tasks


def check_seeds(seeds: int, first_seed: int) -> None:
    """Refuse a number of seeds, or a first one, that cannot be.

    Raises:
        TypeError: If it is no whole number.
        ValueError: If it is out of range.
    """
    for name, number in (("seeds", seeds), ("first_seed", first_seed)):
        if not is_whole_number(number):
            raise TypeError(f"`{name}` must be a whole number, got {number!r}.")
    check_range("seeds", int(seeds), {"at_most": 10_000})
    check_range("first_seed", int(first_seed), {"at_least": 0})


def can_be_folder(name: Any) -> bool:
    """Whether a name is one of a folder below another."""
    if not isinstance(name, str) or not name or "\0" in name:
        return False
    return not Path(name).is_absolute() and ".." not in Path(name).parts


def check_folders(tasks: Sequence[str], agents: Sequence[str] = ("agent",)) -> None:
    """Refuse names by which a run would have no folder of its own below the study's.

    Raises:
        ValueError: Naming them.
    """
    for name in (*tasks, *agents):
        if not can_be_folder(name):
            raise ValueError(
                f"`tasks` and `agents` must have names that folders can have, got {name!r}."
            )
    folders = Counter(Path(task, agent) for task in tasks for agent in agents)
    if twice := [str(folder) for folder, count in folders.items() if count > 1]:
        raise ValueError(
            "`tasks` and `agents` must give each run a folder of its own, got "
            f"{', '.join(twice)} for several."
        )


@dataclass(frozen=True)
class Cell:
    """One run of a study."""

    study: Study
    task: Task
    agent: str | float
    seed: int
    folder: Path

    @property
    def config(self) -> Config:
        """Settings of the run, where our own trainer sees to it."""
        settings = self.study.agents[self.agent]
        return self.task.config.override(**settings, seed=self.seed, out=self.folder)

    @property
    def planned(self) -> Config:
        """Settings by which length and needs of the run are known, whoever sees to it."""
        return self.config if self.study.run is run_own else self.task.config


@dataclass(frozen=True)
class Result:
    """What a run gave.

    Args:
        rows: What was measured, mostly one row.
        curve: Evaluations, each with `step` and `evaluation_return`.
        origin: What made every row: version, commit, and settings that differ from the
            default.
    """

    rows: list[Row]
    curve: list[Row]
    origin: Row
