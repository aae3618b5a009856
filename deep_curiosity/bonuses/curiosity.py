"""Curiosity as predictive power: how far an action leads from where one usually ends up."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.distributions import drawn, gaussian_log_prob
from deep_curiosity.gaussians import jensen_shannon_lower, jensen_shannon_upper
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble, Features, Prediction
from deep_curiosity.bonuses.marginal import NextStateMarginal
from deep_curiosity.nn.mlp import frozen, restore_order, assign_rows
from deep_curiosity.nn.normalization import Standardization
from deep_curiosity.nn.every import Every
from deep_curiosity.bonuses.decomposition import (
    DIVERGENCE,
    coefficients_of,
    conditional_entropy,
    information_gain,
)
from deep_curiosity.transitions import (
    Transition,
    check_batch,
    check_counts,
    check_transition,
)
from deep_curiosity.bonuses.weight_tuning import TunedWeight

NUM_PROBES = 64  # pairs kept from the last refresh, on which the metrics are computed
NUM_SAMPLES = 16  # draws from each member's prediction when the bonus is taken apart
NUM_INFORMATION_SAMPLES = 2  # draws from each of the marginal's components, which are many


class Decomposition(NamedTuple):
    """The raw divergence of each pair and what it is made of, in nats.

    `total = predictive_power + information_gain = cross_entropy - conditional_entropy`.
    """

    predictive_power: Float[Tensor, " batch"]
    information_gain: Float[Tensor, " batch"]
    total: Float[Tensor, " batch"]
    cross_entropy: Float[Tensor, " batch"]
    conditional_entropy: Float[Tensor, " batch"]


class CuriosityBonus(Bonus):
    r"""Divergence of an action's next state from the usual next state, equation (18).

    .. math:: D(x, a) = \frac{1}{E} \sum_e D_{KL}[p_e(x' | x, a) \,\|\, p_\pi(x')]

    It is returned standardised, `weight * (D - mean) / std`, with running statistics. Pure noise
    earns nothing once its variance is learned: `D` contains minus the conditional entropy.

    `parts` rewards what `D` is made of by weights of its own: `predictive_power`, the divergence
    of the members' mean prediction, and `information_gain`, what the next state would tell about
    which member is right, add up to `D`; so do `cross_entropy`, how rare the next state is, and
    `negative_entropy`, how sure. All are closed forms: `D` and the cross-entropy upper bounds, the
    gain a lower bound (see `parts.information_gain`), and predictive power what is left of `D`.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        weight: Factor of the standardised bonus. 0.1 suffices where there is no other signal and
            does no harm where there is one.
        center: Subtract the running mean. Ending an episode is then worth as much as an average
            step: neither bait nor threat.
        scale: Divide by the running standard deviation; without it the bonus is in nats.
        members: Number of models in the ensemble, at least 2.
        outcomes: Gaussians that make up each prediction: more than one where the next state is one
            of several, and not merely uncertain.
        hidden_dims: Width of every hidden layer of the models.
        noise_floor: Resolution at which the agent sees, in standard deviations of the observation.
        components: Number of next states that make up the marginal.
        bandwidth: Width of the marginal's kernels, see `NextStateMarginal`.
        target_perplexity: Read only by `bandwidth="perplexity"`.
        refresh_interval: Calls of `observe` from one renewal of statistics and marginal to the
            next; the calls between do nothing.
        member_per_row: Ask one member for each pair, in turn, instead of the mean of them all, and
            let each transition train one: an unbiased estimate for as many times less as there
            are members. A pair's bonus then depends on its place in the batch. Where `parts`
            need the information gain, all members are asked all the same.
        whitening: Unit of the observation's features: mean and standard deviation, or `"robust"`,
            median and interquartile range. Where a feature has heavy tails, a standard deviation
            grows with them, and the noise floor and the bandwidth become coarse everywhere.
        features: What of the next state is of interest: entries of the observation by their index,
            from the end where negative, or a function or module from observations to features; all
            when `None`. Entries are predicted with the others, and `D` is their marginal's, which
            diagonal Gaussians make exact; of a function, the models predict the value itself (see
            `DynamicsEnsemble`), and a module is frozen for good.
        parts: Weight of each part of `D` that is rewarded, by name; `D` itself when `None`.
        tune_weight: Let the weight follow what the policy earns where `observe` is given it, see
            `TunedWeight`: `"past"` presses for curiosity while the policy of now earns less than
            those of late, in standard deviations of the score; a number while its mean score is
            below so many nats. `None` leaves the weight as it is.
        weight_learning_rate: Step size of the log weight, for each call of `observe`.

    Raises:
        ValueError: If a count or a scale is out of range, a part unknown, or a feature no entry.

    Reference: Still & Precup, "An information-theoretic approach to curiosity-driven reinforcement
    learning" (2012), equations (18)-(20).
    """

    entries: Tensor | None
    probe_observation: Tensor
    probe_action: Tensor

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        weight: float = 0.1,
        center: bool = True,
        scale: bool = True,
        members: int = 5,
        outcomes: int = 1,
        hidden_dims: Sequence[int] = (256, 256),
        noise_floor: float = 0.05,
        components: int = 256,
        bandwidth: float | Literal["silverman", "perplexity"] = "silverman",
        target_perplexity: float = 8.0,
        refresh_interval: int = 10,
        member_per_row: bool = False,
        whitening: Literal["moments", "robust"] = "moments",
        features: Sequence[int] | Features | None = None,
        parts: Mapping[str, float] | None = None,
        tune_weight: Literal["past"] | float | None = None,
        weight_learning_rate: float = 3e-4,
    ) -> None:
        super().__init__()
        check_counts(refresh_interval=refresh_interval)
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.member_per_row = member_per_row
        self.coefficients = coefficients_of(parts)
        self.dynamics = DynamicsEnsemble(
            observation_dim,
            action_dim,
            members=members,
            outcomes=outcomes,
            hidden_dims=hidden_dims,
            noise_floor=noise_floor,
            member_per_row=member_per_row,
            whitening=whitening,
            features=features if callable(features) else None,
        )
        entries = (
            None
            if features is None or callable(features)
            else torch.tensor(entries_of(features, observation_dim))
        )
        self.register_buffer("entries", entries, persistent=False)
        self.marginal = NextStateMarginal(
            self.dynamics.predicted_dim if entries is None else len(entries),
            components=components,
            bandwidth=bandwidth,
            target_perplexity=target_perplexity,
        )
        self.standardization = Standardization(weight=weight, center=center, scale=scale)
        self.tuned_weight = (
            None
            if tune_weight is None
            else TunedWeight(
                goal=None if tune_weight == "past" else tune_weight,
                learning_rate=weight_learning_rate,
            )
        )
        self.every = Every(refresh_interval)
        self.register_buffer("probe_observation", torch.zeros(NUM_PROBES, observation_dim))
        self.register_buffer("probe_action", torch.zeros(NUM_PROBES, action_dim))

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """Weighted, standardised bonus of each pair, differentiable in both; models stay fixed.

        Raises:
            RuntimeError: If nothing has been observed yet.
        """
        bonus = self.standardization(self._estimate(observation, action))
        return bonus if self.tuned_weight is None else self.tuned_weight.factor * bonus

    def nats(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> Float[Tensor, " batch"]:
        """Raw divergence of each pair, the upper bound averaged over members, in nats."""
        return self._upper(self._predict(observation, action)).mean(0)

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Negative log-likelihood of the ensemble, in nats; see `DynamicsEnsemble.loss`.

        Raises:
            TypeError: If a field has the wrong kind.
            ValueError: If a field has the wrong shape or holds NaN or infinity.
        """
        self._check_transition(transition)
        return self.dynamics.loss(transition)

    @torch.no_grad()
    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        """Update statistics and marginal, at every `refresh_interval`-th call.

        Args:
            transition: A batch from replay, or the newest rollout.
            policy: Draws fresh actions at the batch's observations for the marginal, so that it
                follows the policy of now; `None` takes the actions that were taken.
            visited: Where the marginal's components start from, if not at the batch: the newest
                transitions, say, for a marginal of where one usually ends up of late. All
                statistics stay those of the batch.

        Raises:
            TypeError: If a field has the wrong kind.
            ValueError: If a field has the wrong shape or holds NaN or infinity. The statistics
                are then as before.
        """
        if self.passes():
            return
        self._check_transition(transition)
        fresh = transition if visited is None else visited
        if policy is not None:
            fresh = fresh._replace(action=policy(fresh.observation))
        if fresh is not transition:
            self._check_transition(fresh)
        self.dynamics.observe(transition)
        self._refresh(transition, fresh)
        if self.tuned_weight is not None and policy is not None:
            self._tune_weight(self.tuned_weight, fresh)
        self.every.count()

    def passes(self) -> bool:
        """Whether the next batch would only be counted, and then count it."""
        return self.every.passes()

    def decompose(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        noise: Float[Tensor, "samples members batch outcomes features"] | None = None,
    ) -> Decomposition:
        r"""The divergence of each pair and its parts, in nats, whichever of them is rewarded.

        .. math::
            \frac{1}{E} \sum_e KL(p_e \| m) = KL(\bar p \| m) + JSD(p_1, \dots, p_E)
            = \frac{1}{E} \sum_e \left( H(p_e, m) - H(p_e) \right)

        All are Monte Carlo means over the same draws, so the identities are exact.

        Args:
            observation: Where.
            action: What is done there.
            noise: Standard normal draws for each outcome of each member, which is weighed by its
                probability; drawn afresh when `None`.
        """
        prediction = self._predict(observation, action)
        loc, log_var, log_weight = prediction
        if noise is None:
            noise = torch.randn(NUM_SAMPLES, *loc.shape, dtype=loc.dtype, device=loc.device)
        next_state = loc + torch.exp(0.5 * log_var) * noise  # samples members batch outcomes dim
        log_marginal = self.marginal.log_density(next_state)
        log_members = torch.logsumexp(  # samples members others batch outcomes
            log_weight.unsqueeze(-2)
            + gaussian_log_prob(
                next_state.unsqueeze(2).unsqueeze(-2),
                loc.unsqueeze(-3),
                0.5 * log_var.unsqueeze(-3),
            ),
            dim=-1,
        )
        log_own = log_members.diagonal(dim1=1, dim2=2).movedim(-1, 1)
        log_mean = torch.logsumexp(log_members, dim=2) - math.log(self.dynamics.members)

        def mean(log_ratio: Tensor) -> Tensor:
            return prediction.mean(log_ratio).mean((0, 1))

        return Decomposition(
            predictive_power=mean(log_mean - log_marginal),
            information_gain=mean(log_own - log_mean),
            total=mean(log_own - log_marginal),
            cross_entropy=mean(-log_marginal),
            conditional_entropy=mean(-log_own),
        )

    @torch.no_grad()
    def metrics(self) -> dict[str, Tensor]:
        """Diagnostics on the pairs of the last refresh, in nats where not said otherwise."""
        metrics = self.dynamics.metrics()
        if self.marginal.is_empty:
            return metrics
        generator = torch.Generator().manual_seed(0)  # leaves the global stream where it is
        prediction = self._predict(self.probe_observation, self.probe_action)
        noise = torch.randn(NUM_SAMPLES, *prediction.loc.shape, generator=generator)
        parts = self.decompose(
            self.probe_observation, self.probe_action, noise.to(self.probe_observation)
        )
        upper, lower = self._upper(prediction), self._lower(prediction)
        entropy = conditional_entropy(prediction)
        shape = NUM_INFORMATION_SAMPLES, *self.marginal.loc.shape
        information = self.marginal.information(
            torch.randn(shape, generator=generator).to(self.probe_observation)
        )
        if self.tuned_weight is not None:
            metrics["weight"] = self.standardization.weight * self.tuned_weight.factor
        return metrics | {
            "nats": upper.mean(),
            "nats_std": self.standardization.moments.scale[0],
            "predictive_power": parts.predictive_power.mean(),
            "information_gain": parts.information_gain.mean(),
            "conditional_entropy": entropy.mean(),
            "cross_entropy": (upper + entropy).mean(),
            "bound_gap": (upper - lower).mean(),
            "information_lower": information.lower,
            "information_upper": information.upper,
            "marginal_perplexity": self.marginal.perplexity(),
            "floor_share": self._floor_share(prediction),
        }

    def _predict(self, observation: Tensor, action: Tensor) -> Prediction:
        self._check_question(observation, action)
        with frozen(self.dynamics):
            return self._of_interest(self.dynamics(observation, action))

    def _estimate(self, observation: Tensor, action: Tensor) -> Float[Tensor, " batch"]:
        """Raw reward in nats, by all members or by one for each pair."""
        if not self.member_per_row or self.coefficients.information_gain:
            return self._weigh(self._predict(observation, action))
        self._check_question(observation, action)
        with frozen(self.dynamics):
            return self._weigh(self._predict_in_turn(observation, action))

    def _weigh(self, prediction: Prediction) -> Float[Tensor, " batch"]:
        """Weighted sum of the parts that are rewarded, in nats; no other part is computed."""
        if self.coefficients == DIVERGENCE:
            return self._upper(prediction).mean(0)
        parts = (
            lambda: self._upper(prediction).mean(0),
            lambda: information_gain(prediction),
            lambda: conditional_entropy(prediction).mean(0),
        )
        weighted = zip(self.coefficients, parts, strict=True)
        return torch.stack([weight * part() for weight, part in weighted if weight]).sum(0)

    def _predict_in_turn(self, observation: Tensor, action: Tensor) -> Prediction:
        """Prediction of each pair by one member: row `r` asks member `r % members`."""
        batch = observation.shape[0]
        row, _ = assign_rows(batch, self.dynamics.members, observation.device)
        in_turn = self.dynamics(observation[row], action[row])  # members turns ...
        fields = (restore_order(field, batch).unsqueeze(0) for field in in_turn)
        return self._of_interest(Prediction(*fields))

    def _of_interest(self, prediction: Prediction) -> Prediction:
        """The entries of a prediction that curiosity is about."""
        if self.entries is None:
            return prediction
        loc, log_var, log_weight = prediction
        return Prediction(loc[..., self.entries], log_var[..., self.entries], log_weight)

    def _upper(self, prediction: Prediction) -> Float[Tensor, "members batch"]:
        """Upper bound of each member's divergence from the marginal, in nats."""
        loc, log_var, _ = prediction
        return prediction.mean(self.marginal.kl_upper(loc, log_var)) - jensen_shannon_lower(
            *prediction
        )

    def _lower(self, prediction: Prediction) -> Float[Tensor, "members batch"]:
        loc, log_var, _ = prediction
        return prediction.mean(self.marginal.kl_lower(loc, log_var)) - jensen_shannon_upper(
            *prediction
        )

    def _check_question(self, observation: Tensor, action: Tensor) -> None:
        check_batch("observation", observation, self.observation_dim, self._dtype)
        check_batch("action", action, self.action_dim, self._dtype)
        if self.marginal.is_empty:
            raise RuntimeError("`observe` must see a batch before the bonus can be computed.")

    def _check_transition(self, transition: Transition) -> None:
        check_transition(transition, self.observation_dim, self.action_dim, self._dtype)

    @property
    def _dtype(self) -> torch.dtype:
        return self.probe_observation.dtype

    def _refresh(self, transition: Transition, fresh: Transition) -> None:
        """Renew the marginal's components, the standardisation and the probes."""
        (loc,), (log_var,), (log_weight,) = self._predict_in_turn(fresh.observation, fresh.action)
        outcome = drawn(log_weight, dim=-1)
        rows = torch.arange(outcome.shape[0], device=outcome.device)
        self.marginal.refresh(loc[rows, outcome], log_var[rows, outcome])
        observation, action = transition.observation, transition.action
        self.standardization.update(self._estimate(observation, action))
        probes = torch.arange(NUM_PROBES, device=observation.device) % observation.shape[0]
        self.probe_observation.copy_(observation[probes])
        self.probe_action.copy_(action[probes])

    def _tune_weight(self, tuned_weight: TunedWeight, fresh: Transition) -> None:
        """Let the weight follow what the policy's own actions earn."""
        earned = self._estimate(fresh.observation, fresh.action).mean()
        if tuned_weight.goal is None:
            moments = self.standardization.moments
            earned = (earned - moments.mean[0]) / moments.scale[0]
        tuned_weight.follow(earned, self.every.interval)

    def _floor_share(self, prediction: Prediction) -> Tensor:
        """Mean share of the predicted variance that is the floor: at 1 the model is sharper."""
        share = torch.exp(2 * math.log(self.dynamics.noise_floor) - prediction.log_var).mean(-1)
        return prediction.mean(share).mean()


def entries_of(features: Sequence[int], observation_dim: int) -> list[int]:
    """Indices of entries, counted from the front.

    Raises:
        ValueError: If there is none, or one is no entry of the observation or named twice.
    """
    valid = all(-observation_dim <= index < observation_dim for index in features)
    entries = [index % observation_dim for index in features]
    if not entries or not valid or len(set(entries)) < len(entries):
        raise ValueError(
            f"`features` must name different entries of {observation_dim}, got {list(features)}."
        )
    return entries
