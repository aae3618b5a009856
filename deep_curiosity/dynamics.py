"""The learned world: an ensemble of Gaussian networks that predict the next state."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from deep_curiosity.networks import StackedMLP
from deep_curiosity.normalization import RunningMoments
from deep_curiosity.transitions import Transition

LOG_VAR_RANGE = (-9.0, 2.0)  # of the whitened change: sharper is float noise, wider is ignorance
HELD_OUT_SHARE = 20  # one transition in twenty is never trained on
HASH_OFFSET = 0x9E3779B9  # so that zeros count; the golden ratio's digits
HASH_FACTOR = 0x5851F42D4C957F2D  # odd, of Knuth's generator MMIX
HELD_OUT_DECAY = 0.98  # of the held-out averages, for each batch
NINETY_PERCENT = 1.6449  # half-width of a standard Gaussian's central 90 % interval


class Prediction(NamedTuple):
    """Gaussian next states of each member, in whitened units of the observation."""

    loc: Float[Tensor, "members batch observation_dim"]
    log_var: Float[Tensor, "members batch observation_dim"]


class DynamicsEnsemble(nn.Module):
    r"""Gaussian models `p_e(x'|x, a)` of the next state, stacked along a leading axis of members.

    Each member predicts the whitened change of state with its own variance. Predictions come out
    in whitened units of the observation, where `noise_floor` is the resolution at which the agent
    sees: no prediction is sharper than that.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        members: Number of models, at least 2: one alone cannot disagree.
        hidden_dims: Width of every hidden layer.
        noise_floor: Standard deviation added to every prediction, in whitened units.

    Raises:
        ValueError: If `members` is below 2 or a dimension or the floor is not positive.
    """

    held_out_nll: Tensor
    held_out_coverage: Tensor

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        members: int = 5,
        hidden_dims: Sequence[int] = (256, 256),
        noise_floor: float = 0.05,
    ) -> None:
        super().__init__()
        if members < 2:
            raise ValueError(
                f"`members` must be at least 2 to measure disagreement, got {members}."
            )
        for name, dim in (("observation_dim", observation_dim), ("action_dim", action_dim)):
            if dim < 1:
                raise ValueError(f"`{name}` must be at least 1, got {dim}.")
        if not 0 < noise_floor < math.inf:
            raise ValueError(f"`noise_floor` must be positive and finite, got {noise_floor}.")
        self.members = members
        self.noise_floor = noise_floor
        self.network = StackedMLP(
            members, observation_dim + action_dim, hidden_dims, 2 * observation_dim
        )
        self.observation_moments = RunningMoments(observation_dim)
        self.change_moments = RunningMoments(observation_dim)
        self.register_buffer("held_out_nll", torch.tensor(math.nan))
        self.register_buffer("held_out_coverage", torch.tensor(math.nan))

    def forward(
        self,
        observation: Float[Tensor, "*#members batch observation_dim"],
        action: Float[Tensor, "*#members batch action_dim"],
    ) -> Prediction:
        """Whitened next state of each member, for one shared batch or for a batch of each."""
        change = self._whitened_change(observation, action)
        scale = self.observation_moments.scale
        ratio = self.change_moments.scale / scale
        shift = self.observation_moments.normalize(observation + self.change_moments.mean)
        log_floor = torch.full_like(change.log_var, 2 * math.log(self.noise_floor))
        log_var = torch.logaddexp(change.log_var + 2 * ratio.log(), log_floor)
        return Prediction(shift + ratio * change.loc, log_var)

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Negative log-likelihood of the whitened change, in nats, summed over members.

        Every member weighs the batch by its own bootstrap (Poisson counts). One transition in
        twenty, chosen for good by its content, is held out of every bootstrap and measured.
        """
        nll, standard_error = self.negative_log_likelihood(transition)
        held_out = is_held_out(
            torch.cat([transition.observation, transition.action, transition.next_observation], -1)
        )
        with torch.no_grad():
            weight = torch.poisson(torch.ones_like(nll)).masked_fill_(held_out, 0.0)
            self._track_held_out(nll, standard_error, held_out)
        return (weight * nll).sum() / (~held_out).sum().clamp(min=1)

    def negative_log_likelihood(
        self, transition: Transition
    ) -> tuple[Float[Tensor, "members batch"], Float[Tensor, "members batch observation_dim"]]:
        """Negative log-likelihood in nats of the whitened change, and its standardised error."""
        prediction = self._whitened_change(transition.observation, transition.action)
        change = transition.next_observation - transition.observation
        target = self.change_moments.normalize(change)
        standard_error = (target - prediction.loc) * torch.exp(-0.5 * prediction.log_var)
        nll = 0.5 * (standard_error.square() + prediction.log_var + math.log(2 * math.pi)).sum(-1)
        return nll, standard_error

    def observe(self, transition: Transition) -> None:
        """Update the statistics that whiten observations and changes."""
        self.observation_moments.update(transition.observation)
        self.change_moments.update(transition.next_observation - transition.observation)

    def metrics(self) -> dict[str, Tensor]:
        """Held-out negative log-likelihood in nats, and coverage of the 90 % interval."""
        return {
            "model_held_out_nll": self.held_out_nll.clone(),
            "model_coverage_90": self.held_out_coverage.clone(),
        }

    def _whitened_change(self, observation: Tensor, action: Tensor) -> Prediction:
        features = torch.cat([self.observation_moments.normalize(observation), action], dim=-1)
        loc, raw_log_var = self.network(features).chunk(2, dim=-1)
        return Prediction(loc, soft_clamp(raw_log_var, *LOG_VAR_RANGE))

    def _track_held_out(self, nll: Tensor, standard_error: Tensor, held_out: Tensor) -> None:
        """Fold the held-out rows of a batch into running averages; no row changes nothing."""
        weight = held_out.to(nll.dtype) / held_out.sum()
        inside = (standard_error.abs() < NINETY_PERCENT).to(nll.dtype).mean(-1)
        for average, value in ((self.held_out_nll, nll), (self.held_out_coverage, inside)):
            latest = (value.mean(0) * weight).sum()
            blended = torch.where(
                average.isnan(), latest, average.lerp(latest, 1 - HELD_OUT_DECAY)
            )
            average.copy_(torch.where(blended.isnan(), average, blended))


def soft_clamp(value: Float[Tensor, "*batch"], low: float, high: float) -> Float[Tensor, "*batch"]:
    """Squeeze into an interval by a slope that never vanishes: a stray log variance returns."""
    value = high - softplus(high - value)
    return low + softplus(value - low)


def is_held_out(row: Float[Tensor, "batch dim"]) -> Bool[Tensor, " batch"]:
    """Mark one row in twenty by a hash of its bits: the same rows in every batch and every run."""
    bits = row.float().contiguous().view(torch.int32).long() + HASH_OFFSET
    mixed = (bits * (2 * torch.arange(bits.shape[-1], device=bits.device) + HASH_FACTOR)).sum(-1)
    for _ in range(2):  # round numbers have empty low bits: bring the high ones down
        mixed = (mixed ^ (mixed >> 29)) * HASH_FACTOR
    return (mixed >> 32) % HELD_OUT_SHARE == 0
