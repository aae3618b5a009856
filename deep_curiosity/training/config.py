"""Settings of a training run: nested dataclasses, whose comments are the command line's help."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import torch

from deep_curiosity.agent.config import AgentConfig, CuriosityValueConfig
from deep_curiosity.bonuses.config import BonusConfig, CuriosityConfig, bonus_config
from deep_curiosity.configuration import (
    MOST_SEED,
    MOST_STEPS,
    Group,
    as_plain,
    changes,
    flat,
    override,
    setting,
    unknown_setting,
)
from deep_curiosity.speed.config import SpeedConfig
from deep_curiosity.speed.machine import WORTH_COMPILING

PRESETS: dict[str, dict[str, Any]] = {
    "fast": {
        "members": "round_robin",
        "actor_q": "alternate",
        "actor_batch_fraction": 0.5,
        "refresh_interval": 20,
    },
    "exact": {
        "members": "all",
        "actor_q": "min",
        "actor_batch_fraction": 1.0,
        "refresh_interval": 10,
    },
    "paper": {
        "members": "all",
        "actor_q": "min",
        "actor_batch_fraction": 1.0,
        "refresh_interval": 1,
    },
}
"""Settings of how networks sample a batch: the default; every network learns from the whole of
every batch; and besides, p(x') is renewed at every update, as the paper's (24) is."""


@dataclass(frozen=True)
class EnvironmentConfig(Group):
    """The task, and how it is stepped."""

    env_id: str = "deep_curiosity/PendulumSwingup-v0"
    """Task: one of ours, a gymnasium id such as HalfCheetah-v5, dm_control/DOMAIN-TASK-v0, or
    MODULE:TASK-v0, which imports the module first."""
    env_kwargs: dict[str, bool | int | float | str | None] = setting({})
    """Keyword arguments of the environment, such as: action_cost 0.1 goal_terminates True"""
    max_episode_steps: int | None = None
    """Steps after which an episode is cut off; as the task is registered when none, or 1000 where
    nothing limits its episodes."""
    observation_keys: tuple[str, ...] = ()
    """Entries of a dictionary of observations that are shown to the agent; all when none."""
    terminate_on_success: bool = False
    """End an episode once the task reports success; a warning says where it reports none."""
    action_repeat: int = setting(1, at_most=1_000)
    """Steps of the task for which every action is held, with their rewards summed; all other steps
    and intervals count actions, but for `max_episode_steps`. For tasks whose steps are so short
    that a single action changes next to nothing: from 2 to 8 in those of dm_control."""
    frame_stack: int = setting(1, at_most=1_000)
    """Observations shown to the agent together, with the actions between them."""
    num_envs: int = setting(1, at_most=2**16)
    """Environments that are stepped side by side; all steps and intervals count over all of them,
    and are rounded up to whole steps of each."""
    vectorization: Literal["auto", "native", "sync", "async"] = "auto"
    """How several environments are stepped: by MuJoCo in one call (our own tasks), one after
    another, or each in a process of its own; auto is native where it can be, else sync."""

    def __post_init__(self) -> None:
        """Take a limit that is given among the arguments, as gymnasium does, for the setting.

        Raises:
            TypeError: If a value has the wrong type.
            ValueError: If a value is out of range, or two limits are given.
        """
        super().__post_init__()
        if "max_episode_steps" not in self.env_kwargs:
            return
        env_kwargs = dict(self.env_kwargs)
        limit = env_kwargs.pop("max_episode_steps")
        if self.max_episode_steps not in (None, limit):
            raise ValueError(
                f"`max_episode_steps` must be given once, got {self.max_episode_steps} and "
                f"{limit} in `env_kwargs`."
            )
        object.__setattr__(self, "env_kwargs", env_kwargs)
        object.__setattr__(self, "max_episode_steps", limit)
        super().__post_init__()


@dataclass(frozen=True)
class RunConfig(Group):
    """The course of the run."""

    total_steps: int = setting(20_000, at_most=MOST_STEPS)
    """Environment steps, over all environments and resumed parts together."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Seeds torch, the environments and the replay."""
    out: Path = Path("runs/latest")
    """Folder that receives the run; must not hold one already."""
    init_from: Path | None = None
    """Folder of a run, in the same or another task of the same sizes, whose policy, values, models
    and their statistics this one begins with; it then acts by its policy from the first step."""
    init_replay: bool = False
    """Take the transitions of that run as well, where they tell of this task and its reward."""
    learning_starts: int = setting(500, at_least=0, at_most=MOST_STEPS)
    """Steps before the first update, of uniformly random actions unless `init_from` is set."""
    update_to_data: float = setting(1.0, above=0, at_most=1_000)
    """Updates per environment step once learning has begun; 0.25 is one at every fourth step."""
    batch_size: int = 256
    """Transitions in an update."""
    hindsight: int | None = setting(None, at_most=1_000)
    """Goals in hindsight for each real one in an update: what was achieved at that step or a
    later one of its episode, as if it was desired. For dictionaries of observation, achieved_goal
    and desired_goal whose environment has compute_reward; by default none."""
    replay_capacity: int = setting(1_000_000, at_most=10**9)
    """Transitions kept; memory is taken only as they come."""
    exploration: Literal["policy", "gsde", "pink", "ou"] = "policy"
    """Noise of the curious policy's actions: its own samples, or noise that is correlated in time:
    linear in its last hidden layer (gSDE), pink, or an Ornstein-Uhlenbeck process. The greedy
    policy, which by default takes from a quarter to 95 % of the steps (`greedy_share`), always
    acts by its own samples."""
    log_interval: int = setting(500, at_most=MOST_STEPS)
    """Steps from one row of progress.csv to the next."""
    evaluation_interval: int = setting(2_000, at_most=MOST_STEPS)
    """Steps from one evaluation to the next; there is always one at the end."""
    evaluation_episodes: int = 10
    """Episodes in each evaluation, without noise."""
    checkpoint_interval: int = setting(5_000, at_most=MOST_STEPS)
    """Steps from one checkpoint to the next; there is always one at the end."""


@dataclass(frozen=True)
class Config(Group):
    """All settings of a training run.

    `Config.of(env_id="PointMaze", bonus="rnd")` sets some of them by their flat names, as on the
    command line.
    """

    environment: EnvironmentConfig = field(default_factory=EnvironmentConfig)
    run: RunConfig = field(default_factory=RunConfig)
    bonus: BonusConfig = field(default_factory=CuriosityConfig)
    agent: AgentConfig = field(default_factory=AgentConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)

    def __post_init__(self) -> None:
        """Refuse a run that cannot be, or a setting that would do nothing in it.

        Raises:
            TypeError: If a value has the wrong type.
            ValueError: Naming the setting, the rule and the value.
        """
        super().__post_init__()
        _check_course(self)
        if self.run.exploration != "policy" and self.agent.mixture_components > 1:
            raise ValueError(
                f"`exploration` must be 'policy' for a policy of {self.agent.mixture_components} "
                f"mixture components, got {self.run.exploration!r}."
            )
        if self.agent.curiosity.discount == 0 and self.bonus.scores_outcomes:
            raise ValueError(
                f"`curiosity_discount` must be above 0 for the bonus {self.bonus.kind}, which has "
                "no gradient in the action, got 0."
            )
        _read_device(self.speed.device)
        _refuse_idle_settings(self)

    @classmethod
    def of(cls, preset_name: str | None = None, /, **values: Any) -> "Config":
        """The default configuration with some settings changed, by their flat names.

        Args:
            preset_name: How networks sample a batch, a key of `PRESETS`; `None` changes nothing.
            **values: Settings; `bonus` may be a name.

        Raises:
            TypeError: If there is no such setting, or a value has the wrong type.
            ValueError: If a value is out of range.
        """
        return cls().override(preset_name, **values)

    def override(self, preset_name: str | None = None, /, **values: Any) -> "Config":
        """The same configuration with some settings changed, as in `of`.

        What it has already is not looked at anew: a run goes on as it was begun, and is read where
        its device is not there.
        """
        changed = self._changed(preset_name, values)
        if changed.speed.device != self.speed.device:
            check_device(changed.speed.device)
        _refuse_new_idle_switches(changed, self)
        return changed

    def _changed(self, preset_name: str | None, values: dict[str, Any]) -> "Config":
        kind = values.pop("bonus", self.bonus)
        bonus = self.bonus if kind == self.bonus else _switched(self.bonus, kind)
        groups: dict[str, Group] = vars(self) | {"bonus": bonus}
        known = [name for group in groups.values() for name in flat(group)]
        for name in values:
            if name not in known:
                raise unknown_setting(name, known)
        chosen = ({} if preset_name is None else _preset(preset_name)) | values
        changed: dict[str, Any] = {
            field: override(
                group, **{name: chosen[name] for name in flat(group) if name in chosen}
            )
            for field, group in groups.items()
        }
        return replace(self, **changed)

    def to_json(self) -> dict[str, Any]:
        """All settings by their flat names, as JSON knows them."""
        settings = {name: as_plain(own.value) for name, own in flat(self).items()}
        return settings | {"bonus": self.bonus.kind}

    @classmethod
    def from_json(cls, values: Mapping[str, Any], source: str = "config.json") -> "Config":
        """Read what `to_json` gave.

        Raises:
            ValueError: If there is no such setting, it cannot have this value, or one is missing,
                naming `source`.
        """
        try:
            if not isinstance(values, Mapping):
                raise TypeError(f"`settings` must be a mapping by name, got {values!r}.")
            config = cls()._changed(None, dict(values))
            for name, default in config.to_json().items():
                if name not in values:
                    raise ValueError(f"`{name}` must be there, such as {default!r}, got nothing.")
        except (TypeError, ValueError) as error:
            raise ValueError(f"{source}: {error}") from error
        return config

    def changes(self) -> dict[str, Any]:
        """Settings that differ from the default, by their flat names, as JSON knows them."""
        default = Config()
        kind = {} if self.bonus.kind == default.bonus.kind else {"bonus": self.bonus.kind}
        reference = replace(default, bonus=bonus_config(self.bonus.kind))
        changed = changes(self, reference)
        return kind | {name: as_plain(value) for name, value in changed.items()}


def _preset(name: str) -> dict[str, Any]:
    if not isinstance(name, str) or name not in PRESETS:
        raise ValueError(f"`preset` must be one of {', '.join(PRESETS)}, got {name!r}.")
    return PRESETS[name]


def _switched(bonus: BonusConfig, kind: Any) -> BonusConfig:
    """Another bonus, with the settings that both have as they were."""
    if isinstance(kind, BonusConfig):
        return kind
    if not isinstance(kind, str):
        raise TypeError(f"`bonus` must be a name or a BonusConfig, got {kind!r}.")
    other: BonusConfig = bonus_config(kind)
    shared = flat(other).keys() & flat(bonus).keys()
    return override(other, **{name: flat(bonus)[name].value for name in shared})


def _check_course(config: Config) -> None:
    """Refuse a course in which nothing is ever learned, or a replay that holds no batch."""
    run, num_envs = config.run, config.environment.num_envs
    if run.learning_starts >= run.total_steps:
        raise ValueError(
            f"`total_steps` must be above `learning_starts` ({run.learning_starts}), or "
            f"nothing is ever learned, got {run.total_steps}."
        )
    begins = math.ceil(run.learning_starts / num_envs) * num_envs
    if begins >= run.total_steps:
        raise ValueError(
            f"`total_steps` must be above {begins}, where {num_envs} environments begin to learn, "
            f"got {run.total_steps}."
        )
    steps = math.ceil((run.total_steps - begins) / num_envs) * num_envs
    if Fraction(str(run.update_to_data)) * steps < 1:
        raise ValueError(
            f"`update_to_data` must call for an update in the {steps} steps of learning, "
            f"got {run.update_to_data}."
        )
    if run.replay_capacity < max(run.batch_size, num_envs):
        raise ValueError(
            f"`replay_capacity` must be at least `batch_size` ({run.batch_size}) and `num_envs` "
            f"({num_envs}), got {run.replay_capacity}."
        )
    if config.agent.actor_stride > run.batch_size:
        raise ValueError(
            f"`actor_batch_fraction` must leave a row of `batch_size` ({run.batch_size}), "
            f"got {config.agent.actor_batch_fraction}."
        )
    _check_batch(config)


def _check_batch(config: Config) -> None:
    """Refuse batches of which a model has no row, or whose spread is that of one row."""
    batch_size, bonus = config.run.batch_size, config.bonus
    if isinstance(bonus, CuriosityConfig):
        dynamics = bonus.dynamics
        if dynamics.members == "round_robin" and batch_size < dynamics.num_members:
            raise ValueError(
                f"`batch_size` must be at least `num_members` ({dynamics.num_members}), which "
                f"share the rows, got {batch_size}."
            )
    adapts = bonus.kind != "none" and config.agent.curiosity.coefficient == "adaptive"
    if adapts and math.ceil(batch_size / config.agent.actor_stride) < 2:
        raise ValueError(
            "`batch_size` must leave the actor two rows, by whose spread the curiosity "
            f"coefficient adapts, got {batch_size} with `actor_batch_fraction` "
            f"{config.agent.actor_batch_fraction}."
        )


def _read_device(name: str) -> torch.device:
    try:
        device = torch.device(name)
    except RuntimeError:  # whose message lists every device that torch was ever built for
        device = None
    if device is None or device.type not in ("cpu", "cuda") or name.startswith("cpu:"):
        raise ValueError(f"`device` must be cpu or cuda, got {name!r}.")
    return device


def check_device(name: str) -> None:
    """Refuse a device that is not there.

    Raises:
        ValueError: If torch cannot use it on this machine.
    """
    device = _read_device(name)
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if device.type == "cuda" and (device.index or 0) >= there:
        raise ValueError(f"`device` must be one that torch can use here, got {name!r}.")


def _refuse_idle_settings(config: Config) -> None:
    """Refuse by name what would do nothing in this run.

    Raises:
        ValueError: Naming the setting, why it would do nothing, and its value.
    """
    if config.run.init_replay and config.run.init_from is None:
        raise ValueError("`init_replay` must be left out without `init_from`, got True.")
    if config.bonus.kind == "none":
        _refuse_settings_of_curiosity(config.agent)
    ends = config.agent.curiosity.ends
    if ends is not None and ends >= config.run.total_steps:
        raise ValueError(
            f"`curiosity_ends` must be below `total_steps` ({config.run.total_steps}), got {ends}."
        )
    if ends is not None and ends <= config.run.learning_starts:
        raise ValueError(
            f"`curiosity_ends` must be above `learning_starts` ({config.run.learning_starts}), "
            f"before which nothing is learned, got {ends}."
        )
    if config.environment.num_envs == 1 and config.environment.vectorization != "auto":
        raise ValueError(
            "`vectorization` must be left out for a single environment, "
            f"got {config.environment.vectorization!r}."
        )
    _refuse_idle_window(config)
    _refuse_idle_switches(config)
    if config.run.hindsight is not None:
        _refuse_beside_hindsight(config)


def _refuse_idle_window(config: Config) -> None:
    """Refuse to count entries in a window where none is chosen, or there is no window."""
    bonus, frame_stack = config.bonus, config.environment.frame_stack
    if not isinstance(bonus, CuriosityConfig) or bonus.features_of == "newest":
        return
    if frame_stack == 1 or not bonus.features:
        raise ValueError(
            "`features_of` must be left out without `features` and a `frame_stack` above 1, got "
            f"{bonus.features_of!r} with {list(bonus.features)} and {frame_stack}."
        )


def _refuse_beside_hindsight(config: Config) -> None:
    """Refuse what no goal in hindsight can be put into.

    Raises:
        ValueError: Naming the setting, the rule and its value.
    """
    environment, curiosity = config.environment, config.agent.curiosity
    if environment.frame_stack > 1:
        raise ValueError(
            "`frame_stack` must be 1 with `hindsight`, which puts a goal into single "
            f"observations, got {environment.frame_stack}."
        )
    if environment.action_repeat > 1:
        raise ValueError(
            "`action_repeat` must be 1 with `hindsight`, which computes the reward of single "
            f"steps, got {environment.action_repeat}."
        )
    if environment.terminate_on_success:
        raise ValueError(
            "`terminate_on_success` must be left out with `hindsight`, which knows of success "
            "with another goal only by compute_terminated, got True."
        )
    if config.bonus.kind != "none" and curiosity.discount == 0:
        raise ValueError(
            "`curiosity_discount` must be above 0 with `hindsight`: the policy would maximise a "
            "bonus of goals that nobody pursued, got 0."
        )
    if not curiosity.episodic:
        raise ValueError(
            "`curiosity_episodic` must be True with `hindsight`, since nothing follows on the end "
            "of an episode that went on, got False."
        )


def _refuse_settings_of_curiosity(agent: AgentConfig) -> None:
    """Refuse what is about a bonus where there is none."""
    if agent.is_conditioned or agent.hunger == 0:
        raise ValueError(
            "`hunger` must be a positive number or a schedule without a bonus, "
            f"got {agent.hunger}."
        )
    for own in fields(CuriosityValueConfig):
        value = getattr(agent.curiosity, own.name)
        if value != own.default:
            name = own.metadata.get("name", own.name)
            raise ValueError(f"`{name}` must be left out without a bonus, got {value!r}.")


def _refuse_idle_switches(config: Config) -> None:
    """Refuse a switch of the compiler or of the policy that is off where it is not used."""
    speed = config.speed
    for name in ("direct_matmul", "deduplicate"):
        if speed.compile == "off" and not getattr(speed, name):
            raise ValueError(f"`{name}` must be left out where `compile` is off, got False.")
    if speed.device != "cpu" and not speed.direct_matmul:
        raise ValueError(
            f"`direct_matmul` must be left out where `device` is {speed.device}, got False."
        )
    if not speed.numpy_policy and (config.environment.num_envs > 1 or speed.device != "cpu"):
        raise ValueError(
            "`numpy_policy` must be left out unless a single environment is stepped on the cpu, "
            f"got False for {config.environment.num_envs} on {speed.device}."
        )


def _refuse_new_idle_switches(config: Config, before: Config) -> None:
    """Refuse a switch that is off and would do nothing, unless it was so before.

    Raises:
        ValueError: Naming the switch, where it acts, and its value.
    """
    already = _idle_switches(before)
    for name, where in _idle_switches(config).items():
        if name not in already:
            raise ValueError(f"`{name}` must be left out {where}, got False.")


def _idle_switches(config: Config) -> dict[str, str]:
    """Switches that are off and do nothing, with where that is so."""
    speed, idle = config.speed, {}
    num_updates = (config.run.total_steps - config.run.learning_starts) * config.run.update_to_data
    if speed.compile == "auto" and num_updates < WORTH_COMPILING:
        where = f"where `compile` is auto and updates are fewer than {WORTH_COMPILING}"
        idle = {name: where for name in ("direct_matmul", "deduplicate")}
    if config.run.exploration != "policy":
        idle["numpy_policy"] = f"with `exploration` {config.run.exploration}, where torch acts"
    elif config.agent.mixture_components > 1:
        number = config.agent.mixture_components
        idle["numpy_policy"] = f"with {number} `policy_mixture_components`, where torch acts"
    return {name: where for name, where in idle.items() if not getattr(speed, name)}


def config_key(values: Mapping[str, Any]) -> dict[str, str]:
    """What makes a run the one it is: its settings, but for where it lies."""
    return {
        name: json.dumps(value, sort_keys=True)
        for name, value in values.items()
        if name not in IGNORED
    }


def run_key(values: Mapping[str, Any]) -> str:
    """The same as one text, by which runs are looked up."""
    return json.dumps(config_key(values), sort_keys=True)


def merge_config(wanted: Config, own: Config) -> Config:
    """Settings with which a run goes on: its own, but for those that it may change.

    Args:
        wanted: With which it is to go on; `matmul_precision` may be left to the run by "auto".
        own: Of the run.

    Raises:
        ValueError: If another setting is wanted than the run has and may change.
    """
    there, here = own.to_json(), wanted.to_json()
    for name in dict.fromkeys(("bonus", *there, *here)):
        values = there.get(name), here.get(name)
        if name not in ("out", *CHANGEABLE) and values[0] != values[1]:
            raise ValueError(
                f"`{name}` must stay as the run in {own.run.out} has it, {values[0]!r}, "
                f"got {values[1]!r}."
            )
    changed = {name: here[name] for name in CHANGEABLE}
    if changed["matmul_precision"] == "auto":
        del changed["matmul_precision"]
    return own.override(**changed)


IGNORED = ("out", "matmul_precision")  # the last is chosen anew by the clock
YOUNGER: dict[str, Any] = {
    "hindsight": None,
    "action_repeat": 1,
    "normalize_observations": False,
    "adaptive_greedy_share": False,
}
"""Settings that came after the first runs, with the value by which these were as they are."""


def with_younger(values: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as they are written, and those that came later with the values of before."""
    younger = dict(YOUNGER)
    if values.get("bonus") == CuriosityConfig.kind:
        of_window = values.get("features") and values.get("frame_stack") != 1
        younger["features_of"] = "window" if of_window else "newest"
    return younger | dict(values)


LEARNING_STAYS = (
    "log_interval",
    "evaluation_interval",
    "evaluation_episodes",
    "checkpoint_interval",
    "keep_memory",
)
"""Settings that a continued run may change, and learns bit for bit as it would have."""
ROUNDING_CHANGES = (
    "device",
    "threads",
    "compile",
    "matmul_precision",
    "direct_matmul",
    "deduplicate",
    "numpy_policy",
)
"""Settings that a continued run may change, and computes the same with other rounding."""
CHANGEABLE = ("total_steps", *LEARNING_STAYS, *ROUNDING_CHANGES)
"""All that a continued run may change."""
