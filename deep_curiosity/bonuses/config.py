"""Settings of each bonus, with the defaults that all of them were studied with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.baselines import (
    ConstantBonus,
    DisagreementBonus,
    HashCountBonus,
    ICMBonus,
    InformationGainBonus,
    NearestNeighboursBonus,
    RNDBonus,
)
from deep_curiosity.bonuses.curiosity import CuriosityBonus, check_entries
from deep_curiosity.bonuses.decomposition import coefficients_of
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble, Whitening
from deep_curiosity.bonuses.marginal import TARGET_PERPLEXITY, Bandwidth, NextStateMarginal
from deep_curiosity.configuration import LEAST_LEARNING_RATE, Group, setting
from deep_curiosity.nn.networks import Adam

if TYPE_CHECKING:
    from deep_curiosity.bonuses.dynamics import Features
    from deep_curiosity.replay import ReplayBuffer
    from deep_curiosity.transitions import Transition

Sizes = Sequence[int]
MOST_WEIGHT = 1e6  # of a standardised bonus, whose critics and their targets stay float32
FINEST, COARSEST = 1e-6, 1e3  # of what is in standard deviations: float32 resolves no finer


@dataclass(frozen=True)
class BonusConfig(Group, ABC):
    """What all bonuses have in common: a name, and a class to make."""

    kind: ClassVar[str]
    """Name of the bonus, as on the command line."""
    scores_outcomes: ClassVar[bool] = False
    """Whether the bonus scores what has happened, and so no action that was not taken."""

    @abstractmethod
    def make(self, observation_dim: int, action_dim: int, hidden_dims: Sizes) -> Bonus | None:
        """Build the bonus, its networks with these hidden layers; `None` for no bonus at all."""

    def sample_visited(self, replay: ReplayBuffer, batch_size: int) -> Transition | None:
        """Transitions of late, for a bonus that depends on them; `None` for others."""
        return None

    def make_optimizer(self, bonus: Bonus | None) -> Adam | None:
        """Optimiser of the networks of the bonus, where it has any."""
        return None

    def about(self, entries: tuple[int, ...]) -> BonusConfig:
        """The same bonus about some entries of the observation, if it can be and is not yet."""
        return self

    def about_newest(self, observation_dim: int) -> BonusConfig:
        """The same bonus with entries of an observation found in a window that ends with it."""
        return self


@dataclass(frozen=True)
class NoBonus(BonusConfig):
    """Plain soft actor-critic."""

    kind = "none"

    def make(self, observation_dim: int, action_dim: int, hidden_dims: Sizes) -> None:
        """Nothing."""


@dataclass(frozen=True)
class ConstantConfig(BonusConfig):
    """The same bonus at every step: a control without information."""

    kind = "constant"

    weight: float = setting(0.1, name="bonus_weight", at_least=0, at_most=MOST_WEIGHT)
    """The bonus itself."""

    def make(self, observation_dim: int, action_dim: int, hidden_dims: Sizes) -> Bonus:
        """The control."""
        return ConstantBonus(self.weight)


@dataclass(frozen=True)
class WeightedConfig(BonusConfig):
    """What every standardised bonus has."""

    weight: float = setting(0.1, name="bonus_weight", at_least=0, at_most=MOST_WEIGHT)
    """Factor of the standardised bonus; the first one where it is tuned."""
    model_learning_rate: float = setting(1e-3, above=0, at_least=LEAST_LEARNING_RATE, at_most=1)
    """Learning rate of the networks of the bonus."""
    refresh_interval: int = 20
    """Updates from one renewal of the statistics, and of the marginal, to the next."""

    def make_optimizer(self, bonus: Bonus | None) -> Adam | None:
        """Adam over what learns, if anything does."""
        parameters = [] if bonus is None else [p for p in bonus.parameters() if p.requires_grad]
        return Adam(parameters, self.model_learning_rate) if parameters else None


@dataclass(frozen=True)
class BaselineConfig(WeightedConfig):
    """A baseline, which is made from its own settings."""

    bonus_class: ClassVar[type[Bonus]]
    has_networks: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse a learning rate of networks that there are not."""
        super().__post_init__()
        usual = type(self).model_learning_rate
        if not self.has_networks and self.model_learning_rate != usual:
            raise ValueError(
                f"`model_learning_rate` must be left out with {self.kind}, which has no networks, "
                f"got {self.model_learning_rate}."
            )

    def make(self, observation_dim: int, action_dim: int, hidden_dims: Sizes) -> Bonus:
        """The bonus of this name."""
        options = {
            each.name: getattr(self, each.name)
            for each in fields(self)
            if each.name != "model_learning_rate"
        }
        if self.has_networks:
            options["hidden_dims"] = hidden_dims
        return self.bonus_class(observation_dim, action_dim, **options)


@dataclass(frozen=True)
class DisagreementConfig(BaselineConfig):
    """Models that predict different things."""

    kind, bonus_class = "disagreement", DisagreementBonus

    num_members: int = setting(5, at_least=2, at_most=1_000)
    """Models in the ensemble."""


@dataclass(frozen=True)
class InformationGainConfig(BaselineConfig):
    """What an outcome would tell about the models, its weight tuned."""

    kind, bonus_class = "information-gain", InformationGainBonus

    num_members: int = setting(5, at_least=2, at_most=1_000)
    """Models in the ensemble."""
    noise_std: float = setting(1e-3, above=0, at_least=FINEST, at_most=COARSEST)
    """Standard deviation of the outcome's noise, in whitened units."""


@dataclass(frozen=True)
class RNDConfig(BaselineConfig):
    """Next states at which a random network is not yet known."""

    kind, bonus_class, scores_outcomes = "rnd", RNDBonus, True

    random_features: int = setting(512, at_most=2**16)
    """Outputs of the random network."""


@dataclass(frozen=True)
class ICMConfig(BaselineConfig):
    """Next states that were predicted badly, in learned features."""

    kind, bonus_class, scores_outcomes = "icm", ICMBonus, True

    feature_dim: int = setting(32, at_most=2**14)
    """Length of the learned features."""


@dataclass(frozen=True)
class NearestNeighboursConfig(BaselineConfig):
    """Next states far from those remembered."""

    kind, bonus_class, scores_outcomes = "nearest-neighbours", NearestNeighboursBonus, True
    has_networks = False

    neighbours: int = 12
    """Neighbours over which the distance is averaged."""
    memory: int = 2048
    """States remembered."""

    def __post_init__(self) -> None:
        """Refuse more neighbours than are remembered."""
        super().__post_init__()
        if self.neighbours > self.memory:
            raise ValueError(
                f"`neighbours` must be at most `memory` ({self.memory}), got {self.neighbours}."
            )


@dataclass(frozen=True)
class HashCountConfig(BaselineConfig):
    """Next states whose code is rare."""

    kind, bonus_class, scores_outcomes = "hash-count", HashCountBonus, True
    has_networks = False

    bits: int = setting(32, at_most=62)
    """Length of a code."""

    def sample_visited(self, replay: ReplayBuffer, batch_size: int) -> Transition | None:
        """The transitions since the last renewal, so that every visit is counted once."""
        return replay.take_new()


@dataclass(frozen=True)
class DynamicsConfig(Group):
    """The ensemble that predicts the next state."""

    num_members: int = setting(5, at_least=2, at_most=1_000)
    """Models in the ensemble."""
    members: Literal["round_robin", "all"] = "round_robin"
    """Train and score each transition by one model, in round-robin order, or by all of them."""
    mixture_components: int = setting(1, name="model_mixture_components", at_most=100)
    """Gaussians that make up a prediction; a next state that is one of two needs two."""
    noise_floor: float = setting(0.05, above=0, at_least=FINEST, at_most=COARSEST)
    """Resolution of what is observed, in standard deviations of the observation."""
    whitening: Whitening = "saturating"
    """Unit of the observation's entries: moments is their standard deviation; robust their
    interquartile range, which heavy tails do not move; saturating besides counts what is far from
    the usual by its logarithm, so that ever more speed does not pay for ever."""


@dataclass(frozen=True)
class MarginalConfig(Group):
    """The density of usual next states."""

    components: int = setting(2048, at_least=2, at_most=10**5)
    """Next states that make up the marginal."""
    bandwidth: Bandwidth = setting("silverman", above=0, at_least=FINEST, at_most=COARSEST)
    """Width of the marginal's kernels, in standard deviations of the components; silverman is his
    rule, overlap the same until too few overlap, as in many dimensions, and then wider."""
    half_life: float | None = setting(10.0, name="marginal_half_life", above=0, at_most=1e6)
    """Episodes after which a state that was visited counts half; none forgets nothing, so that
    p(x') is that of all replay."""

    def __post_init__(self) -> None:
        """Refuse a perplexity that so few components cannot have."""
        super().__post_init__()
        if self.bandwidth == "perplexity" and self.components <= TARGET_PERPLEXITY:
            raise ValueError(
                f"`components` must be above {TARGET_PERPLEXITY:g} where `bandwidth` is "
                f"perplexity, got {self.components}."
            )


@dataclass(frozen=True)
class CuriosityConfig(WeightedConfig):
    """Leading away from where one usually ends up: the paper's curiosity."""

    kind = "curiosity"

    tune_weight: float | Literal["past"] | None = setting(
        None, name="tune_bonus_weight", at_least=-1e6, at_most=1e6
    )
    """Tune the weight: it rises while the policy's mean score is below a goal and falls while it
    is above. `past` takes what it scored of late as the goal, a number so many nats."""
    parts: dict[str, float] = setting({}, name="bonus_parts", at_least=-1e6, at_most=1e6)
    """Weights of what curiosity is made of, instead of D as a whole: predictive_power,
    information_gain, negative_entropy, cross_entropy; such as: information_gain 1"""
    features: tuple[int, ...] = setting((), at_least=-(10**6), at_most=10**6)
    """Entries of the observation that curiosity is about, from the end where negative, such as 0 1
    for a position; all by default, or with a frame stack the two newest observations."""
    features_of: Literal["newest", "window"] = "newest"
    """With a frame stack, what `features` are entries of: the newest observation; or the window of
    all that are shown together, the oldest first, with the actions between them."""
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    marginal: MarginalConfig = field(default_factory=MarginalConfig)

    def __post_init__(self) -> None:
        """Refuse parts that leave nothing, and what would do nothing."""
        super().__post_init__()
        try:
            coefficients_of(self.parts or None)
        except ValueError as error:
            raise ValueError(f"`bonus_parts` cannot be weighed: {error}") from error
        if len(set(self.features)) < len(self.features):
            raise ValueError(f"`features` must name different entries, got {list(self.features)}.")
        if self.weight == 0 and self.tune_weight is not None:
            raise ValueError(
                "`bonus_weight` must be positive where `tune_bonus_weight` is to move it, got 0."
            )

    def make(
        self,
        observation_dim: int,
        action_dim: int,
        hidden_dims: Sizes,
        encoder: Features | None = None,
    ) -> CuriosityBonus:
        """The bonus with its dynamics and marginal.

        Args:
            observation_dim: Length of an observation.
            action_dim: Length of an action.
            hidden_dims: Width of every hidden layer of the models.
            encoder: Function from observations to what of them is predicted.
        """
        dynamics = DynamicsEnsemble(
            observation_dim,
            action_dim,
            hidden_dims=hidden_dims,
            features=encoder,
            **vars(self.dynamics),
        )
        entries = check_entries(self.features, dynamics.predicted_dim) if self.features else None
        marginal = NextStateMarginal(
            dynamics.predicted_dim if entries is None else len(entries),
            components=self.marginal.components,
            bandwidth=self.marginal.bandwidth,
        )
        return CuriosityBonus(
            dynamics,
            marginal,
            weight=self.weight,
            refresh_interval=self.refresh_interval,
            entries=entries,
            parts=self.parts or None,
            tune_weight=self.tune_weight,
        )

    def about(self, entries: tuple[int, ...]) -> CuriosityConfig:
        """Curiosity about some entries of the observation, unless others were chosen."""
        return self if self.features else replace(self, features=entries)

    def about_newest(self, observation_dim: int) -> CuriosityConfig:
        """The same entries from the end of a window that ends with the observation.

        Raises:
            ValueError: If one is no entry of the observation, or named twice.
        """
        if self.features_of == "window" or not self.features:
            return self
        entries = check_entries(self.features, observation_dim)
        return replace(self, features=tuple(entry - observation_dim for entry in entries))

    def sample_visited(self, replay: ReplayBuffer, batch_size: int) -> Transition | None:
        """Transitions of late, as the marginal forgets; the batch itself where it does not."""
        if self.marginal.half_life is None:
            return None
        half_life = max(1, round(self.marginal.half_life * replay.mean_episode_length()))
        return replay.sample_fading(batch_size, half_life=half_life)


BONUS_CONFIGS: dict[str, type[BonusConfig]] = {
    config.kind: config
    for config in (
        CuriosityConfig,
        DisagreementConfig,
        InformationGainConfig,
        RNDConfig,
        ICMConfig,
        NearestNeighboursConfig,
        HashCountConfig,
        ConstantConfig,
        NoBonus,
    )
}
"""Settings of each bonus by its name; `none` is plain soft actor-critic."""


def bonus_config(kind: str) -> Any:
    """Default settings of a bonus.

    Raises:
        ValueError: If the name is unknown.
    """
    if kind not in BONUS_CONFIGS:
        raise ValueError(f"`bonus` must be one of {', '.join(BONUS_CONFIGS)}, got {kind!r}.")
    return BONUS_CONFIGS[kind]()
