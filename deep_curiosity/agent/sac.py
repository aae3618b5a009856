"""The curious agent: soft actor-critic with an action prior and a second value, of curiosity."""

import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.agent.action_information import action_information
from deep_curiosity.agent.config import (
    MOST_HUNGER,
    TEMPERATURES,
    AgentConfig,
    ConditionedHunger,
)
from deep_curiosity.agent.networks import (
    DEFAULT_RATE,
    PRIORS,
    Critics,
    GaussianPolicy,
    for_each_critic,
    log_abs_det_tanh,
)
from deep_curiosity.configuration import check_range, override
from deep_curiosity.losses import (
    actor_loss,
    critic_loss,
    n_step_target,
    price_shares,
    prior_loss,
    temperature_loss,
)
from deep_curiosity.nn.networks import Adam
from deep_curiosity.nn.statistics import InputScaling
from deep_curiosity.schedules import Schedule
from deep_curiosity.transitions import (
    LARGEST,
    Sequences,
    Transition,
    as_sequences,
    check_counts,
    check_flags,
    check_inputs,
    check_moderate,
    is_number,
)

STD_DECAY = 0.99  # of the running standard deviations of the values, for each update
LOG_TEMPERATURES = math.log(TEMPERATURES[0]), math.log(TEMPERATURES[1])
MOST_NATS = 10.0  # of an action dimension; the narrowest policy has 4.3 in the middle of the box
ADAPTIVE = -1.0  # in the place of a fixed coefficient, which is never negative
MOST_GREEDY_SHARE = 0.95  # of the steps: the curious policy is never left aside
PARITY_FLOOR = 1e-3  # of their ratio: a conditioned agent lifts curiosity by at most a thousand

BonusFunction = Callable[..., Tensor]
"""A bonus as the agent calls it: of observations, actions and, if known, next observations."""
Hunger = Float[Tensor, ""] | Float[Tensor, " batch"]  # one for all, or one for each
GivenHunger = Tensor | np.ndarray | Sequence[float] | float  # the same, as a caller has it


class PolicySample(NamedTuple):
    """What the actor's step leaves to the prior's and the temperature's, without gradient."""

    pre_action: Float[Tensor, "components policies batch action_dim"]
    information_cost: Float[Tensor, "components policies batch"]
    weight: Float[Tensor, "components policies batch"]


class CuriousSAC(nn.Module):
    r"""Actor-critic whose policy follows equation (21).

    .. math:: \pi(a|x) \propto p(a) \exp((Q_D(x, a) + \alpha Q(x, a)) / \lambda)

    `Q` is the value of the reward, `Q_D` the discounted sum of the bonus under its own discount.
    The two are learned apart, so `hunger` (alpha) and `temperature` (lambda) may be set at any
    step. Without a bonus and with the uniform prior this is soft actor-critic.

    A curious agent is two policies, unless it is conditioned on its hunger or `greedy_share` is 0:
    then there is the first alone. The curious one follows (21). The greedy one is soft
    actor-critic's, without `Q_D` and with the uniform prior, so that it owes nothing to the habits
    of the other, and `Q` is its value: what could be earned from here on by whoever wished, which
    is not forgotten while the curious policy looks elsewhere.

    `Q_D` is relative to its mean over replay, as in relative value iteration: its targets leave
    that out of what follows. A bonus above zero then does not pile up, and the end of an episode
    is worth as much as what follows an average step.

    Where the agent is conditioned on its hunger, every transition is relabelled with a hunger of
    its own: reward weighs `hunger`, curiosity `1 - hunger`, each in units of the standard
    deviation of its value where reward's is the larger. One agent is then every agent from purely
    curious (0) to purely greedy (1).

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        config: Settings, by default those of the trainer.
        curiosity: Whether `update` is given a bonus.

    Raises:
        ValueError: If a number is out of range.

    Reference: Still & Precup (2012), equations (10), (14), (21); Haarnoja et al., "Soft
    Actor-Critic Algorithms and Applications" (2018), https://arxiv.org/abs/1812.05905; Abounadi,
    Bertsekas & Borkar, "Learning algorithms for Markov decision processes with average cost"
    (2001).
    """

    _hunger: Tensor
    _fixed_coefficient: Tensor
    discounts: Tensor
    log_excess: Tensor
    value_stds: Tensor
    curiosity_mean: Tensor
    optimizers: Mapping[str, Adam]
    observation_scaling: InputScaling | None
    """What brings observations to a size; `None` where they are seen as they are."""

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        config: AgentConfig | None = None,
        *,
        curiosity: bool = True,
    ) -> None:
        super().__init__()
        config = AgentConfig() if config is None else config
        check_counts(observation_dim=observation_dim, action_dim=action_dim)
        _check_parts(config, curiosity)
        self.config = config
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.curiosity = curiosity
        self.is_conditioned = config.is_conditioned
        self.tunes_temperature = config.tunes_temperature
        self.actor_stride = config.actor_stride
        self.polyak = config.polyak
        self.has_curiosity_critic = curiosity and config.curiosity.discount > 0
        """Whether the bonus is a reward of its own, computed once, and never maximised itself."""
        steps = config.reward.reward_steps, config.curiosity.steps
        self.num_steps = steps if self.has_curiosity_critic else steps[:1]
        """Steps that are summed in the target of each value."""
        self.looks_past_the_end = self.has_curiosity_critic and not config.curiosity.episodic
        self.has_greedy_policy = curiosity and config.greedy_share > 0
        """Whether reward's value is about a second policy, which maximises nothing else."""
        self.sequence_length = max(self.num_steps) + self.looks_past_the_end
        """Steps that the sequences of a batch should have: what is summed, and what follows."""
        discounts = [config.reward.discount, config.curiosity.discount]
        discounts = discounts if self.has_curiosity_critic else discounts[:1]
        self._make_networks()
        soft_backup, rate = config.reward.soft_backup, config.target_information_rate
        # where Q is about a policy that is soft actor-critic's own
        by_default = self.has_greedy_policy or (not curiosity and self.prior.soft_backup)
        self.soft_backup = by_default if soft_backup is None else soft_backup
        self.target_information_rate = DEFAULT_RATE * action_dim if rate is None else rate
        check_rate(self.target_information_rate, action_dim)
        self._register_state(discounts)
        self.optimizers = nn.ModuleDict(  # type: ignore[assignment]  # of Adams
            {
                name: Adam(parameters, config.learning_rate)
                for name, parameters in self._trained_parameters().items()
            }
        )
        self.register_load_state_dict_post_hook(_step_what_was_loaded)

    def _make_networks(self) -> None:
        """Make policies, critics, the slow copy of these, and the action prior."""
        config, input_dim = self.config, self.observation_dim + int(self.is_conditioned)
        hidden_dims = (config.hidden_dim, config.hidden_dim)
        self.observation_scaling = (
            InputScaling(self.observation_dim) if config.normalize_observations else None
        )
        self.policy = GaussianPolicy(
            input_dim,
            self.action_dim,
            policies=1 + self.has_greedy_policy,
            mixture_components=config.mixture_components,
            hidden_dims=hidden_dims,
        )
        self.critics = Critics(
            input_dim,
            self.action_dim,
            others=int(self.has_curiosity_critic),
            hidden_dims=hidden_dims,
            layer_norm=config.critic_layer_norm,
        )
        self.target_critics = deepcopy(self.critics).requires_grad_(False)
        self.prior = PRIORS[config.prior_of(curiosity=self.curiosity)](self.action_dim)

    def _register_state(self, discounts: list[float]) -> None:
        """Make what changes while the agent lives, so that a compiled update follows it."""
        config = self.config
        coefficient = config.curiosity.coefficient
        fixed = ADAPTIVE if coefficient == "adaptive" else coefficient
        prices = torch.zeros(1 + self.has_greedy_policy)  # greedy, curious
        self.log_temperature = nn.Parameter(prices, requires_grad=self.tunes_temperature)
        self.register_buffer("_hunger", torch.tensor(float(_first_hunger(config))))
        self.register_buffer("_fixed_coefficient", torch.tensor(float(fixed)))
        # what densities integrate to, in logs: uniform ones have density one on the action box
        of_greed = [[self.prior.log_volume]] * self.has_greedy_policy
        excess = torch.tensor([*of_greed, [self.prior.log_excess]])
        self.register_buffer("log_excess", excess, persistent=False)  # policies 1
        self.register_buffer("discounts", torch.tensor(discounts).unsqueeze(-1))  # values 1
        self.register_buffer("value_stds", torch.zeros(1 + self.curiosity))  # over replay
        self.register_buffer("curiosity_mean", torch.zeros(()))  # of Q_D over replay
        first = config.temperature
        self.temperature = first(0.0) if isinstance(first, Schedule) else first

    @classmethod
    def default(
        cls, observation_dim: int, action_dim: int, *, curiosity: bool = True, **options: Any
    ) -> "CuriousSAC":
        """Build the agent from single settings, by their flat names.

        Args:
            observation_dim: Length of an observation.
            action_dim: Length of an action; actions lie in [-1, 1].
            curiosity: Whether `update` is given a bonus.
            **options: Settings of `AgentConfig` and its groups, such as `curiosity_discount`.

        Raises:
            TypeError: If there is no such setting.
            ValueError: If a value is out of range, or goes with time, which the trainer knows.
        """
        config = override(AgentConfig(), **options)
        _check_steady(config)
        return cls(observation_dim, action_dim, config, curiosity=curiosity)

    @property
    def hunger(self) -> float:
        """Weight of the reward's value, alpha; may be set at any step."""
        return self._hunger.item()

    @hunger.setter
    def hunger(self, value: float) -> None:
        _check_number("hunger", value, at_least=0.0, at_most=MOST_HUNGER)
        if self.is_conditioned and value > 1:
            raise ValueError(f"`hunger` must lie in [0, 1] where conditioned, got {value}.")
        self._hunger.fill_(value)

    @property
    def curiosity_coefficient(self) -> float:
        """Weight of the curiosity value in the policy's objective, at the hunger of now.

        May be set at any step to a number that then stays, 0 to switch curiosity off.
        """
        return self._coefficient(self._hunger).item()

    @curiosity_coefficient.setter
    def curiosity_coefficient(self, value: float) -> None:
        _check_number("curiosity_coefficient", value, at_least=0.0, at_most=MOST_HUNGER)
        if value and not self.curiosity:
            raise ValueError(
                f"`curiosity_coefficient` must be 0 where there is no curiosity, got {value}."
            )
        self._fixed_coefficient.fill_(value)

    @property
    def temperature(self) -> float:
        """Price of a nat, lambda; may be set at any step, and is tuned on from there.

        A greedy policy has a price of its own, which is set together with it.
        """
        return self.log_temperature[-1].exp().item()

    @temperature.setter
    def temperature(self, value: float) -> None:
        least, most = TEMPERATURES
        _check_number("temperature", value, above=0.0, at_least=least, at_most=most)
        with torch.no_grad():
            self.log_temperature.fill_(math.log(value))

    @property
    def greedy_share(self) -> float:
        """Share of the steps at which the greedy policy should act now, 0 if there is none.

        By default it grows as reward comes to distinguish states: where curiosity has faded, what
        is left of it is not worth that the greedy policy learns from what another does.
        """
        if not self.has_greedy_policy:
            return 0.0
        least = self.config.greedy_share
        if self.config.curiosity.adaptive_greedy_share is False:
            return least
        most = max(least, MOST_GREEDY_SHARE)
        share = 1 - self._ratio_of_spreads(self._hunger)
        share = torch.where(self.value_stds[0] > 0, share, 0.0)  # before anything was learned
        return share.clamp(least, most).item()

    def policy_input(
        self,
        observation: Float[Tensor, "*values batch observation_dim"],
        hunger: GivenHunger | None = None,
    ) -> Float[Tensor, "*values batch policy_input_dim"]:
        """Input of policy and critics: the observation, and behind it the hunger if conditioned.

        Args:
            observation: As the environment gave it; it is normalised here, where that is set.
            hunger: From 0, purely curious, to 1, purely greedy: one for all or one for each; the
                agent's own by default. An agent that is not conditioned on its hunger has learned
                to act at that of the updates, and leaves any other aside.

        Raises:
            TypeError: If the hunger is neither a number nor a tensor of them.
            ValueError: If there is neither one hunger nor one for each, or one outside [0, 1].
                Values are not looked at inside a compiled graph.
        """
        if self.observation_scaling is not None:
            observation = self.observation_scaling(observation)
        if not self.is_conditioned:
            return observation
        hunger = self._hunger if hunger is None else _as_hunger(hunger, self._hunger)
        _check_hunger(hunger, observation.shape[-2])
        entry = hunger.expand(observation.shape[:-1]).unsqueeze(-1)
        return torch.cat([observation, entry], dim=-1)

    @torch.no_grad()
    def act(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        *,
        deterministic: bool = False,
        greedy: bool = False,
        hunger: GivenHunger | None = None,
    ) -> Float[Tensor, "batch action_dim"]:
        """Sample actions in [-1, 1], or take the centre of the policy.

        Args:
            observation: Where.
            deterministic: Take the centre of the weightiest component.
            greedy: Act by the greedy policy, if there is one.
            hunger: In [0, 1], one for all or one for each; the agent's own by default. It is left
                aside by an agent that is not conditioned on it.

        Raises:
            TypeError: If an argument has the wrong kind.
            ValueError: If the observation has the wrong shape or holds NaN or infinity, or the
                agent is conditioned and the hunger outside [0, 1] or not one or one for each.
        """
        dtype = self.log_temperature.dtype
        check_inputs(dtype, observation=(observation, self.observation_dim))
        number = 0 if greedy else -1  # the same where there is one policy
        policy = self.policy(self.policy_input(observation, hunger), number)
        if deterministic:
            return torch.tanh(policy.select(policy.log_weight.argmax(-1))[0])
        return torch.tanh(policy.sample())

    def curious_steps(self, sequences: Sequences) -> Transition:
        """The steps whose bonus counts: of every sequence as many as the curiosity value sums."""
        return sequences.head(self.num_steps[-1])

    def update(
        self, batch: Transition | Sequences, bonus: Tensor | BonusFunction | None = None
    ) -> dict[str, Tensor]:
        """Take one gradient step on every part.

        Args:
            batch: From replay, the reward as the environment gave it. Every field but `truncated`
                is read. Values look one step ahead in transitions, several in sequences: as many
                as are set in `replay.sample_sequences(batch_size, agent.sequence_length)`.
            bonus: `(num_steps * batch,)`, of the first `curiosity_steps` of every sequence, NaN
                behind the first one where it is not known, which ends what is summed; or the
                function itself, of observation, action and next observation, which must be given
                where `curiosity_discount` is 0. What it returns must be such a tensor; without NaN
                where the policy maximises it.

        Returns:
            What to log: detached 0-d tensors, information in nats.

        Raises:
            TypeError: If a field of the transition, or the bonus or what it returns, has the wrong
                kind.
            ValueError: If a bonus is given to an agent without curiosity, or not to a curious one,
                or a field or the bonus has the wrong shape or holds NaN or infinity.
        """
        sequences = as_sequences(batch)
        self._check_update(sequences, bonus)
        steps, batch_size = sequences.steps, sequences.alive.shape[1]
        hunger = sample_hunger(steps.reward[:batch_size]) if self.is_conditioned else self._hunger
        rewards = self._rewards(sequences, bonus)  # first of all: a function of bonus may fail
        observation = steps.observation[:batch_size]
        if self.observation_scaling is not None:
            self.observation_scaling.update(observation)
        policy_input = self.policy_input(observation, hunger)
        target = self._targets(sequences, rewards, hunger)
        metrics = self._update_critics(policy_input, steps.action[:batch_size], target)
        sample, actor_metrics = self._update_actor(observation, policy_input, bonus, hunger)
        metrics |= actor_metrics | self._update_prior(sample) | self._update_temperature(sample)
        with torch.no_grad():  # Polyak averaging, all parameters in one call
            torch._foreach_lerp_(
                list(self.target_critics.parameters()),
                list(self.critics.parameters()),
                self.polyak,
            )
        return metrics

    @torch.no_grad()
    def metrics(
        self, observation: Float[Tensor, "batch observation_dim"] | None = None
    ) -> dict[str, Tensor]:
        """What is too dear for every update, information in nats.

        Args:
            observation: States as the agent meets them, over which the information that actions
                carry about them is estimated from both sides; left out without.

        Raises:
            TypeError: If the observation has the wrong kind.
            ValueError: If it has the wrong shape, fewer than two rows, or holds NaN or infinity.
        """
        metrics = {"hunger": self._hunger.clone()} | self.prior.metrics()
        if self.has_greedy_policy:
            metrics["greedy_share"] = torch.tensor(self.greedy_share)
            metrics["greedy_temperature"] = self.log_temperature[0].exp()
        if self.has_curiosity_critic:
            metrics["curiosity_coefficient"] = self._coefficient(self._hunger)
        if observation is not None:
            dtype = self.log_temperature.dtype
            check_inputs(dtype, observation=(observation, self.observation_dim))
            if len(observation) < 2:
                raise ValueError(
                    f"`observation` must have at least 2 rows, got {len(observation)}."
                )
            policy = self.policy(self.policy_input(observation), -1)
            with torch.random.fork_rng():  # leaves the global stream where it is
                torch.manual_seed(0)
                information = action_information(policy, policy.sample())
            metrics["action_information_lower"] = information.lower
            metrics["action_information_upper"] = information.upper
        return metrics

    def _check_update(self, sequences: Sequences, bonus: Tensor | BonusFunction | None) -> None:
        if self.curiosity != (bonus is not None):
            raise ValueError(
                "`bonus` must be given if and only if the agent has `curiosity`, "
                f"got {bonus!r} with curiosity={self.curiosity}."
            )
        if isinstance(bonus, Tensor) and not self.has_curiosity_critic:
            raise ValueError(
                "`bonus` must be a function where `curiosity_discount` is 0, since the policy "
                f"maximises it, got a tensor of shape {tuple(bonus.shape)}."
            )
        sequences.check(self.observation_dim, self.action_dim, self.log_temperature.dtype)
        if isinstance(bonus, Tensor):
            num_steps, batch_size = sequences.alive.shape
            num_rows = min(num_steps, self.num_steps[-1]) * batch_size
            self._check_bonus(bonus, num_rows, batch_size)
        elif not (bonus is None or callable(bonus)):
            raise TypeError(f"`bonus` must be a tensor or a function, got {bonus!r}.")

    def _check_bonus(
        self, bonus: Tensor, num_rows: int, num_first: int, rows: str = "`curious_steps`"
    ) -> None:
        """Reject a bonus, given or returned by a function, that is none; later rows may be NaN."""
        dtype = self.log_temperature.dtype
        if not isinstance(bonus, Tensor) or bonus.dtype != dtype:
            kind = bonus.dtype if isinstance(bonus, Tensor) else type(bonus).__name__
            raise TypeError(f"`bonus` must be a tensor of {dtype}, got {kind}.")
        if bonus.shape != (num_rows,):
            raise ValueError(
                f"`bonus` must have shape ({num_rows},), one number for each of the "
                f"{rows}, got {tuple(bonus.shape)}."
            )
        if torch.compiler.is_compiling():
            return
        bonus = bonus.detach()
        later = torch.arange(num_rows, device=bonus.device) >= num_first
        known = bonus.masked_fill(later & bonus.isnan(), 0.0)
        if not torch.linalg.vector_norm(known) <= LARGEST:
            check_moderate(bonus=known)

    def _update_critics(
        self,
        policy_input: Float[Tensor, "batch policy_input_dim"],
        action: Float[Tensor, "batch action_dim"],
        target: Float[Tensor, "values batch"],
    ) -> dict[str, Tensor]:
        """Step the critics towards the targets."""
        value = self.critics(policy_input, action)  # critics batch
        loss = critic_loss(value, for_each_critic(target))
        self.optimizers["critics"].step(loss)
        value = value.detach()
        value = torch.cat([value[:2].mean(0, keepdim=True), value[2:]])
        stds, means = value.std(-1, correction=0), value.mean(-1)
        self.value_stds[: len(stds)].lerp_(stds, 1 - STD_DECAY)
        self.curiosity_mean.lerp_(means[1:].sum(), 1 - STD_DECAY)
        return {
            "critic_loss": loss.detach(),
            "value": means[0],
            "curiosity_value": means[1:].sum(),
        }

    @torch.no_grad()
    def _targets(
        self, sequences: Sequences, rewards: list[Float[Tensor, " _"]], hunger: Hunger
    ) -> Float[Tensor, "values batch"]:
        """Targets of the reward's value and, where it is learned, of the curiosity value.

        Each sums as many steps as are its own, or as the sequences hold where that is less.
        """
        parts = [sequences, *map(sequences.known, rewards[1:])]
        ends, reached = [], []
        for number, (part, num_steps) in enumerate(zip(parts, self.num_steps, strict=True)):
            last = part.last(num_steps)
            ends.append(last.terminated)
            reached.append(last.next_observation)
            if number and self.looks_past_the_end:  # to the next start, which a regression fits
                restart = part.continuation(num_steps)
                reached[-1] = torch.where(ends[-1].unsqueeze(-1), restart, reached[-1])
                ends[-1] = torch.zeros_like(ends[-1])
        is_shared = len(reached) == 1 or len(sequences.alive) == 1  # one state for all
        next_value = self._next_values(reached[0] if is_shared else torch.stack(reached), hunger)
        next_value[1:] -= self.curiosity_mean
        targets = []
        for number, (part, reward) in enumerate(zip(parts, rewards, strict=True)):
            steps = slice(self.num_steps[number])
            targets.append(
                n_step_target(
                    reward.unflatten(0, (-1, sequences.alive.shape[1]))[steps],
                    part.alive[steps],
                    ends[number],
                    next_value[number],
                    self.discounts[number],
                )
            )
        return torch.stack(targets)

    def _rewards(
        self, sequences: Sequences, bonus: Tensor | BonusFunction | None
    ) -> list[Float[Tensor, " steps"]]:
        """Reward of each step and, where its value is learned, bonus of those that it sums."""
        if bonus is None or not self.has_curiosity_critic:
            return [sequences.steps.reward]
        if not isinstance(bonus, Tensor):
            observation, action, _, next_observation, *_ = self.curious_steps(sequences)
            bonus = bonus(observation, action, next_observation)
            self._check_bonus(bonus, len(observation), sequences.alive.shape[1])
        return [sequences.steps.reward, bonus]

    def _next_values(
        self,
        observation: Float[Tensor, "batch observation_dim"]
        | Float[Tensor, "values batch observation_dim"],
        hunger: Hunger,
    ) -> Float[Tensor, "values batch"]:
        """Values of the states that are reached, each under its own policy of now.

        Args:
            observation: One state for all values, or one for each.
            hunger: One for all, or one for each of the batch.
        """
        policy_input = self.policy_input(observation, hunger)
        # policies are ordered as the values are; one policy takes all rows
        policy = self.policy(
            policy_input if self.has_greedy_policy else policy_input.flatten(0, -2)
        )
        pre_action = policy.sample()
        action = torch.tanh(pre_action)
        batch_size = policy_input.shape[-2]
        if len(action) > batch_size:
            action = action.unflatten(0, (-1, batch_size))[: len(self.discounts)]
        value = self.target_critics.lower(policy_input, action)
        if self.soft_backup:
            log_prob = policy.log_prob(pre_action)
            if self.has_greedy_policy:  # which alone is charged, at a price of its own
                cost = log_prob[:batch_size] - log_abs_det_tanh(pre_action[:batch_size])
                value[0] -= self.log_temperature[0].exp() * cost
            else:
                cost = log_prob - self.prior.log_prob(pre_action)
                cost = cost.unflatten(0, (-1, batch_size))
                coefficient = self._coefficient(hunger) if self.has_curiosity_critic else None
                shares = price_shares(hunger, coefficient).reshape(len(value), -1)
                value -= self.log_temperature.exp() * shares * cost
        return value

    def _update_actor(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        policy_input: Float[Tensor, "batch policy_input_dim"],
        bonus: Tensor | BonusFunction | None,
        hunger: Hunger,
    ) -> tuple[PolicySample, dict[str, Tensor]]:
        """Step the policies on a part of the batch; return their sample and what to log."""
        observation = observation[:: self.actor_stride]
        policy_input = policy_input[:: self.actor_stride]
        hunger = hunger[:: self.actor_stride] if hunger.ndim else hunger
        policy = self.policy(policy_input)
        shape = len(self.log_temperature), len(policy_input)
        weight = policy.log_weight.exp().mT.unflatten(-1, shape)
        # one pre-action of each component, components leading: unbiased and differentiable in
        # the weights as well
        pre_action = policy.component_samples(torch.randn_like(policy.loc)).transpose(0, 1)
        log_prob = policy.log_prob(pre_action).unflatten(-1, shape)
        pre_action = pre_action.unflatten(1, shape)
        log_prior = self.prior.log_prob(pre_action[:, -1:])
        if self.has_greedy_policy:  # whose prior is uniform
            log_prior = torch.cat([log_abs_det_tanh(pre_action[:, :1]), log_prior], dim=1)
        information_cost = log_prob - log_prior
        action = torch.tanh(pre_action)
        value, curiosity_value = self._values(observation, policy_input, action, bonus, hunger)
        if self.has_greedy_policy:  # hungry for reward alone
            hunger = torch.stack([torch.ones_like(hunger), hunger]).unsqueeze(-1)
        loss = actor_loss(
            information_cost,
            value,
            curiosity_value,
            temperature=self.log_temperature.detach().exp().unsqueeze(-1),
            hunger=hunger,
            weight=weight,
        )
        self.optimizers["policy"].step(loss)
        metrics = {
            "policy_loss": loss.detach(),
            "policy_std": (0.5 * policy.log_var.detach()[-shape[1] :]).exp().mean(),
        }
        sample = PolicySample(pre_action.detach(), information_cost.detach(), weight.detach())
        return sample, metrics

    def _values(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        policy_input: Float[Tensor, "batch policy_input_dim"],
        action: Float[Tensor, "components policies batch action_dim"],
        bonus: Tensor | BonusFunction | None,
        hunger: Hunger,
    ) -> tuple[
        Float[Tensor, "components policies batch"],
        Float[Tensor, "components policies batch"] | float,
    ]:
        """Value of the reward and weighted curiosity value of the policies' actions."""
        shape = action.shape[:-1]
        policy_input = policy_input.repeat(shape[0] * shape[1], 1)
        alternate = self.config.actor_q == "alternate"
        value = self.critics.of_reward(policy_input, action.flatten(0, 2), alternate=alternate)
        value = value.unflatten(0, shape)
        if bonus is None:
            return value, 0.0
        curious = action[:, -1].flatten(0, 1)
        policy_input = policy_input[: len(curious)]
        if self.has_curiosity_critic:
            curiosity_value = self.critics.of_others(policy_input, curious)[0]
        else:
            assert not isinstance(bonus, Tensor)
            curiosity_value = bonus(observation.repeat(shape[0], 1), curious)
            num_rows = len(curious)
            self._check_bonus(curiosity_value, num_rows, num_rows, "policy's actions")
            std = curiosity_value.detach().std(correction=0)
            self.value_stds[1:].lerp_(std.expand(1), 1 - STD_DECAY)
        curiosity_value = curiosity_value.unflatten(0, (shape[0], shape[2]))
        curiosity_value = self._coefficient(hunger) * curiosity_value
        of_greed = [torch.zeros_like(curiosity_value)] * self.has_greedy_policy
        return value, torch.stack([*of_greed, curiosity_value], dim=1)

    def _coefficient(self, hunger: Hunger) -> Hunger:
        """Weight of the curiosity value in the policy's objective at each hunger."""
        if not self.curiosity:
            return torch.zeros_like(hunger)
        if self.is_conditioned:
            ratio = self._ratio_of_spreads(torch.ones_like(hunger))
            adaptive = (1 - hunger) / ratio.clamp(min=PARITY_FLOOR)
        else:  # in the policy's objective, where reward's value counts `hunger` times
            adaptive = self._ratio_of_spreads(hunger)
        return torch.where(self._fixed_coefficient < 0, adaptive, self._fixed_coefficient)

    def _ratio_of_spreads(self, hunger: Hunger) -> Hunger:
        """By how much curiosity distinguishes states, over hunger times reward; at most 1."""
        reward_std, curiosity_std = self.value_stds
        tiny = torch.finfo(reward_std.dtype).tiny
        return (curiosity_std / (hunger * reward_std).clamp(min=tiny)).clamp(max=1.0)

    def _update_prior(self, sample: PolicySample) -> dict[str, Tensor]:
        """Fit a learned prior to what the curious policy does.

        The greedy one does little where nothing was found that pays; a prior that followed it
        would hold the curious one to as little.
        """
        if "prior" not in self.optimizers:
            return {}
        pre_action, weight = sample.pre_action[:, -1], sample.weight[:, -1]
        loss = prior_loss(self.prior.log_prob(pre_action), weight)
        self.optimizers["prior"].step(loss)
        return {"prior_log_prob": -loss.detach()}

    def _update_temperature(self, sample: PolicySample) -> dict[str, Tensor]:
        """Adjust the price of a nat, where it is tuned, to hold the information rate."""
        rate = (sample.weight * sample.information_cost).sum(0) + self.log_excess
        metrics = {
            "information_rate": rate[-1].mean(),
            "temperature": self.log_temperature.detach()[-1].exp(),
        }
        if self.tunes_temperature:
            loss = temperature_loss(self.log_temperature, rate, self.target_information_rate)
            self.optimizers["temperature"].step(loss)
            with torch.no_grad():  # a rate out of reach would drive it out of float32
                self.log_temperature.clamp_(*LOG_TEMPERATURES)
        return metrics

    def _trained_parameters(self) -> dict[str, list[nn.Parameter]]:
        parameters: dict[str, list[nn.Parameter]] = {
            "policy": list(self.policy.parameters()),
            "critics": list(self.critics.parameters()),
            "prior": list(self.prior.parameters()),
            "temperature": [self.log_temperature] if self.tunes_temperature else [],
        }
        return {name: own for name, own in parameters.items() if own}


def _step_what_was_loaded(agent: CuriousSAC, _: object) -> None:
    """Give the optimisers the parameters of now: with `assign`, loading puts others there."""
    for name, parameters in agent._trained_parameters().items():
        agent.optimizers[name].replace_targets(parameters)


def _check_parts(config: Any, curiosity: Any) -> None:
    """Reject what is no configuration of an agent, and what is no answer to yes or no."""
    if not isinstance(config, AgentConfig):
        raise TypeError(f"`config` must be an AgentConfig, got {config!r}.")
    check_flags(curiosity=curiosity)


def _check_number(name: str, value: float, **bounds: float) -> None:
    """Reject what is no finite number, or one out of the bounds of `setting`."""
    if not is_number(value):
        raise ValueError(f"`{name}` must be a finite number, got {value!r}.")
    check_range(name, float(value), bounds)


def _check_steady(config: AgentConfig) -> None:
    """Reject settings that nothing would carry out in a loop of one's own.

    Raises:
        ValueError: Naming the first of them, and what does its work there.
    """
    for name, value in (("hunger", config.hunger), ("temperature", config.temperature)):
        if isinstance(value, Schedule) and value.shape != "constant":
            raise ValueError(
                f"`{name}` must be one number where no trainer carries a schedule out, got "
                f"{value}; set `agent.{name}` as time goes by."
            )
    if config.curiosity.ends is not None:
        raise ValueError(
            "`curiosity_ends` must be left out, got "
            f"{config.curiosity.ends}: only the trainer counts steps; set "
            "`agent.curiosity_coefficient` to 0 when it is time."
        )


def check_rate(rate: float, action_dim: int) -> None:
    """Reject a target information rate that no policy holds.

    Raises:
        ValueError: If it is not positive, since no policy is equal to the prior, or so high that
            only actions pressed to the edge of their box would reach it.
    """
    if not 0 < rate <= MOST_NATS * action_dim:
        raise ValueError(
            f"`target_information_rate` must be positive and at most {MOST_NATS * action_dim} for "
            f"{action_dim} action dimensions, got {rate}."
        )


def sample_hunger(like: Float[Tensor, " batch"]) -> Float[Tensor, " batch"]:
    """Hungers to relabel a batch with: a quarter at each end, the others between them."""
    return (2 * torch.rand_like(like) - 0.5).clamp(0.0, 1.0)


def _as_hunger(value: Any, like: Tensor) -> Tensor:
    """Numbers as a tensor in the precision of the networks, where they are."""
    try:
        return torch.as_tensor(value, dtype=like.dtype, device=like.device)
    except (TypeError, ValueError, RuntimeError):
        raise TypeError(
            f"`hunger` must be a number, or one for each observation, got {value!r}."
        ) from None


def _check_hunger(hunger: Tensor, batch_size: int) -> None:
    """Reject what is no hunger of a conditioned agent; values outside of graphs alone."""
    if hunger.shape not in ((), (batch_size,)):
        raise ValueError(
            f"`hunger` must be one number or {batch_size}, got shape {tuple(hunger.shape)}."
        )
    if torch.compiler.is_compiling():
        return
    inside = (hunger >= 0) & (hunger <= 1)
    if not inside.all():
        wrong = hunger[~inside].flatten()[0].item()
        raise ValueError(f"`hunger` must lie in [0, 1] where conditioned, got {wrong}.")


def _first_hunger(config: AgentConfig) -> float:
    """Hunger of the agent until another is set."""
    hunger = config.hunger
    if isinstance(hunger, ConditionedHunger):
        return hunger.value
    return hunger(0.0) if isinstance(hunger, Schedule) else hunger
