"""Curiosity as predictive power: how far an action leads from where one usually ends up."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy, ask_policy
from deep_curiosity.bonuses.decomposition import DIVERGENCE, coefficients_of, information_gain
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble
from deep_curiosity.bonuses.marginal import NUM_MEASURED, NextStateMarginal
from deep_curiosity.bonuses.weight_tuning import TunedWeight
from deep_curiosity.gaussians import DiagonalMixture, gaussian_log_prob, sample_index
from deep_curiosity.nn.networks import frozen
from deep_curiosity.nn.statistics import (
    WHITENED_BOUND,
    Every,
    Standardization,
    replaced_by_mean,
)
from deep_curiosity.transitions import (
    Transition,
    check_counts,
    check_inputs,
    check_kind,
    check_transition,
    every_second,
    is_number,
    is_whole_number,
)

LEAST_COMPONENTS = 16  # of the marginal, below which what was measured before tells nothing
NUM_PROBES = 64  # pairs kept from the last refresh, on which the metrics are computed
NUM_SAMPLES = 16  # from each member's prediction when the bonus is taken apart
NUM_INFORMATION_SAMPLES = 2  # from each of the marginal's components, which are many


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

    It is returned standardised, `weight * (D - mean) / std`, cut at five standard deviations, with
    running statistics that are measured where the bonus is asked: on states that are no components
    of the marginal. Pure noise earns nothing once its variance is learned: `D` contains minus the
    conditional entropy.

    The marginal's components start from the newest states that were shown to `observe`, as many as
    it has, with what the policy did there then; at every renewal all of them are predicted anew,
    since models and units move.

    `parts` rewards what `D` is made of by weights of its own: `predictive_power`, the divergence
    of the members' mean prediction, and `information_gain`, what the next state would tell about
    which member is right, add up to `D`; so do `cross_entropy`, how rare the next state is, and
    `negative_entropy`, how sure. All are closed forms: `D` and the cross-entropy upper bounds, the
    gain a lower bound (see `decomposition.information_gain`), and predictive power what is left
    of `D`.

    Args:
        dynamics: Ensemble of models of the next state. Where it gives each row to one of its
            members, one member scores each pair, instead of the mean of them all: a pair's
            bonus then depends on its place in the batch. Where `parts` need the information gain,
            all members are used all the same.
        marginal: Density of the next states that one usually ends up in, over what the dynamics
            predict, or over the `entries` of it.
        weight: Factor of the standardised bonus. 0.1 suffices where there is no other signal; what
            it costs where reward is dense stands in docs/results.
        center: Subtract the running mean. Ending an episode is then worth as much as an average
            step: neither bait nor threat.
        scale: Divide by the running standard deviation; without it the bonus is in nats.
        refresh_interval: Calls of `observe` from one renewal of statistics and marginal to the
            next; the calls between do nothing.
        entries: What of the predicted next state is of interest, by its index, from the end where
            negative; all when `None`. The others are predicted with them, and `D` is the marginal
            of these, which diagonal Gaussians make exact.
        parts: Weight of each part of `D` that is rewarded, by name; `D` itself when `None`.
        tune_weight: Let the weight follow what the policy earns where `observe` is given it, see
            `TunedWeight`: `"past"` presses for curiosity while the policy of now earns less than
            those of late, in standard deviations of the score; a number while its mean score is
            below so many nats. `None` leaves the weight as it is.
        weight_learning_rate: Step size of the log weight, for each call of `observe`.

    Raises:
        TypeError: If an argument is of another kind.
        ValueError: If a count or a scale is out of range, a part unknown, an entry is none of what
            is predicted, or the marginal has another length than what is of interest.

    Reference: Still & Precup, "An information-theoretic approach to curiosity-driven reinforcement
    learning" (2012), equations (18)-(20).
    """

    probe_observation: Tensor
    probe_action: Tensor
    visited_observation: Tensor
    visited_action: Tensor
    num_visited: Tensor

    def __init__(
        self,
        dynamics: DynamicsEnsemble,
        marginal: NextStateMarginal,
        *,
        weight: float = 0.1,
        center: bool = True,
        scale: bool = True,
        refresh_interval: int = 20,
        entries: Sequence[int] | None = None,
        parts: Mapping[str, float] | None = None,
        tune_weight: Literal["past"] | float | None = None,
        weight_learning_rate: float = 3e-4,
    ) -> None:
        super().__init__()
        check_counts(refresh_interval=refresh_interval)
        check_kind("dynamics", dynamics, DynamicsEnsemble)
        check_kind("marginal", marginal, NextStateMarginal)
        self.observation_dim = dynamics.observation_dim
        self.action_dim = dynamics.action_dim
        self.coefficients = coefficients_of(parts)
        self.dynamics = dynamics
        dim = dynamics.predicted_dim
        self.entries = None if entries is None else check_entries(entries, dim, "entries")
        _check_marginal(marginal, dim if self.entries is None else len(self.entries))
        self.marginal = marginal
        self.standardization = Standardization(weight=weight, center=center, scale=scale)
        self.tuned_weight = _make_tuned_weight(tune_weight, weight_learning_rate)
        self.every = Every(refresh_interval)
        memory = len(marginal.loc)
        self.register_buffer("visited_observation", torch.zeros(memory, self.observation_dim))
        self.register_buffer("visited_action", torch.zeros(memory, self.action_dim))
        self.register_buffer("num_visited", torch.zeros((), dtype=torch.long))
        self.register_buffer("probe_observation", torch.zeros(NUM_PROBES, self.observation_dim))
        self.register_buffer("probe_action", torch.zeros(NUM_PROBES, self.action_dim))

    @classmethod
    def default(
        cls,
        observation_dim: int,
        action_dim: int,
        *,
        hidden_dims: Sequence[int] = (256, 256),
        **options: Any,
    ) -> "CuriosityBonus":
        """Build the bonus with its dynamics and marginal, by default as the trainer does.

        Args:
            observation_dim: Length of an observation.
            action_dim: Length of an action; actions lie in [-1, 1].
            hidden_dims: Width of every hidden layer of the models.
            **options: Settings as `make_bonus` takes them, by name; and `features`, which may also
                be a function or module from observations to features: the models then predict
                its value (see `DynamicsEnsemble`), and a module is frozen for good.

        Raises:
            TypeError: If there is no such option, or the class is one derived from this.
            ValueError: If an option is out of range.
        """
        from deep_curiosity.bonuses.registry import make_bonus

        if cls is not CuriosityBonus:
            raise TypeError(
                "`default` must be called of CuriosityBonus, of whose `dynamics` and `marginal` "
                f"a class derived from it is made, got {cls.__name__}."
            )
        bonus = make_bonus(
            "curiosity", observation_dim, action_dim, hidden_dims=hidden_dims, **options
        )
        assert isinstance(bonus, cls)
        return bonus

    @property
    def ready(self) -> bool:
        """Whether the marginal has a component yet."""
        return not self.marginal.is_empty

    @property
    def should_skip(self) -> bool:
        """Whether the next batch would only be counted."""
        return self.every.should_skip

    def skip(self) -> None:
        """Count a batch that is not shown."""
        self.every.count()

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """Standardised divergence of each pair, differentiable in the action.

        Raises:
            RuntimeError: If nothing has been observed yet.
            TypeError: If an argument has the wrong kind.
            ValueError: If one has the wrong shape, another batch size, or a value that is not
                finite or beyond 1e14, an action beyond 1e3.
        """
        shape = getattr(observation, "shape", None)
        if next_observation is not None and getattr(next_observation, "shape", None) != shape:
            dim = self.observation_dim
            check_inputs(
                self.probe_observation.dtype,
                observation=(observation, dim),
                next_observation=(next_observation, dim),
            )
        bonus = self.standardization(self._weigh(self._ask(observation, action)))
        return bonus if self.tuned_weight is None else self.tuned_weight.factor * bonus

    def nats(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> Float[Tensor, " batch"]:
        """Raw divergence of each pair, the upper bound averaged over members, in nats."""
        return self.marginal.kl_upper(self._predict(observation, action)).mean(0)

    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Negative log-likelihood of the ensemble, in nats; see `DynamicsEnsemble.loss`.

        Raises:
            TypeError: If a field has the wrong kind.
            ValueError: If a field has the wrong shape or holds NaN or infinity, or a feature is
                none to compute with.
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
            policy: Samples fresh actions at the batch's observations for the marginal, so that it
                follows the policy of now; `None` takes the actions that were taken.
            visited: Where the marginal's newest components start from, if not at the batch: the
                newest transitions, say, for a marginal of where one usually ends up of late. They
                enter at the next renewal. All statistics stay those of the batch.

        Raises:
            TypeError: If a field, the policy or what it returns has the wrong kind.
            ValueError: If a field, or what the policy returns, has the wrong shape or holds NaN or
                infinity, or a feature is none to compute with. The statistics are then as before.
        """
        if self.should_skip:
            self.skip()
            return
        self._check_transition(transition)
        fresh = transition
        if visited is not None:
            fresh = visited
            self._check_transition(fresh, "visited")
            self.dynamics.check_features(fresh.observation)
        if policy is not None:
            fresh = fresh._replace(action=ask_policy(policy, fresh.observation, self.action_dim))
        self.dynamics.observe(transition)  # first of all: it may refuse what features give
        scored, late = transition, fresh
        if not self.ready:  # half of the first batch is components, the other half is scored
            scored, late = every_second(transition, 1), every_second(fresh, 1)
            self._remember(every_second(fresh, 0))
        self._refresh()
        if self.num_visited < LEAST_COMPONENTS:  # beside so few everything is far
            self.standardization.forget()
        if len(scored.action):  # none of a first batch of one: the next is then due at once
            self.every.count()
            prediction = self._ask(scored.observation, scored.action)
            # what is so far off that whitening cut it is absurd, and no measure of the others
            is_cut = (prediction.loc.abs() >= WHITENED_BOUND).flatten(-2).any(-1).any(0)
            self.standardization.update(replaced_by_mean(self._weigh(prediction), is_cut))
            if self.tuned_weight is not None and policy is not None:
                self._tune_weight(self.tuned_weight, late)
        self._remember(late)  # only now: what is scored is no component itself
        self._set_probes(transition)

    def decompose(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        noise: Float[Tensor, "samples members batch components features"] | None = None,
    ) -> Decomposition:
        r"""The divergence of each pair and its parts, in nats, whichever of them is rewarded.

        .. math::
            \frac{1}{E} \sum_e KL(p_e \| m) = KL(\bar p \| m) + JSD(p_1, \dots, p_E)
            = \frac{1}{E} \sum_e \left( H(p_e, m) - H(p_e) \right)

        All are Monte Carlo means over the same samples, so the identities are exact.

        Args:
            observation: Where.
            action: What is done there.
            noise: Standard normal numbers for each component of each member, weighed by its
                probability; sampled afresh when `None`.

        Raises:
            RuntimeError: If nothing has been observed yet.
            TypeError: If an argument has the wrong kind.
            ValueError: If one has the wrong shape, or holds what cannot be computed with.
        """
        prediction = self._predict(observation, action)
        loc, log_var, log_weight = prediction
        if noise is None:
            noise = torch.randn(NUM_SAMPLES, *loc.shape, dtype=loc.dtype, device=loc.device)
        _check_noise(noise, loc)
        next_state = prediction.component_samples(noise)  # samples members batch components dim
        log_marginal = self.marginal.log_density(next_state)
        log_members = torch.logsumexp(  # samples members others batch components
            log_weight.unsqueeze(-2)
            + gaussian_log_prob(
                next_state.unsqueeze(2).unsqueeze(-2),
                loc.unsqueeze(-3),
                0.5 * log_var.unsqueeze(-3),
            ),
            dim=-1,
        )
        log_own = log_members.diagonal(dim1=1, dim2=2).movedim(-1, 1)
        log_mean = torch.logsumexp(log_members, dim=2) - math.log(self.dynamics.num_members)

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
        if not self.ready:
            return metrics
        generator = torch.Generator().manual_seed(0)  # leaves the global stream where it is
        prediction = self._predict(self.probe_observation, self.probe_action)
        noise = torch.randn(NUM_SAMPLES, *prediction.loc.shape, generator=generator)
        parts = self.decompose(
            self.probe_observation, self.probe_action, noise.to(self.probe_observation)
        )
        upper, lower = self.marginal.kl_upper(prediction), self.marginal.kl_lower(prediction)
        entropy = prediction.entropy()
        number, dim = self.marginal.loc[:NUM_MEASURED].shape
        shape = NUM_INFORMATION_SAMPLES, number, dim
        information = self.marginal.information(
            torch.randn(shape, generator=generator).to(self.probe_observation)
        )
        if self.tuned_weight is not None:
            metrics["weight"] = self.standardization.weight * self.tuned_weight.factor
        return metrics | {
            "nats": upper.mean(),
            "nats_std": self.standardization.moments.scale[0].clone(),
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

    def _predict(self, observation: Tensor, action: Tensor) -> DiagonalMixture:
        """Predictions of all members, `(members, batch)`."""
        self._check_question(observation, action)
        with frozen(self.dynamics):
            return self._of_interest(self.dynamics(observation, action))

    def _ask(self, observation: Tensor, action: Tensor) -> DiagonalMixture:
        """Predictions that a bonus is made of, by all members or by one for each pair."""
        if self.dynamics.members == "all" or self.coefficients.information_gain:
            return self._predict(observation, action)
        self._check_question(observation, action)
        with frozen(self.dynamics):
            return self._of_interest(self.dynamics.round_robin(observation, action))

    def _weigh(self, prediction: DiagonalMixture) -> Float[Tensor, " batch"]:
        """Weighted sum of the parts that are rewarded, in nats; no other part is computed."""
        if self.coefficients == DIVERGENCE:
            return self.marginal.kl_upper(prediction).mean(0)
        parts = (
            lambda: self.marginal.kl_upper(prediction).mean(0),
            lambda: information_gain(prediction),
            lambda: prediction.entropy().mean(0),
        )
        weighted = zip(self.coefficients, parts, strict=True)
        return torch.stack([weight * part() for weight, part in weighted if weight]).sum(0)

    def _of_interest(self, prediction: DiagonalMixture) -> DiagonalMixture:
        """What of a prediction curiosity is about."""
        return prediction if self.entries is None else prediction.coordinates(self.entries)

    def _check_question(self, observation: Tensor, action: Tensor) -> None:
        check_inputs(
            self.probe_observation.dtype,
            observation=(observation, self.observation_dim),
            action=(action, self.action_dim),
        )
        if not self.ready:
            raise RuntimeError("`observe` must see a batch before the bonus can be computed.")

    def _check_transition(self, transition: Transition, name: str = "transition") -> None:
        dtype = self.probe_observation.dtype
        check_transition(transition, self.observation_dim, self.action_dim, dtype, name)

    def _remember(self, fresh: Transition) -> None:
        """Let visited states take the place of the oldest ones, for the next renewal."""
        memory = len(self.visited_observation)
        observation, action = fresh.observation[-memory:], fresh.action[-memory:]
        slot = torch.arange(len(observation), device=observation.device) + self.num_visited
        self.visited_observation[slot % memory] = observation
        self.visited_action[slot % memory] = action
        self.num_visited.add_(len(observation))

    def _refresh(self) -> None:
        """Predict all components anew: models and units have moved since the last time."""
        num_held = min(int(self.num_visited), len(self.visited_observation))
        pairs = self.visited_observation[:num_held], self.visited_action[:num_held]
        round_robin = self._of_interest(self.dynamics.round_robin(*pairs))
        predicted = DiagonalMixture(*(field.squeeze(0) for field in round_robin))
        self.marginal.replace(*predicted.select(sample_index(predicted.log_weight)))

    def _set_probes(self, transition: Transition) -> None:
        """Keep the pairs on which the metrics are computed."""
        probes = torch.arange(NUM_PROBES, device=transition.action.device) % len(transition.action)
        self.probe_observation.copy_(transition.observation[probes])
        self.probe_action.copy_(transition.action[probes])

    def _tune_weight(self, tuned_weight: TunedWeight, late: Transition) -> None:
        """Let the weight follow what fresh actions earn at states that are no components yet."""
        earned = self._weigh(self._ask(late.observation, late.action)).mean()
        if tuned_weight.goal is None:
            earned = self.standardization.in_deviations(earned)
        tuned_weight.follow(earned, self.every.interval)

    def _floor_share(self, prediction: DiagonalMixture) -> Tensor:
        """Mean share of the predicted variance that is the floor: at 1 the model is sharper."""
        share = torch.exp(2 * math.log(self.dynamics.noise_floor) - prediction.log_var).mean(-1)
        return prediction.mean(share).mean()


def check_entries(entries: Sequence[int], dim: int, name: str = "features") -> list[int]:
    """Indices of entries, counted from the front.

    Args:
        entries: The indices, from the end where negative.
        dim: Number of entries that there are.
        name: The argument that they were given by.

    Raises:
        TypeError: If they are no sequence, or one is no whole number.
        ValueError: If there is none, or one is no entry of `dim` or named twice.
    """
    try:
        entries = list(entries)
    except TypeError:
        raise TypeError(f"`{name}` must be whole numbers in a list, got {entries!r}.") from None
    for index in entries:
        if not is_whole_number(index):
            raise TypeError(f"`{name}` must be whole numbers, got {index!r}.")
    valid = all(-dim <= index < dim for index in entries)
    chosen = [index % dim for index in entries]
    if not chosen or not valid or len(set(chosen)) < len(chosen):
        raise ValueError(f"`{name}` must name different entries of {dim}, got {entries}.")
    return chosen


def _check_marginal(marginal: NextStateMarginal, dim: int) -> None:
    if marginal.loc.shape[1] != dim:
        raise ValueError(
            f"`marginal` must be over the {dim} features that are predicted and of interest, "
            f"got one over {marginal.loc.shape[1]}."
        )


def _check_noise(noise: Any, loc: Tensor) -> None:
    check_kind("noise", noise, Tensor)
    if noise.shape[1:] != loc.shape or len(noise) == 0:
        shape = ", ".join(map(str, loc.shape))
        raise ValueError(f"`noise` must have shape (samples, {shape}), got {tuple(noise.shape)}.")


def _make_tuned_weight(
    tune_weight: Literal["past"] | float | None, learning_rate: float
) -> TunedWeight | None:
    if tune_weight is None:
        return None
    goal = None if isinstance(tune_weight, str) and tune_weight == "past" else tune_weight
    if goal is not None and not is_number(goal):
        raise ValueError(f"`tune_weight` must be 'past', a number or None, got {tune_weight!r}.")
    return TunedWeight(goal=goal, learning_rate=learning_rate)
