"""Settings of the agent: one set of defaults, for the class and for the trainer."""

import math
from dataclasses import dataclass, field, fields
from typing import Literal, get_args

from deep_curiosity.configuration import (
    LEAST_LEARNING_RATE,
    MOST_STEPS,
    Group,
    check_range,
    setting,
)
from deep_curiosity.schedules import Schedule
from deep_curiosity.transitions import is_number, is_whole_number

DEFAULT_GREEDY_SHARE = 0.25
TEMPERATURES = (
    1e-10,
    1e10,
)  # beyond which a tuned one does not go, so that float32 holds its terms
MOST_RATE = 1e6  # nats; what its actions allow is less, and known to the agent alone
MOST_HUNGER = 1e6  # of which float32 still resolves a curiosity value beside it

PriorName = Literal["uniform", "learned"]
HungerSource = Literal["fixed", "random", "bandit", "battery"]


@dataclass(frozen=True)
class ConditionedHunger:
    """Policy and critics are given the hunger, and learn every hunger from 0 to 1 at once.

    As text it is `conditioned:0.5` for a fixed one, `random`, `bandit`, `battery` or
    `battery:entry`.

    Args:
        source: Who chooses it while the agent acts: it is `"fixed"`; `"random"`, sampled for each
            episode; chosen by a `"bandit"` for what it earns; or read off a `"battery"`.
        value: The fixed hunger, in [0, 1]; 1 until another source has chosen.
        entry: Entry of the observation, or of `info` by its name, that holds the charge of the
            battery, from 0 to 1.

    Raises:
        TypeError: If the entry is neither a whole number nor a name.
        ValueError: If the source is unknown, the value outside [0, 1], or an argument is about
            another source.
    """

    source: HungerSource = "fixed"
    value: float = 1.0
    entry: int | str = -1

    def __post_init__(self) -> None:
        """Reject what cannot be."""
        if self.source not in get_args(HungerSource):
            raise ValueError(
                f"`source` must be one of {get_args(HungerSource)}, got {self.source!r}."
            )
        if not (is_number(self.value) and 0 <= self.value <= 1):
            raise ValueError(f"`hunger` must lie in [0, 1] where conditioned, got {self.value!r}.")
        object.__setattr__(self, "value", float(self.value))  # NumPy's is written otherwise
        if self.source != "fixed" and self.value != 1:
            raise ValueError(
                f"`value` must be left out where the source is {self.source!r}, got {self.value}."
            )
        self._check_entry()

    def _check_entry(self) -> None:
        """Reject an entry that is none, or that its text would not be read back as."""
        if self.source != "battery" and self.entry != -1:
            raise ValueError(
                f"`entry` must be left out where the source is {self.source!r}, "
                f"got {self.entry!r}."
            )
        if isinstance(self.entry, str):
            if not self.entry or _is_index(self.entry):
                raise ValueError(f"`entry` must be a name or a number, got {self.entry!r}.")
        elif not is_whole_number(self.entry):
            raise TypeError(f"`entry` must be a whole number or a name, got {self.entry!r}.")

    @classmethod
    def parse(cls, text: str) -> "ConditionedHunger":
        """Read what `str` wrote.

        Raises:
            ValueError: If the text is none of the forms, or the value outside [0, 1].
        """
        if not isinstance(text, str):
            raise TypeError(f"`text` must be text, such as conditioned:0.5, got {text!r}.")
        source, _, detail = text.partition(":")
        if source == "battery":
            return cls("battery", entry=int(detail) if _is_index(detail) else detail or -1)
        if text in ("random", "bandit"):
            return cls(text)  # type: ignore[arg-type]  # one of the two
        try:
            value = float(detail) if source == "conditioned" else None
        except ValueError:
            value = None
        if value is None:
            raise ValueError(
                "`hunger` must be a number, a schedule such as linear:1:10, random, bandit, "
                f"battery, battery:ENTRY or conditioned:VALUE, got {text!r}."
            )
        return cls("fixed", value)

    def __str__(self) -> str:
        """As `parse` reads it."""
        if self.source == "fixed":
            return f"conditioned:{self.value!r}"
        return f"battery:{self.entry}" if self.source == "battery" else self.source


def _is_index(text: str) -> bool:
    return text.removeprefix("-").isdecimal()


@dataclass(frozen=True)
class RewardValueConfig(Group):
    """The value of the reward, Q."""

    discount: float = setting(0.99, at_least=0, below=1)
    """Discount of the reward per step."""
    reward_steps: int = setting(3, at_most=1_000)
    """Steps of reward that are summed before the value is trusted. With `soft_backup` only the
    information cost after the last of them is charged."""
    soft_backup: bool | None = None
    """Charge the values with the information cost of later actions, as soft actor-critic does. By
    default where reward's value is about a policy that maximises nothing else and has the uniform
    prior: that of an agent without curiosity, or the greedy one, whose own cost it then is."""


@dataclass(frozen=True)
class CuriosityValueConfig(Group):
    """The value of the bonus, Q_D, and its weight in the policy."""

    discount: float = setting(0.97, name="curiosity_discount", at_least=0, below=1)
    """Discount of the bonus per step; with 0 the policy maximises the bonus itself, as the paper
    writes it, differentiated through the model, and no critic learns it."""
    steps: int = setting(3, name="curiosity_steps", at_most=1_000)
    """Steps of bonus that are summed before the value is trusted."""
    episodic: bool = setting(True, name="curiosity_episodic")
    """End the value where the episode terminates; otherwise it goes on from where the next episode
    begins, as in Burda et al. (2018)."""
    coefficient: float | Literal["adaptive"] = setting(
        "adaptive", name="curiosity_coefficient", at_least=0, at_most=MOST_HUNGER
    )
    """Weight of the value in the policy's objective: a number; or adaptive, the ratio of the
    standard deviations of Q_D and hunger times Q over replay, at most 1, so that curiosity fades
    as reward comes to distinguish states, and the sooner the hungrier the agent."""
    greedy_share: float | None = setting(None, at_least=0, below=1)
    """Share of the steps at which a second policy acts that maximises the reward's value alone;
    the value is then about this one, and it acts in evaluations. By default a quarter; 0, and the
    value is about the curious policy, where the agent is conditioned on its hunger."""
    adaptive_greedy_share: bool | None = None
    """Let that share grow as reward comes to distinguish states: to one less the ratio of the
    adaptive coefficient, at most 0.95. By default where there is a greedy policy."""
    ends: int | None = setting(None, name="curiosity_ends", at_most=MOST_STEPS)
    """Environment step from which only reward counts; by default none."""


@dataclass(frozen=True)
class AgentConfig(Group):
    """The agent."""

    hidden_dim: int = setting(256, at_most=2**14)
    """Width of the two hidden layers of policy, critics and models."""
    prior: PriorName | None = None
    """Action prior: flat as in soft actor-critic, or the learned action marginal of (21). By
    default learned where there is a bonus and uniform where there is none. The greedy policy of a
    curious agent always has the flat one."""
    hunger: float | Schedule | ConditionedHunger = setting(1.0, at_least=0, at_most=MOST_HUNGER)
    """Weight of the reward's value, alpha: a number; a schedule such as linear:1:10; or random,
    bandit, battery or conditioned:0.5, where policy and critics are given the hunger and learn
    every hunger from 0 to 1 at once."""
    temperature: float | Schedule = setting(
        0.02, above=0, at_least=TEMPERATURES[0], at_most=TEMPERATURES[1]
    )
    """Price of a nat, lambda: a number is where it starts, from which it is tuned to hold the
    target information rate; constant:0.02 stays; linear:0.02:0.002, exponential:... or
    plateaus:... go with time."""
    target_information_rate: float | None = setting(None, above=0, at_most=MOST_RATE)
    """Nats per action by which the policy may differ from the prior; by default 1.69 for each
    action dimension, soft actor-critic's target entropy where the prior is uniform."""
    learning_rate: float = setting(1e-3, above=0, at_least=LEAST_LEARNING_RATE, at_most=1)
    """Learning rate of policy, critics, prior and temperature."""
    polyak: float = setting(0.02, above=0, at_least=1e-6, at_most=1)
    """Share of the critics that moves into the target critics at each update."""
    normalize_observations: bool = True
    """Show policy and critics each entry of an observation in a unit in which its root mean square
    lies between 0.1 and 10, over what was learned from of late: a speed of 0.03 is widened, and
    what lies between is seen as it is. An entry that is mostly zero is measured where it is not.
    Models and bonus have units of their own either way."""
    critic_layer_norm: bool = False
    """Normalise every hidden layer of reward's critics, which bounds what they extrapolate, and
    begin with values near zero. Without it first policies may press actions to the edge of their
    box, where no step was taken yet, and stay there for thousands of steps."""
    mixture_components: int = setting(1, name="policy_mixture_components", at_most=100)
    """Gaussians that make up the policy; an optimum with two peaks needs two."""
    actor_q: Literal["alternate", "min"] = "alternate"
    """What the policy maximises at each transition: one of reward's two critics, in round-robin
    order, or the smaller of both. Critics learn from the smaller either way."""
    actor_batch_fraction: float = setting(0.5, above=0, at_least=1e-4, at_most=1)
    """Share of a batch from which policy, prior and temperature learn, one over a whole number;
    critics learn from all of it, and models as `members` says."""
    reward: RewardValueConfig = field(default_factory=RewardValueConfig)
    curiosity: CuriosityValueConfig = field(default_factory=CuriosityValueConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot be, or would do nothing."""
        super().__post_init__()
        self._check_schedules()
        if not math.isclose(1 / self.actor_stride, self.actor_batch_fraction):
            raise ValueError(
                "`actor_batch_fraction` must be one over a whole number, "
                f"got {self.actor_batch_fraction}."
            )
        if self.target_information_rate is not None and isinstance(self.temperature, Schedule):
            raise ValueError(
                "`target_information_rate` must be left out where the temperature is not tuned, "
                f"got {self.target_information_rate} with `temperature` {self.temperature}."
            )
        if self.is_conditioned and self.curiosity.coefficient != "adaptive":
            raise ValueError(
                "`curiosity_coefficient` must be 'adaptive' where the agent is conditioned on its "
                f"hunger, got {self.curiosity.coefficient}."
            )
        if self.curiosity.greedy_share and self.is_conditioned:
            raise ValueError(
                "`greedy_share` must be left out or 0 where conditioned on hunger, "
                f"got {self.curiosity.greedy_share}."
            )
        if self.curiosity.adaptive_greedy_share and not self.greedy_share:
            raise ValueError(
                "`adaptive_greedy_share` must be left out or False where `greedy_share` is 0 or "
                "the agent is conditioned on its hunger, got True."
            )
        if self.curiosity.discount == 0:
            self._refuse_settings_of_curiosity_value()

    def _check_schedules(self) -> None:
        """Hold the ends of a schedule to the range of a number in its place."""
        for own in fields(self):
            value = getattr(self, own.name)
            if isinstance(value, Schedule):
                for end in (value.first, value.last):
                    check_range(own.name, end, own.metadata)

    def _refuse_settings_of_curiosity_value(self) -> None:
        """Refuse what is about the value of the bonus where none is learned."""
        known = {"steps": (1, CuriosityValueConfig.steps), "episodic": (True,)}
        for name, values in known.items():
            if getattr(self.curiosity, name) not in values:
                raise ValueError(
                    f"`curiosity_discount` must be above 0 where `curiosity_{name}` is set, got 0."
                )

    def prior_of(self, *, curiosity: bool) -> PriorName:
        """Action prior of an agent with or without a bonus."""
        if self.prior is not None:
            return self.prior
        return "learned" if curiosity else "uniform"

    @property
    def is_conditioned(self) -> bool:
        """Whether policy and critics are given the hunger."""
        return isinstance(self.hunger, ConditionedHunger)

    @property
    def greedy_share(self) -> float:
        """Share of a curious agent's steps at which its greedy policy acts, at least."""
        if self.curiosity.greedy_share is not None:
            return self.curiosity.greedy_share
        return 0.0 if self.is_conditioned else DEFAULT_GREEDY_SHARE

    @property
    def tunes_temperature(self) -> bool:
        """Whether the temperature is adjusted to hold the target information rate."""
        return not isinstance(self.temperature, Schedule)

    @property
    def follows_schedule(self) -> bool:
        """Whether a setting goes with time, as a share of all steps."""
        return any(isinstance(value, Schedule) for value in vars(self).values())

    @property
    def actor_stride(self) -> int:
        """Rows of a batch from one that the policy learns from to the next."""
        return round(1 / self.actor_batch_fraction)
