"""The learned dynamics: an ensemble of Gaussian networks that predict the next state."""

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from deep_curiosity.gaussians import DiagonalMixture
from deep_curiosity.nn.networks import StackedMLP, assign_rows, log_softmax_of_rest, restore_order
from deep_curiosity.nn.statistics import HASH_FACTOR, HASH_OFFSET, WHITENINGS, scrambled
from deep_curiosity.transitions import Transition, check_counts, check_moderate, check_positive

Whitening = Literal["moments", "robust", "saturating"]
Members = Literal["round_robin", "all"]
Features = Callable[[Tensor], Tensor]
"""What of observations `(batch, observation_dim)` is to be predicted, `(batch, features)`."""

LOG_VAR_RANGE = (-9.0, 2.0)  # of the whitened change: sharper is float noise, wider is ignorance
HELD_OUT_SHARE = 20  # one transition in twenty is never trained on
HELD_OUT_DECAY = 0.98  # of the held-out averages, for each batch
NUM_NODES = 32  # of the quadrature over a prediction in units that saturate


class DynamicsEnsemble(nn.Module):
    r"""Gaussian models `p_e(x'|x, a)` of the next state, stacked along a leading axis of members.

    Each member predicts the whitened change of state with its own variance. Predictions come out
    in whitened units of the observation, where `noise_floor` is the resolution of the agent's
    observations: no prediction is sharper than that. Where the next state is one of several, such
    as a ball caught or dropped, several `mixture_components` make every prediction a mixture
    (Bishop, "Mixture density networks", 1994).

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        hidden_dims: Width of every hidden layer.
        num_members: Number of models, at least 2: one alone cannot disagree.
        members: `"all"` trains every member on the batch by a bootstrap, and predicts by every
            member; `"round_robin"` gives each row to one member, `r % num_members`: an
            unbiased estimate for as many times less as there are members. A batch of fewer rows
            than members trains them all.
        mixture_components: Gaussians that make up each prediction.
        noise_floor: Standard deviation added to every prediction, in whitened units.
        whitening: Unit of observations and changes: `"moments"` is their mean and standard
            deviation; `"robust"` median and interquartile range, which no tail moves;
            `"saturating"` makes what is far from the usual count by its logarithm, see
            `SaturatingMoments`. Predictions are Gaussians of the whitened state: the two points
            one standard deviation from the predicted change are carried through the curves, and
            lie one standard deviation from the whitened state. A divergence of them is that of
            the states themselves, since the map can be inverted. What is not invariant is
            `noise_floor`: the resolution becomes coarser as the state lies further out.
        features: Maps observations to what of the next one is predicted, in units of its own; the
            whole observation when `None`. Inputs are whole observations either way. A module is
            kept in `state_dict`, and frozen for good, its layers in evaluation whatever `train` is
            told: what is predicted must not run away from the prediction. Another callable that
            learns must see to that itself. Both are called once here, in float32 on the CPU.

    Raises:
        TypeError: If `features` cannot be called, or gives no tensor of the dtype it was given.
        ValueError: If `num_members` is below 2, a count, dimension or the floor is not positive,
            a choice is unknown, or `features` gives no batch of vectors.
    """

    held_out_nll: Tensor
    held_out_coverage: Tensor

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        hidden_dims: Sequence[int] = (256, 256),
        num_members: int = 5,
        members: Members = "round_robin",
        mixture_components: int = 1,
        noise_floor: float = 0.05,
        whitening: Whitening = "saturating",
        features: Features | None = None,
    ) -> None:
        super().__init__()
        check_counts(
            observation_dim=observation_dim,
            action_dim=action_dim,
            num_members=num_members,
            mixture_components=mixture_components,
        )
        check_members(num_members, members)
        _check_units(noise_floor, whitening)
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.num_members = num_members
        self.members = members
        self.mixture_components = mixture_components
        self.noise_floor = float(noise_floor)
        self.features = features
        if isinstance(features, nn.Module):
            features.eval().requires_grad_(False)
        self.predicted_dim = (
            observation_dim if features is None else count_features(features, observation_dim)
        )
        self.network = StackedMLP(
            num_members,
            observation_dim + action_dim,
            hidden_dims,
            mixture_components * (2 * self.predicted_dim + 1) - 1,
        )
        if mixture_components > 1:
            self._separate_components(self.predicted_dim)
        self.observation_moments = WHITENINGS[whitening](observation_dim)
        self.change_moments = WHITENINGS[whitening](self.predicted_dim)
        self.feature_moments = (
            None if features is None else WHITENINGS[whitening](self.predicted_dim)
        )
        self.register_buffer("held_out_nll", torch.tensor(math.nan))
        self.register_buffer("held_out_coverage", torch.tensor(math.nan))

    def train(self, mode: bool = True) -> "DynamicsEnsemble":
        """Switch all layers but those of `features`, which stay in evaluation."""
        super().train(mode)
        if isinstance(self.features, nn.Module):
            self.features.eval()
        return self

    def forward(
        self,
        observation: Float[Tensor, "*#members batch observation_dim"],
        action: Float[Tensor, "*#members batch action_dim"],
    ) -> DiagonalMixture:
        """Whitened next state of each member, `(members, batch)` mixtures.

        Args:
            observation: One batch for all members, or a batch for each.
            action: Likewise, in [-1, 1].
        """
        change = self._whitened_change(observation, action)
        moments = self.feature_moments or self.observation_moments
        state = self._featured(observation).unsqueeze(-2)
        width = torch.exp(0.5 * change.log_var)
        ends = torch.stack([change.loc - width, change.loc + width])
        low, high = moments.normalize(state + self.change_moments.denormalize(ends))
        log_var = torch.log((0.5 * (high - low)).square() + self.noise_floor**2)
        return DiagonalMixture(0.5 * (low + high), log_var, change.log_weight)

    def round_robin(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> DiagonalMixture:
        """Whitened next state by one member for each row, `r % num_members`: `(1, batch)`."""
        batch = observation.shape[0]
        row, _ = assign_rows(batch, self.num_members, observation.device)
        loc, log_var, log_weight = self(observation[row], action[row])  # members rows ...
        return DiagonalMixture(
            restore_order(loc, batch).unsqueeze(0),
            restore_order(log_var, batch).unsqueeze(0),
            restore_order(log_weight, batch).unsqueeze(0),
        )

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Negative log-likelihood of the whitened change, in nats, summed over members.

        Every member weighs the batch by its own bootstrap (Poisson counts), or has its own share
        of the rows. One transition in twenty, chosen for good by its content, trains no member and
        is measured.
        """
        observation, action, _, next_observation, *_ = transition
        held_out = is_held_out(torch.cat([observation, action, next_observation], -1))
        num_trained = (~held_out).sum().clamp(min=1)
        # of fewer rows than models, some would never have any
        if self.members == "round_robin" and len(observation) >= self.num_members:
            row, once = assign_rows(observation.shape[0], self.num_members, observation.device)
            observation, action = observation[row], action[row]
            next_observation, held_out = next_observation[row], held_out[row]
            weight = (once & ~held_out) * float(self.num_members)
        else:
            ones = observation.new_ones(self.num_members, *held_out.shape)
            weight = torch.poisson(ones).masked_fill_(held_out, 0.0)
        change, target = self._change_and_target(observation, action, next_observation)
        nll = -change.log_prob(target)
        with torch.no_grad():
            self._track_held_out(nll, change.cdf(target), held_out)
        return (weight * nll).sum() / num_trained

    def negative_log_likelihood(self, transition: Transition) -> Float[Tensor, "members batch"]:
        """Negative log-likelihood of the whitened change under each member, in nats."""
        observation, action, _, next_observation, *_ = transition
        change, target = self._change_and_target(observation, action, next_observation)
        return -change.log_prob(target)

    def change(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> tuple[Float[Tensor, "members batch features"], Float[Tensor, "members batch features"]]:
        """Mean and variance of the change under each member, in units of the features.

        By quadrature, since units may saturate, in float64. What `noise_floor` adds is not in
        them.
        """
        prediction = self._whitened_change(observation, action)
        node, weight = (
            torch.from_numpy(each).to(prediction.loc.device)
            for each in np.polynomial.hermite_e.hermegauss(NUM_NODES)
        )
        weight = weight / weight.sum()
        points = prediction.component_samples(  # nodes members batch components features
            node[:, None, None, None, None].expand(NUM_NODES, *prediction.loc.shape)
        )
        change = self.change_moments.denormalize(points)
        share = weight[:, None, None, None] * prediction.log_weight.exp()  # nodes ... components
        mean = (share.unsqueeze(-1) * change).sum((0, -2))
        deviation = change - mean.unsqueeze(-2)
        return mean, (share.unsqueeze(-1) * deviation.square()).sum((0, -2))

    def sample_change(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        noise: Float[Tensor, "samples batch features"],
        choice: Float[Tensor, "samples batch"],
    ) -> Float[Tensor, "samples batch features"]:
        """Changes in units of the features, each from one component of one member.

        Args:
            observation: Where.
            action: What is done there, in [-1, 1].
            noise: Standard normal numbers.
            choice: Uniform numbers in [0, 1), by which member and component are chosen.
        """
        prediction = self._whitened_change(observation, action)
        components = prediction.loc.movedim(0, -3).flatten(-3, -2)  # batch members*components ...
        widths = prediction.log_var.movedim(0, -3).flatten(-3, -2)
        weight = prediction.log_weight.movedim(0, -2).flatten(-2).exp() / self.num_members
        threshold = weight.cumsum(-1).expand(len(choice), -1, -1).contiguous()
        chosen = torch.searchsorted(threshold, choice.unsqueeze(-1), right=True)
        chosen = chosen.clamp(max=weight.shape[-1] - 1).unsqueeze(-1)  # samples batch 1 1
        loc = torch.take_along_dim(components.unsqueeze(0), chosen, dim=-2).squeeze(-2)
        log_var = torch.take_along_dim(widths.unsqueeze(0), chosen, dim=-2).squeeze(-2)
        return self.change_moments.denormalize(loc + torch.exp(0.5 * log_var) * noise)

    @torch.no_grad()
    def observe(self, transition: Transition) -> None:
        """Update the statistics that whiten observations, features and changes.

        Raises:
            ValueError: If a feature is NaN, infinite or beyond 1e14. The statistics are then as
                before.
        """
        before = self._featured(transition.observation)
        after = self._featured(transition.next_observation)
        if self.feature_moments is not None:
            check_moderate(features=torch.cat([before, after]))
            self.feature_moments.update(before)
        self.observation_moments.update(transition.observation)
        self.change_moments.update(after - before)

    @torch.no_grad()
    def check_features(self, observation: Float[Tensor, "batch observation_dim"]) -> None:
        """Reject observations whose features cannot be computed with.

        Raises:
            ValueError: If a feature is NaN, infinite or beyond 1e14.
        """
        self._featured(observation)

    def metrics(self) -> dict[str, Tensor]:
        """Held-out negative log-likelihood in nats, and coverage of the 90 % interval."""
        return {
            "model_held_out_nll": self.held_out_nll.clone(),
            "model_coverage_90": self.held_out_coverage.clone(),
        }

    def _featured(
        self, observation: Float[Tensor, "*batch observation_dim"]
    ) -> Float[Tensor, "*batch features"]:
        """What of observations is predicted; looked at, as a function may make NaN of anything.

        Raises:
            ValueError: If a feature is NaN, infinite or beyond 1e14.
        """
        if self.features is None:
            return observation
        features = self.features(observation.flatten(0, -2))
        if not (torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active()):
            check_moderate(features=features)
        return features.unflatten(0, observation.shape[:-1])

    @torch.no_grad()
    def _separate_components(self, dim: int) -> None:
        """Begin with components apart, at quantiles of a standard Gaussian, the same everywhere.

        So none starves another, and no two change places between one action and the next. Each
        member and feature pairs them by a sign of its own.
        """
        level = (torch.arange(self.mixture_components) + 0.5) / self.mixture_components
        sign = 2.0 * torch.randint(2, (self.num_members, 1, 1, dim)) - 1
        quantile = sign * torch.special.ndtri(level).unsqueeze(-1)
        for parameter, start in zip(
            self.network.layers[-1].parameters(), (0, quantile), strict=True
        ):
            shape = parameter[..., : 2 * self.mixture_components * dim]
            shape.unflatten(-1, (self.mixture_components, -1))[..., :dim] = start

    def _change_and_target(
        self, observation: Tensor, action: Tensor, next_observation: Tensor
    ) -> tuple[DiagonalMixture, Float[Tensor, "*#members batch features"]]:
        """Predicted and true change, both whitened."""
        prediction = self._whitened_change(observation, action)
        change = self._featured(next_observation) - self._featured(observation)
        if self.features is not None:
            change = change.detach()  # features that learn are none of the models' business
        return prediction, self.change_moments.normalize(change)

    def _whitened_change(self, observation: Tensor, action: Tensor) -> DiagonalMixture:
        pair = torch.cat([self.observation_moments.normalize(observation), action], dim=-1)
        output = self.network(pair)
        dim = self.predicted_dim
        shape, logits = output.tensor_split([2 * self.mixture_components * dim], dim=-1)
        loc, raw_log_var = shape.unflatten(-1, (self.mixture_components, 2 * dim)).chunk(2, dim=-1)
        return DiagonalMixture(
            loc, soft_clamp(raw_log_var, *LOG_VAR_RANGE), log_softmax_of_rest(logits)
        )

    def _track_held_out(self, nll: Tensor, quantile: Tensor, held_out: Tensor) -> None:
        """Fold the held-out rows of a batch into running averages; no row changes nothing."""
        weight = held_out.expand_as(nll).to(nll.dtype)
        weight = weight / weight.sum()
        inside = ((quantile > 0.05) & (quantile < 0.95)).to(nll.dtype).mean(-1)
        for average, value in ((self.held_out_nll, nll), (self.held_out_coverage, inside)):
            latest = (value * weight).sum()
            blended = torch.where(
                average.isnan(), latest, average.lerp(latest, 1 - HELD_OUT_DECAY)
            )
            average.copy_(torch.where(blended.isnan(), average, blended))


def _check_units(noise_floor: float, whitening: str) -> None:
    """Reject a floor that is no width, and a whitening that there is not."""
    if whitening not in [*WHITENINGS]:  # a list: what cannot be hashed is none either
        choices = ", ".join(WHITENINGS)
        raise ValueError(f"`whitening` must be one of {choices}, got {whitening!r}.")
    check_positive(noise_floor=noise_floor)


def check_members(num_members: int, members: str) -> None:
    """Reject ensembles that cannot be.

    Raises:
        ValueError: If there are fewer than 2 models, or it is unknown which are used.
    """
    if num_members < 2:
        raise ValueError(
            f"`num_members` must be at least 2 to measure disagreement, got {num_members}."
        )
    if members not in get_args(Members):
        raise ValueError(f"`members` must be 'round_robin' or 'all', got {members!r}.")


@torch.no_grad()
def count_features(features: Features, observation_dim: int) -> int:
    """Length of what `features` makes of an observation, found by calling it.

    Raises:
        TypeError: If it cannot be called, or makes no tensor of the dtype of the observations.
        ValueError: If it makes no batch of vectors.
    """
    if not callable(features):
        raise TypeError(f"`features` must be callable, got {features!r}.")
    observation = torch.zeros(2, observation_dim)
    value: object = features(observation)
    if not isinstance(value, Tensor) or value.dtype != observation.dtype:
        kind = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"`features` must return a tensor of {observation.dtype}, got {kind}.")
    if value.ndim != 2 or value.shape[0] != 2 or value.shape[1] == 0:
        raise ValueError(
            f"`features` must map observations (2, {observation_dim}) to (2, features), "
            f"got {tuple(value.shape)}."
        )
    return value.shape[1]


def soft_clamp(value: Float[Tensor, "*batch"], low: float, high: float) -> Float[Tensor, "*batch"]:
    """Squeeze into an interval by a slope that never vanishes: a stray log variance returns."""
    value = high - softplus(high - value)
    return low + softplus(value - low)


def is_held_out(row: Float[Tensor, "batch dim"]) -> Bool[Tensor, " batch"]:
    """Mark one row in twenty by a hash of its bits: the same rows in every batch and every run."""
    bits = row.float().contiguous().view(torch.int32).long() + HASH_OFFSET
    # two products: triton would keep the sum of the factors in 32 bits
    mixed = bits * HASH_FACTOR + bits * (2 * torch.arange(bits.shape[-1], device=bits.device))
    mixed = mixed.sum(-1)
    return (scrambled(mixed) >> 32) % HELD_OUT_SHARE == 0
