"""What a run is made of: one dataclass, whose comments are the command line's help."""

import math
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import torch

from deep_curiosity.bonuses.registry import BONUSES

SCORES_OUTCOMES = [name for name, kind in BONUSES.items() if kind.scores_outcomes]
"""Bonuses that are told what has happened, and cannot be climbed by the action."""
EXACT: dict[str, Any] = {
    "member_per_row": False,
    "actor_stride": 1,
    "critic_per_row": False,
    "refresh_interval": 10,
}
"""Settings by which every network learns from the whole of every batch, as the library does."""


@dataclass(frozen=True)
class Settings:
    """Settings of one training run."""

    env_id: str = "deep_curiosity/PendulumSwingup-v0"
    """Task: one of ours, a gymnasium id such as HalfCheetah-v5, or dm_control/DOMAIN-TASK-v0."""
    env_kwargs: dict[str, float] = field(default_factory=dict)
    """Keyword arguments of the environment, such as: action_cost 0.1"""
    history: int = 1
    """Observations shown to the agent together, with the actions between them."""
    total_steps: int = 20_000
    """Environment steps, over all worlds and resumed parts together; a resumed run keeps its own
    number unless another is given."""
    num_envs: int = 1
    """Worlds that are stepped side by side; all steps and intervals count over all of them, and
    are rounded up to whole steps of each."""
    vectorization: Literal["auto", "native", "sync", "async"] = "auto"
    """How several worlds are stepped: by MuJoCo in one call (our own tasks), in turn, or each in a
    process of its own; auto is native where it can be, else sync."""
    update_to_data: float = 1.0
    """Updates per environment step once learning has begun; 0.25 is one at every fourth step."""
    seed: int = 0
    """Seeds torch, the environments and the replay."""
    out: Path = Path("runs/latest")
    """Folder that receives the run; must not hold one already."""
    resume: Path | None = None
    """Folder of a run to continue, in place; its own settings hold, but for total_steps."""

    bonus: Literal[
        "curiosity",
        "disagreement",
        "information-gain",
        "rnd",
        "icm",
        "nearest-neighbours",
        "hash-count",
        "constant",
        "none",
    ] = "curiosity"
    """Curiosity; a rival, centred and scaled as curiosity is; the same constant for every step (a
    control); or plain soft actor-critic."""
    bonus_weight: float = 0.1
    """Factor of the standardised bonus, the first one where it is tuned."""
    tune_bonus_weight: float | Literal["past"] | None = None
    """Let curiosity's weight rise while the policy earns less than: past, what it earned of late;
    or so many nats."""
    bonus_parts: dict[str, float] = field(default_factory=dict)
    """Weights of what curiosity is made of, instead of D as a whole: predictive_power,
    information_gain, negative_entropy, cross_entropy; such as: information_gain 1"""
    curiosity_discount: float = 0.97
    """Discount of the bonus per step; 0 climbs the bonus itself, as the paper writes it."""
    exploration: Literal["policy", "gsde", "pink", "ou"] = "policy"
    """Noise of the actions: the policy's own draws, or draws that hang together in time: linear in
    the policy's last hidden layer (gSDE), pink, or an Ornstein-Uhlenbeck process."""
    hunger: float = 1.0
    """Weight of the extrinsic value, alpha; the first one where it goes with time."""
    hunger_control: Literal[
        "constant", "linear", "exponential", "dial", "draws", "bandit", "battery"
    ] = "constant"
    """Who says how hungry the agent is: it stays; it goes to final_hunger; or policy and critics
    are told it and learn every hunger from 0 to 1 at once, where it is held, drawn for each
    episode, chosen by a bandit for what it earns, or read off a battery."""
    final_hunger: float = 10.0
    """Hunger at the end of a schedule."""
    battery: int | str = -1
    """Entry of the observation, or of info, that holds the charge of the battery, from 0 to 1."""
    curiosity_ends: int | None = None
    """Step from which only reward counts; by default none."""
    curiosity_steps: int = 1
    """Steps of bonus that are summed before the curiosity value is trusted."""
    curiosity_episodic: bool = True
    """End the curiosity value where the world ends; otherwise it looks past the end."""
    yielding: bool = True
    """Let curiosity fade as reward comes to tell states apart."""
    prior: Literal["uniform", "learned"] = "uniform"
    """Action prior: flat as in soft actor-critic, or the learned action marginal."""
    temperature: float = 0.02
    """Price of a nat, lambda; the initial one where it is tuned."""
    temperature_control: Literal["rate", "constant", "linear", "exponential", "annealing"] = "rate"
    """What the temperature does: hold the target information rate; stay; or go to
    final_temperature, straight, by the same factor at every step, or so in ten plateaus."""
    final_temperature: float = 0.002
    """Temperature at the end of a schedule, lambda_min."""
    target_information_rate: float | None = None
    """Nats per action away from the prior; by default 1.69 (uniform) or 1 (learned) per action
    dimension."""
    discount: float = 0.99
    """Discount of the extrinsic reward per step."""
    reward_steps: int = 1
    """Steps of reward that are summed before the extrinsic value is trusted."""
    learning_rate: float = 1e-3
    """Of Adam, for policy, critics, prior and temperature."""
    polyak: float = 0.02
    """Share of the critics that moves into the target critics at each update."""
    batch_size: int = 256
    """Transitions in an update."""
    actor_stride: int = 2
    """Policy, prior and temperature learn from one in as many transitions of a batch; critics and
    models from them all."""
    critic_per_row: bool = True
    """Let the policy climb one critic of each pair at each transition, in turn, instead of the
    smaller of both; critics learn from the smaller either way."""
    hidden_dim: int = 256
    """Width of the two hidden layers of policy, critics and models."""
    policy_modes: int = 1
    """Gaussians that make up the policy; an optimum with two peaks needs two."""

    members: int = 5
    """Models in the dynamics ensemble."""
    outcomes: int = 1
    """Gaussians that make up a prediction; a next state that is one of two needs two."""
    model_learning_rate: float = 1e-3
    """Of Adam, for the models."""
    features: tuple[int, ...] = ()
    """Entries of the observation that curiosity is about, from the end where negative; all by
    default, or with a history the two newest observations."""
    noise_floor: float = 0.05
    """Resolution at which the agent sees, in standard deviations of the observation."""
    whitening: Literal["moments", "robust"] = "moments"
    """Unit of the observation's entries: standard deviation, or interquartile range, which heavy
    tails do not move."""
    components: int = 256
    """Next states that make up the marginal."""
    marginal_horizon: int | None = None
    """Newest transitions from which the marginal is formed; all of replay by default."""
    marginal_forgetting: Literal["window", "exponential"] = "window"
    """How the others are forgotten where there is a horizon: at once, or by half with every such
    number of newer ones."""
    bandwidth: float | Literal["silverman", "perplexity"] = "silverman"
    """Width of the marginal's kernels."""
    refresh_interval: int = 20
    """Updates from one renewal of the marginal and of the statistics that whiten to the next."""
    member_per_row: bool = True
    """Let each transition train one model, and ask one for its bonus, in turn, instead of all."""

    learning_starts: int = 500
    """Steps of uniformly random actions before the first update."""
    replay_capacity: int = 1_000_000
    """Transitions kept; memory is taken only as they come."""
    log_interval: int = 500
    """Steps from one row of progress.csv to the next."""
    evaluation_interval: int = 2_000
    """Steps from one evaluation to the next; there is always one at the end."""
    evaluation_episodes: int = 10
    """Episodes of the deterministic policy in each evaluation."""
    checkpoint_interval: int = 5_000
    """Steps from one checkpoint to the next; there is always one at the end."""
    threads: int = 1
    """CPU threads of torch; two are often slower than one for networks of this size."""
    device: str = "cpu"
    """Where replay, updates and bonus live: cpu, or cuda."""
    compile: Literal["auto", "on", "off"] = "auto"
    """Compile the updates, which takes half a minute at the start; auto does so for long runs."""
    matmul_precision: Literal["auto", "highest", "high", "medium"] = "auto"
    """Torch's switch for float32 matrix products; auto takes the fastest that is float32."""

    @property
    def has_dial(self) -> bool:
        """Whether policy and critics are told the hunger."""
        return self.hunger_control in ("dial", "draws", "bandit", "battery")

    def __post_init__(self) -> None:
        """Reject what no run could be made of.

        Raises:
            ValueError: Naming the setting, the rule and the value.
        """
        for setting in fields(self):
            value = getattr(self, setting.name)
            if (
                setting.type is int
                and setting.name not in ("seed", "learning_starts")
                and value < 1
            ):
                raise ValueError(f"`{setting.name}` must be at least 1, got {value}.")
            if setting.type is float and not math.isfinite(value):
                raise ValueError(f"`{setting.name}` must be finite, got {value}.")
            if get_origin(setting.type) is Literal and value not in get_args(setting.type):
                known = get_args(setting.type)
                raise ValueError(f"`{setting.name}` must be one of {known}, got {value!r}.")
        device_type = self.device.split(":")[0]
        if device_type not in ("cpu", "cuda"):
            raise ValueError(f"`device` must be cpu or cuda, got {self.device!r}.")
        if device_type == "cuda" and not torch.cuda.is_available():
            raise ValueError(f"`device` must be one that torch can use here, got {self.device!r}.")
        for name in ("seed", "learning_starts"):
            if getattr(self, name) < 0:
                raise ValueError(f"`{name}` must not be negative, got {getattr(self, name)}.")
        if self.marginal_horizon is not None and self.marginal_horizon < 1:
            raise ValueError(
                f"`marginal_horizon` must be at least 1, got {self.marginal_horizon}."
            )
        if self.marginal_horizon is None and self.marginal_forgetting != "window":
            raise ValueError(
                "`marginal_forgetting` must be 'window' where no `marginal_horizon` is set, "
                f"got {self.marginal_forgetting!r}."
            )
        if self.exploration != "policy" and self.policy_modes > 1:
            raise ValueError(
                f"`exploration` must be 'policy' for {self.policy_modes} policy modes, "
                f"got {self.exploration!r}."
            )
        if self.curiosity_discount == 0 and self.bonus in SCORES_OUTCOMES:
            raise ValueError(
                f"`curiosity_discount` must be above 0 for the bonus {self.bonus}, which has no "
                "gradient in the action, got 0."
            )
        for name, control in (
            ("final_hunger", self.hunger_control),
            ("final_temperature", self.temperature_control),
        ):
            if control in ("linear", "exponential", "annealing") and getattr(self, name) <= 0:
                raise ValueError(f"`{name}` must be positive, got {getattr(self, name)}.")
        if self.has_dial and self.bonus == "none":
            raise ValueError(
                "`hunger_control` must be 'constant', 'linear' or 'exponential' without a bonus, "
                f"got {self.hunger_control!r}."
            )
        if self.update_to_data <= 0:
            raise ValueError(f"`update_to_data` must be positive, got {self.update_to_data}.")
