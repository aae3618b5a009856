"""Environments that the agent can act in: found by id, checked, brought to one form."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import math
import multiprocessing
import os
import signal
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from typing import Any
from weakref import WeakValueDictionary

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import (
    FilterObservation,
    FlattenObservation,
    RescaleAction,
    TimeLimit,
    TransformAction,
)

import deep_curiosity_envs
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.frame_stack import FrameStack, VectorFrameStack
from deep_curiosity.training.spaces import Entry, TaskSpaces
from deep_curiosity.training.wrappers import (
    ActionRepeat,
    AsyncEnvironments,
    PlainSteps,
    SyncEnvironments,
    VectorObservation,
)
from deep_curiosity.transitions import is_whole_number
from deep_curiosity_envs.ids import registered_id

GOAL_ENDS_EPISODE = frozenset(
    {"gymnasium.envs.classic_control.continuous_mountain_car:Continuous_MountainCarEnv"}
)
"""Classes of tasks that say nothing of success, but terminate at the goal and nowhere else."""
MAX_EPISODE_STEPS = 1_000
"""Steps after which an episode is cut off where neither the task nor the user limits it."""
MAX_ACTION = 1e9
"""Bounds of actions beyond this are no bounds."""
MADE_BY_FUNCTION = "make_env"
"""The `env_id` of a run whose environments the caller's own function makes."""

MakeEnv = Callable[[], gymnasium.Env]
"""Makes one environment of the caller's own, anew at every call."""


def make_environment(
    config: EnvironmentConfig,
    *,
    make_env: MakeEnv | None = None,
    render_mode: str | None = None,
) -> gymnasium.Env[np.ndarray, np.ndarray]:
    """Make an environment with vector observations and actions in [-1, 1].

    Observations that are dictionaries, goals among them, become vectors. Episodes end after
    `max_episode_steps`; where nothing limits them, after 1 000 steps, and a warning says so.

    Args:
        config: Its `env_id` is a registered one; `PendulumSwingup` is short for
            `deep_curiosity/PendulumSwingup-v0`; `module:Task-v0` imports the module first;
            `dm_control/DOMAIN-TASK-v0` needs the `dmc` extra and the tasks of gymnasium-robotics
            the `robotics` extra.
        make_env: The caller's own function, in the place of an id.
        render_mode: Passed on to a task with an id.

    Raises:
        ValueError: If the id is unknown, or the spaces are not continuous, bounded vectors.
        ImportError: If a task is wanted without its extra, or does not run with this MuJoCo.
    """
    return _make(config, _source(config, make_env), render_mode)


def make_vector_environment(
    config: EnvironmentConfig, *, make_env: MakeEnv | None = None
) -> VectorEnv[np.ndarray, np.ndarray, np.ndarray]:
    """Make several environments as `make_environment` does, without autoreset.

    Raises:
        ValueError: If a native environment is wanted where there is none, or `make_environment`
            raises it.
    """
    source = _source(config, make_env)
    environment = _make_vector(replace(config, frame_stack=1), source)
    if config.frame_stack == 1:
        return environment
    return VectorFrameStack(environment, config.frame_stack)


def _source(config: EnvironmentConfig, make_env: MakeEnv | None) -> EnvSpec | MakeEnv:
    """Where environments come from: handed to processes, which may know no id of this one.

    Raises:
        ValueError: If the function is missing, or an id is given beside it, or the id is unknown.
    """
    if make_env is None:
        if config.env_id == MADE_BY_FUNCTION:
            raise ValueError(
                "`make_env` must be given again, since a function of the caller made the "
                "environments of this run: it goes on by deep_curiosity.continue_run(folder, "
                "make_env=...) and acts by deep_curiosity.load(folder), got None."
            )
        return gymnasium.spec(registered_id(config.env_id))
    if config.env_id != MADE_BY_FUNCTION or config.env_kwargs:
        given = "env_kwargs" if config.env_kwargs else "env_id"
        raise ValueError(
            f"`{given}` must be left out beside `make_env`, got {getattr(config, given)!r}."
        )
    return make_env


def _make(
    config: EnvironmentConfig, source: EnvSpec | MakeEnv, render_mode: str | None = None
) -> gymnasium.Env:
    task, limit = _make_task(config, source, render_mode)
    innermost = type(task.unwrapped)  # its `spec` is that of the last one made around it
    environment: gymnasium.Env = PlainSteps(
        task,
        termination_is_success=f"{innermost.__module__}:{innermost.__name__}" in GOAL_ENDS_EPISODE,
        terminate_on_success=config.terminate_on_success,
    )
    if limit is not None:
        environment = TimeLimit(environment, limit)
    environment = _flattened(environment, config.observation_keys)
    check_spaces(environment.observation_space, environment.action_space)
    environment = VectorObservation(environment)
    if config.action_repeat > 1:
        environment = ActionRepeat(environment, config.action_repeat)
    box = environment.action_space
    assert isinstance(box, spaces.Box)
    environment = TransformAction(  # what rounding has put past an end of the box
        environment, lambda action: np.clip(action, box.low, box.high).astype(box.dtype), box
    )
    low, high = np.array([-1.0, 1.0], box.dtype)
    environment = RescaleAction(environment, low, high)
    return environment if config.frame_stack == 1 else FrameStack(environment, config.frame_stack)


def _make_task(
    config: EnvironmentConfig, source: EnvSpec | MakeEnv, render_mode: str | None
) -> tuple[gymnasium.Env, int | None]:
    """A task as its author left it, and the steps after which its episodes are to be cut off."""
    if not isinstance(source, EnvSpec):
        task = source()
        if not isinstance(task, gymnasium.Env):
            raise ValueError(f"`make_env` must return a gymnasium environment, got {task!r}.")
        return task, _limit(config, None, task)
    env_kwargs: dict[str, Any] = dict(config.env_kwargs)
    if render_mode is not None:
        env_kwargs["render_mode"] = render_mode
    try:
        # the limit comes later, since a limit can make nothing of a step that is none
        task = gymnasium.make(source, -1, disable_env_checker=True, **env_kwargs)
    except TypeError as error:
        raise ValueError(
            f"`env_kwargs` must be arguments of {source.id}, got {env_kwargs}: {error}"
        ) from error
    except AssertionError as error:
        raise _of_another_mujoco(source, error) from error
    return task, _limit(config, source, task)


def _limit(config: EnvironmentConfig, spec: EnvSpec | None, task: gymnasium.Env) -> int | None:
    """Steps after which episodes are to be cut off; `None` where the task sees to that itself."""
    within, wanted = _limit_within(task), config.max_episode_steps
    if wanted is not None:
        if within is not None and wanted > within:
            raise ValueError(
                f"`max_episode_steps` must be at most {within}, after which {config.env_id} cuts "
                f"its episodes off by itself, got {wanted}."
            )
        return wanted
    if spec is not None and spec.max_episode_steps is not None:
        return spec.max_episode_steps
    if within is not None or config.env_id.startswith("dm_control/"):
        return None
    warnings.warn(
        f"`max_episode_steps` should be set: nothing limits the episodes of {config.env_id}, and "
        f"they are cut off after {MAX_EPISODE_STEPS} steps.",
        stacklevel=2,
    )
    return MAX_EPISODE_STEPS


def _limit_within(task: gymnasium.Env) -> int | None:
    """Steps after which a wrapper or dm_control cuts episodes off; others may say anything.

    Of several limits, one around the other, the least is the one that does.
    """
    limits: list[float] = []
    while isinstance(task, gymnasium.Wrapper):
        if isinstance(task, TimeLimit):
            limits.append(task._max_episode_steps)
        task = task.env
    if type(task).__module__.startswith("shimmy."):
        limits.append(getattr(getattr(task, "_env", None), "_step_limit", math.inf))
    least = min(limits, default=math.inf)
    return round(least) if least < math.inf else None


class EnvironmentMaker:
    """A function that makes environments, checked to make another one at every call.

    Args:
        make_env: The function. Where this is pickled, it is all that is.

    Raises:
        TypeError: If it is no function, such as an environment.
    """

    def __init__(self, make_env: MakeEnv) -> None:
        if not callable(make_env):
            raise TypeError(
                f"`make_env` must be a function that makes an environment, got {make_env!r}."
            )
        self.make_env = make_env
        self._made: WeakValueDictionary[tuple[int, int], gymnasium.Env] = WeakValueDictionary()

    def __call__(self) -> gymnasium.Env:
        """Make one.

        Raises:
            ValueError: If it is one of before: two that step the same would tear each other's
                episodes.
        """
        task = self.make_env()
        own = getattr(task, "unwrapped", task)
        if not isinstance(own, gymnasium.Env):
            return task  # which is refused for what it is
        key = os.getpid(), id(own)
        if key in self._made:
            raise ValueError(
                "`make_env` must make a new environment at every call, got the same one twice: "
                f"{task}."
            )
        self._made[key] = own
        return task

    def __reduce__(self) -> tuple[type["EnvironmentMaker"], tuple[MakeEnv]]:
        return EnvironmentMaker, (self.make_env,)


def _of_another_mujoco(spec: EnvSpec, error: AssertionError) -> Exception:
    """What an assertion means that fails while a task is made."""
    if "gymnasium_robotics" not in str(spec.entry_point):
        return error
    return ImportError(
        f"`env_id` must be a task that runs with mujoco {version('mujoco')}, got {spec.id!r}: of "
        f"gymnasium-robotics {version('gymnasium-robotics')}, PointMaze, AntMaze and Adroit do; "
        "Fetch, Hand and FrankaKitchen want an older mujoco than the 3.17 of this package."
    )


def _flattened(environment: gymnasium.Env, keys: tuple[str, ...]) -> gymnasium.Env:
    """The entries of a dictionary side by side in one vector, in the order of its space.

    Raises:
        ValueError: If an entry is an image, there is none of a name, or it is no dictionary.
    """
    space = environment.observation_space
    if keys and not (isinstance(space, spaces.Dict) and set(keys) <= set(space)):
        known = list(space) if isinstance(space, spaces.Dict) else "none, it is no dictionary"
        raise ValueError(
            f"`observation_keys` must be entries of the observation ({known}), got {keys}."
        )
    if keys:
        environment = FilterObservation(environment, keys)
        space = environment.observation_space
    if not isinstance(space, spaces.Dict | spaces.Tuple):
        return environment
    _refuse_images(space)
    return FlattenObservation(environment)


def _refuse_images(space: spaces.Space) -> None:
    entries = space.values() if isinstance(space, spaces.Dict) else space
    assert isinstance(entries, Iterable)
    for entry in entries:
        if isinstance(entry, spaces.Dict | spaces.Tuple):
            _refuse_images(entry)
        elif isinstance(entry, spaces.Box) and len(entry.shape) > 1 and entry.dtype == np.uint8:
            raise ValueError(
                "`observation_space` must have no images, which need an encoder, got "
                f"{entry}; choose other entries by `observation_keys`."
            )


def _make_vector(
    config: EnvironmentConfig, source: EnvSpec | MakeEnv
) -> VectorEnv[np.ndarray, np.ndarray, np.ndarray]:
    """Step by one call of MuJoCo, one after another, or each in a process of its own."""
    if config.vectorization == "native":
        _check_native(config)
    if config.vectorization == "async":
        workers = [partial(_make_in_worker, config, source)] * config.num_envs
        return AsyncEnvironments(workers, autoreset_mode=AutoresetMode.DISABLED)
    if config.vectorization == "sync" or not _has_native(config):
        makers = [partial(_make, config, source)] * config.num_envs
        return SyncEnvironments(makers, autoreset_mode=AutoresetMode.DISABLED)
    assert isinstance(source, EnvSpec)
    env_kwargs: dict[str, Any] = dict(config.env_kwargs)
    if config.max_episode_steps is not None:
        env_kwargs["max_episode_steps"] = config.max_episode_steps
    try:
        return gymnasium.make_vec(
            source,
            config.num_envs,
            "vector_entry_point",
            autoreset_mode=AutoresetMode.DISABLED,
            **env_kwargs,
        )
    except TypeError as error:
        raise ValueError(
            f"`env_kwargs` must be arguments of {source.id}, got {config.env_kwargs}: {error}"
        ) from error


def _has_native(config: EnvironmentConfig) -> bool:
    """Whether MuJoCo steps all environments of a task in one call."""
    is_changed = config.terminate_on_success or config.action_repeat > 1
    if config.env_id == MADE_BY_FUNCTION or is_changed:
        return False
    return registered_id(config.env_id) in deep_curiosity_envs.TASK_IDS


def _check_native(config: EnvironmentConfig) -> None:
    if not _has_native(config):
        changed = " that end at success" if config.terminate_on_success else ""
        changed += " whose actions are repeated" if config.action_repeat > 1 else ""
        raise ValueError(
            f"`vectorization` must be 'auto', 'sync' or 'async' for {config.env_id}{changed}, got "
            f"'native', which is for {', '.join(deep_curiosity_envs.TASK_IDS)}, as they are."
        )


def check_spaces(observation_space: spaces.Space, action_space: spaces.Space) -> None:
    """Reject spaces that the agent cannot take.

    Raises:
        ValueError: Naming the space, the rule and the space received.
    """
    if not (_is_vector(action_space) and np.issubdtype(action_space.dtype, np.floating)):
        raise ValueError(
            "`action_space` must be a Box of continuous vectors of one entry or more, got "
            f"{action_space}."
        )
    assert isinstance(action_space, spaces.Box)
    size = np.maximum(np.abs(action_space.low), np.abs(action_space.high)).astype(float)
    if not (size <= MAX_ACTION).all():
        raise ValueError(
            f"`action_space` must be bounded on both sides, by at most {MAX_ACTION:g}, got "
            f"{action_space}."
        )
    if not (action_space.low < action_space.high).all():
        raise ValueError(
            f"`action_space` must have `low` below `high` in every entry, got {action_space}."
        )
    if not _is_vector(observation_space):
        raise ValueError(
            "`observation_space` must be a Box of vectors of one entry or more (dictionaries are "
            "flattened as by gymnasium.wrappers.FlattenObservation; images need an encoder), got "
            f"{observation_space}."
        )


def _is_vector(space: spaces.Space) -> bool:
    """Whether a space is a box of vectors with an entry at least."""
    return isinstance(space, spaces.Box) and len(space.shape) == 1 and space.shape[0] > 0


def num_cells(environment: gymnasium.Env) -> int | None:
    """Number of cells a task divides its space into, or `None` where it has none.

    What is no such number means something else in this task.
    """
    number: Any = getattr(environment.unwrapped, "num_cells", None)
    return int(number) if is_whole_number(number) and number > 0 else None


def picture_features(config: EnvironmentConfig) -> tuple[int, int]:
    """Two entries of the observation that say most when plotted against each other.

    Tasks name them in `metadata["picture_features"]`; otherwise the first and the last are taken.
    With a frame stack they are entries of its newest observation, the last of the stack.
    """
    environment = make_environment(replace(config, frame_stack=1))
    size = observation_dim(environment)
    before_newest = (config.frame_stack - 1) * (size + action_dim(environment))
    first, second = environment.metadata.get("picture_features", (0, size - 1))
    environment.close()
    return before_newest + first, before_newest + second


def observation_dim(environment: gymnasium.Env) -> int:
    """Length of an observation of an environment made here."""
    return int(np.prod(environment.observation_space.shape or ()))


def action_dim(environment: gymnasium.Env) -> int:
    """Length of an action of an environment made here."""
    return int(np.prod(environment.action_space.shape or ()))


def task_actions(environment: gymnasium.Env) -> spaces.Box:
    """Actions of the task below the wrappers of an environment made here."""
    actions = _rescaled(_layers(environment)).env.action_space
    assert isinstance(actions, spaces.Box)
    return actions


def _rescaled(layers: Iterable[gymnasium.Env]) -> RescaleAction:
    (rescaled,) = (each for each in layers if isinstance(each, RescaleAction))
    return rescaled


def _layers(environment: gymnasium.Env) -> list[gymnasium.Env]:
    """Wrappers of an environment made here, from the outermost to the task's own."""
    layers = [environment]
    while not isinstance(layers[-1], PlainSteps):  # what is below is the task's own
        assert isinstance(layers[-1], gymnasium.Wrapper)
        layers.append(layers[-1].env)
    return layers


def task_spaces(environment: gymnasium.Env) -> TaskSpaces:
    """Spaces of the task below the wrappers of an environment made here."""
    layers = _layers(environment)
    rescaled, actions = _rescaled(layers), task_actions(environment)
    flattened = [each for each in layers if isinstance(each, FlattenObservation)]
    return TaskSpaces(
        observation_dim(rescaled),
        tuple(actions.low.tolist()),
        tuple(actions.high.tolist()),
        str(actions.dtype),
        tuple(entry for each in flattened for entry in _entries(each.env.observation_space)),
    )


def _entries(space: spaces.Space, path: tuple[str | int, ...] = ()) -> list[Entry]:
    """Entries of a dictionary or tuple in the order in which it is flattened; none of another."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        parts: Iterable[Any] = (
            space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        )
        below = [_entries(each, (*path, key)) for key, each in parts]
    elif not path:
        return []
    elif isinstance(space, spaces.Box | spaces.MultiBinary):
        return [Entry(path, space.shape)]
    elif isinstance(space, spaces.Discrete):
        return [Entry(path, (), (int(space.n),), (int(space.start),))]
    elif isinstance(space, spaces.MultiDiscrete):
        choices, starts = space.nvec.flatten().tolist(), space.start.flatten().tolist()
        return [Entry(path, space.shape, tuple(choices), tuple(starts))]
    else:
        return []
    return [entry for each in below for entry in each] if all(below) else []


def _make_in_worker(config: EnvironmentConfig, source: EnvSpec | MakeEnv) -> gymnasium.Env:
    """Make an environment; a process of its own leaves Ctrl-C to the one that steps it."""
    if multiprocessing.parent_process() is None:
        return _make(config, source)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that process has told of them
        return _make(config, source)
