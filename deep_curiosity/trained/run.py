"""Training in one call, and the run that it leaves, with all that was learned."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from deep_curiosity.bonuses.frozen import FrozenBonus
from deep_curiosity.configuration import as_path
from deep_curiosity.schedules import Schedule
from deep_curiosity.trained.model import TrainedModel, load_bonus, load_model
from deep_curiosity.trained.policy import TrainedPolicy, load
from deep_curiosity.training.callbacks import Callback
from deep_curiosity.training.config import Config
from deep_curiosity.training.hunger import HungerFunction


@dataclass(frozen=True)
class TrainedRun:
    """A run that has ended, or was interrupted."""

    folder: Path
    """Its records: settings, progress, checkpoints, picture."""
    summary: dict[str, Any]
    """The figures by which runs are compared, as in its `summary.json`."""

    @cached_property
    def policy(self) -> TrainedPolicy:
        """Its policy, see `load`."""
        return load(self.folder)

    @cached_property
    def model(self) -> TrainedModel:
        """Its model of the next observation, see `load_model`."""
        return load_model(self.folder)

    @cached_property
    def bonus(self) -> FrozenBonus:
        """Its bonus, frozen, see `load_bonus`."""
        return load_bonus(self.folder)


def train(
    env: str | None = None,
    *,
    make_env: Callable[[], Any] | None = None,
    preset: str | None = None,
    hunger: Any = None,
    on_evaluation: Callback | None = None,
    on_log: Callback | None = None,
    show_progress: bool = True,
    **settings: Any,
) -> TrainedRun:
    """Train an agent, and give the run that it leaves in its folder `out`.

    Args:
        env: Task: its id, such as `"PendulumSwingup"`; by default as in `Config`.
        make_env: Makes an environment of your own, anew at every call, in the place of `env`.
        preset: How networks sample a batch: `"fast"`, the default, `"exact"` or `"paper"`.
        hunger: A setting as any other; or a function of observation and info, see
            `deep_curiosity.training.train`.
        on_evaluation: Function of step and values, called after each evaluation; the run stops
            where it returns True.
        on_log: The same for each row of progress.csv.
        show_progress: Show a bar with return, bonus in nats and steps per second.
        **settings: Of `Config`, by their flat names, such as `total_steps`, `out` or
            `bonus="rnd"`.

    Returns:
        The run: its folder, summary and policy, and its model and bonus where it has any.

    Raises:
        FileExistsError: If `out` already holds a run.
        ImportError: If what training needs is missing.
        TypeError: If there is no such setting, or a value has the wrong type.
        ValueError: If the environment or a setting is not one the agent can take.
    """
    from deep_curiosity.training.loop import train as train_agent

    is_function = callable(hunger) and not isinstance(hunger, Schedule)
    function: HungerFunction | None = hunger if is_function else None
    if hunger is not None and function is None:
        settings["hunger"] = hunger
    config = Config.of(preset, **settings, **_task(env, make_env, settings))
    summary = train_agent(
        config,
        hunger=function,
        make_env=make_env,
        on_evaluation=on_evaluation,
        on_log=on_log,
        show_progress=show_progress,
    )
    return TrainedRun(config.run.out.absolute(), summary)


def _task(
    env: str | None, make_env: Callable[[], Any] | None, settings: dict[str, Any]
) -> dict[str, Any]:
    """The task as a setting, where it is given as an argument of its own.

    Raises:
        ValueError: If it is given twice, be it the default.
    """
    if env is not None and "env_id" in settings:
        raise ValueError(f"`env` must be left out beside `env_id`, got {env!r}.")
    given = {} if env is None else {"env_id": env}
    named = given.get("env_id", settings.get("env_id"))
    if make_env is not None and named is not None:
        raise ValueError(f"`env_id` must be left out beside `make_env`, got {named!r}.")
    return given


def continue_run(
    folder: str | Path,
    *,
    total_steps: int | None = None,
    make_env: Callable[[], Any] | None = None,
    new_episode: bool = False,
    hunger: HungerFunction | None = None,
    on_evaluation: Callback | None = None,
    on_log: Callback | None = None,
    show_progress: bool = True,
    **settings: Any,
) -> TrainedRun:
    """Continue the run in a folder, in place.

    Args:
        folder: Of the run.
        total_steps: Environment steps, those already taken included; as before when `None`.
        make_env: The function that made its environment, if one did.
        new_episode: Go on with the next episode: for a task, such as a robot, that cannot repeat
            the one in progress.
        hunger: The function of observation and info that it was begun with, if it was.
        on_evaluation: As in `train`.
        on_log: As in `train`.
        show_progress: As in `train`.
        **settings: What else is to change, as in `deep_curiosity.training.continue_run`, such as
            `device`.

    Returns:
        The run, as `train` gives it.

    Raises:
        FileNotFoundError: If the folder holds no run.
        TypeError: If there is no such setting, or a value has the wrong type.
        ValueError: If the run cannot go on with a setting, naming it and both values.
    """
    from deep_curiosity.training.loop import continue_run as continue_agent

    summary = continue_agent(
        folder,
        total_steps=total_steps,
        hunger=hunger,
        make_env=make_env,
        new_episode=new_episode,
        on_evaluation=on_evaluation,
        on_log=on_log,
        show_progress=show_progress,
        **settings,
    )
    return TrainedRun(as_path("folder", folder).absolute(), summary)
