"""The curious agent: soft actor-critic with an action prior and a second, curious value."""

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.agent.action_information import action_information
from deep_curiosity.agent.prior import LearnedPrior, UniformPrior
from deep_curiosity.agent.policy import Critics, GaussianPolicy
from deep_curiosity.losses import (
    actor_loss,
    critic_loss,
    critic_target,
    multi_step_target,
    prior_loss,
    temperature_loss,
)
from deep_curiosity.nn.adam import Adam
from deep_curiosity.transitions import (
    Sequences,
    Transition,
    check_batch,
    check_counts,
    check_transition,
    first_of,
)

SPREAD_DECAY = 0.99  # of the running spreads of the values, for each update
PARITY_FLOOR = 1e-3  # of the spreads' ratio: a dial lifts curiosity by no more than a thousand
NUM_PRIOR_DRAWS = 256  # for the reported divergence of the prior from uniform
RATE_PER_ACTION_DIM = {
    "uniform": 1 + math.log(2),  # nats from uniform: soft actor-critic's target entropy of -1
    "learned": 1.0,
}

BonusFunction = Callable[..., Tensor]
"""A bonus as the agent sees it: of observations, actions and, if known, next observations."""
Hunger = Float[Tensor, ""] | Float[Tensor, " batch"]  # one for all, or one for each


class PolicyDraws(NamedTuple):
    """What the actor's step leaves to the prior's and the temperature's, without gradient."""

    pre_action: Float[Tensor, "modes batch action_dim"]
    information_cost: Float[Tensor, "modes batch"]
    weight: Float[Tensor, "modes batch"]


class CuriousSAC(nn.Module):
    r"""Actor-critic whose policy follows equation (21).

    .. math:: \pi(a|x) \propto p(a) \exp((Q_D(x, a) + \alpha Q(x, a)) / \lambda)

    `Q` is the extrinsic value, `Q_D` the discounted sum of the bonus under its own discount. The
    two are learned apart, so `hunger` (alpha) and `temperature` (lambda) may be set at any step.
    Without a bonus and with the uniform prior this is soft actor-critic.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        hidden_dims: Width of every hidden layer of policy and critics.
        policy_modes: Gaussians that make up the policy. The actor's step costs as many passes
            through the critics; an optimum with two peaks needs two.
        discount: Of the extrinsic reward, per step.
        curiosity: Whether `update` is given a bonus.
        curiosity_discount: Of the bonus, per step. 0 is the paper's equation as written: the actor
            climbs the bonus itself, differentiated through the model, and no critic learns it.
        reward_steps: Steps of reward that are summed before the extrinsic value is trusted;
            `update` must be given sequences where it or the next is above 1. With `soft_backup`
            only the information cost after the last of them is charged.
        curiosity_steps: Steps of bonus that are summed before the curiosity value is trusted.
        curiosity_episodic: Whether the curiosity value ends where the world does. Otherwise it
            looks past the end, as in Burda et al. (2018), https://arxiv.org/abs/1810.12894.
        hunger: Weight of the extrinsic value, alpha.
        dial: Tell policy and critics the hunger, a number in [0, 1], and train them for all of it:
            every transition is relabelled with a hunger of its own. Reward weighs `hunger`,
            curiosity `1 - hunger`, each in units of the spread of its value where reward's is the
            larger. One agent is then every agent from purely curious (0) to purely greedy (1).
        yielding: Without a dial, let curiosity yield to reward: its value is weighed by the ratio
            of the spreads of `Q_D` and `Q` over replay, at most 1. While no state is worth more
            than another, curiosity has its full weight; where reward tells states apart, it fades.
        prior: `"uniform"` for soft actor-critic's flat prior, `"learned"` for the action marginal.
        temperature: Price of a nat, lambda; the initial one where it is tuned.
        tune_temperature: Adjust the temperature to hold `target_information_rate`, the dual (10).
        target_information_rate: Nats per action by which the policy may differ from the prior. By
            default `1 + log 2` per action dimension from the uniform prior, which is the usual
            target entropy of `-action_dim`, and 1 per action dimension from the learned one.
        soft_backup: Charge the extrinsic value with the information cost of later actions, as soft
            actor-critic does. By default only with the uniform prior: the paper keeps the value
            purely about reward.
        learning_rate: Of Adam, for every part.
        actor_stride: Policy, prior and temperature learn from one in as many transitions of a
            batch, the critics from them all. Their gradient stays right on average and costs as
            many times less.
        critic_per_row: Let the policy climb one critic of each pair at each transition, in turn,
            for half of what both cost; otherwise the smaller of both, as soft actor-critic does.
            What critics learn from is always the smaller. Fujimoto et al., "Addressing Function
            Approximation Error in Actor-Critic Methods" (2018), let the policy climb one critic.
        polyak: Share of the critics that moves into the target critics at each update.

    Raises:
        ValueError: If a number is out of range.

    Reference: Still & Precup (2012), equations (10), (14), (21); Haarnoja et al., "Soft
    Actor-Critic Algorithms and Applications" (2018), https://arxiv.org/abs/1812.05905.
    """

    _hunger: Tensor
    _curiosity_weight: Tensor
    discounts: Tensor
    spreads: Tensor
    prior: UniformPrior | LearnedPrior

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        hidden_dims: Sequence[int] = (256, 256),
        policy_modes: int = 1,
        discount: float = 0.99,
        curiosity: bool = True,
        curiosity_discount: float = 0.97,
        reward_steps: int = 1,
        curiosity_steps: int = 1,
        curiosity_episodic: bool = True,
        hunger: float = 1.0,
        dial: bool = False,
        yielding: bool = False,
        prior: Literal["uniform", "learned"] = "uniform",
        temperature: float = 1.0,
        tune_temperature: bool = True,
        target_information_rate: float | None = None,
        soft_backup: bool | None = None,
        learning_rate: float = 3e-4,
        actor_stride: int = 1,
        critic_per_row: bool = False,
        polyak: float = 0.005,
    ) -> None:
        super().__init__()
        _check_discount("discount", discount)
        _check_discount("curiosity_discount", curiosity_discount)
        _check_positive("learning_rate", learning_rate)
        check_counts(
            reward_steps=reward_steps, curiosity_steps=curiosity_steps, actor_stride=actor_stride
        )
        if not 0 < polyak <= 1:
            raise ValueError(f"`polyak` must lie in (0, 1], got {polyak}.")
        if prior not in RATE_PER_ACTION_DIM:
            raise ValueError(f"`prior` must be 'uniform' or 'learned', got {prior!r}.")
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.curiosity = curiosity
        self.num_steps = (reward_steps, curiosity_steps)
        """Steps that are summed in the target of each value."""
        self.curiosity_episodic = curiosity_episodic
        self.dial = dial
        self.yielding = yielding
        self.tune_temperature = tune_temperature
        self.soft_backup = prior == "uniform" if soft_backup is None else soft_backup
        if target_information_rate is None:
            target_information_rate = RATE_PER_ACTION_DIM[prior] * action_dim
        if not math.isfinite(target_information_rate):
            raise ValueError(
                f"`target_information_rate` must be finite, got {target_information_rate}."
            )
        self.target_information_rate = target_information_rate
        self.actor_stride = actor_stride
        self.critic_per_row = critic_per_row
        self.polyak = polyak

        learns_curiosity = curiosity and curiosity_discount > 0
        discounts = [discount, curiosity_discount] if learns_curiosity else [discount]
        seen_dim = observation_dim + int(dial)
        self.policy = GaussianPolicy(
            seen_dim, action_dim, modes=policy_modes, hidden_dims=hidden_dims
        )
        self.critics = Critics(seen_dim, action_dim, pairs=len(discounts), hidden_dims=hidden_dims)
        self.target_critics = deepcopy(self.critics).requires_grad_(False)
        self.prior = UniformPrior(action_dim) if prior == "uniform" else LearnedPrior(action_dim)
        self.log_temperature = nn.Parameter(torch.zeros(()), requires_grad=tune_temperature)
        self.register_buffer("_hunger", torch.zeros(()))
        self.register_buffer("_curiosity_weight", torch.ones(()))
        self.register_buffer("discounts", torch.tensor(discounts).unsqueeze(-1))  # pairs 1
        self.register_buffer("spreads", torch.zeros(len(discounts)))  # of each value over replay
        self.temperature = temperature
        self.hunger = hunger
        self.optimizers = nn.ModuleDict(
            {
                name: Adam(parameters, learning_rate)
                for name, parameters in self._trained_parameters().items()
            }
        )

    @property
    def hunger(self) -> float:
        """Weight of the extrinsic value, alpha; may be set at any step."""
        return self._hunger.item()

    @hunger.setter
    def hunger(self, value: float) -> None:
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"`hunger` must be finite and not negative, got {value}.")
        if self.dial and value > 1:
            raise ValueError(f"`hunger` must lie in [0, 1] on a dial, got {value}.")
        self._hunger.fill_(value)

    @property
    def curiosity_weight(self) -> float:
        """Factor of the curiosity value in the actor, 1; set to 0 to switch curiosity off."""
        return self._curiosity_weight.item()

    @curiosity_weight.setter
    def curiosity_weight(self, value: float) -> None:
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"`curiosity_weight` must be finite and not negative, got {value}.")
        self._curiosity_weight.fill_(value)

    @property
    def temperature(self) -> float:
        """Price of a nat, lambda; may be set at any step, and is tuned on from there."""
        return self.log_temperature.exp().item()

    @temperature.setter
    def temperature(self, value: float) -> None:
        _check_positive("temperature", value)
        with torch.no_grad():
            self.log_temperature.fill_(math.log(value))

    @property
    def curiosity_share(self) -> Tensor:
        """Weight of the curiosity value in the actor, at the hunger of now."""
        return self._share_of_curiosity(self._hunger)

    def seen(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        hunger: Tensor | None = None,
    ) -> Float[Tensor, "batch seen_dim"]:
        """What policy and critics are given: the observation, and behind it a dial's hunger.

        Args:
            observation: As the environment gave it.
            hunger: One for all or one for each; the agent's own by default.

        Raises:
            ValueError: If there is neither one hunger nor one for each.
        """
        if not self.dial:
            return observation
        hunger = self._hunger if hunger is None else hunger
        if hunger.shape not in ((), observation.shape[:1]):
            raise ValueError(
                f"`hunger` must be one number or {len(observation)}, got shape "
                f"{tuple(hunger.shape)}."
            )
        return torch.cat([observation, hunger.expand(len(observation)).unsqueeze(-1)], dim=-1)

    @torch.no_grad()
    def act(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        *,
        deterministic: bool = False,
        hunger: Tensor | None = None,
    ) -> Float[Tensor, "batch action_dim"]:
        """Draw actions in [-1, 1], or take the centre of the policy.

        Args:
            observation: Where.
            deterministic: Take the centre.
            hunger: On a dial, one for all or one for each; the agent's own by default.
        """
        dtype = self.log_temperature.dtype
        check_batch("observation", observation, self.observation_dim, dtype)
        policy = self.policy(self.seen(observation, hunger))
        if deterministic:
            return policy.mode
        return torch.tanh(policy.draw())

    def update(
        self, batch: Transition | Sequences, bonus: BonusFunction | None = None
    ) -> dict[str, Tensor]:
        """Take one gradient step on every part.

        Args:
            batch: From replay, the reward as the environment gave it; sequences where more than
                one step is to be summed.
            bonus: BonusFunction afresh for the batch, so that nothing in replay is ever stale.

        Returns:
            What to log: detached 0-d tensors, information in nats.

        Raises:
            TypeError: If a field of the transition has the wrong kind.
            ValueError: If a bonus is given to an agent without curiosity, or not to a curious one,
                or a field of the transition has the wrong shape or holds NaN or infinity, or
                sequences are shorter than the steps to be summed.
        """
        if self.curiosity != (bonus is not None):
            raise ValueError(
                "`bonus` must be given if and only if the agent has `curiosity`, "
                f"got {bonus!r} with curiosity={self.curiosity}."
            )
        transition = first_of(batch)
        self._check_update(batch)
        hunger = self._drawn_hunger(transition.reward) if self.dial else self._hunger
        metrics = self._update_critics(batch, bonus, hunger)
        taken = self._thinned(transition.observation, hunger)
        policy_draws, actor_metrics = self._update_actor(*taken, bonus)
        metrics |= actor_metrics | self._update_prior(policy_draws)
        metrics |= self._update_temperature(policy_draws)
        self._move_targets()
        return metrics

    @torch.no_grad()
    def metrics(
        self, observation: Float[Tensor, "batch observation_dim"] | None = None
    ) -> dict[str, Tensor]:
        """What is too dear for every update, information in nats.

        Args:
            observation: States as the agent meets them, over which the information that actions
                carry about them is estimated from both sides; not told without.
        """
        metrics = {"hunger": self._hunger.clone()}
        if self.has_curiosity_critic:
            metrics["curiosity_share"] = self.curiosity_share
        if observation is not None:
            policy = self.policy(self.seen(observation))
            with torch.random.fork_rng():  # leaves the global stream where it is
                torch.manual_seed(0)
                information = action_information(policy, policy.draw())
            metrics["action_information_lower"] = information.lower
            metrics["action_information_upper"] = information.upper
        if not isinstance(self.prior, UniformPrior):
            generator = torch.Generator().manual_seed(0)
            noise = torch.randn(NUM_PRIOR_DRAWS, self.action_dim, generator=generator)
            kl = self.prior.kl_to_uniform(noise.to(self.log_temperature))
            metrics["prior_kl_to_uniform"] = kl
        return metrics

    def _drawn_hunger(self, like: Float[Tensor, " batch"]) -> Float[Tensor, " batch"]:
        """A quarter at each end of the dial, the others uniform between them."""
        return (2 * torch.rand_like(like) - 0.5).clamp(0.0, 1.0)

    def _check_update(self, batch: Transition | Sequences) -> None:
        steps, length = (
            (batch.steps, len(batch.alive)) if isinstance(batch, Sequences) else (batch, 1)
        )
        if length < max(self.num_steps):
            raise ValueError(
                f"`batch` must hold sequences of at least {max(self.num_steps)} steps, "
                f"got {length}."
            )
        dtype = self.log_temperature.dtype
        check_transition(steps, self.observation_dim, self.action_dim, dtype)

    def _update_critics(
        self, batch: Transition | Sequences, bonus: BonusFunction | None, hunger: Hunger
    ) -> dict[str, Tensor]:
        if isinstance(batch, Sequences):
            transition, target = batch.first, self._targets_ahead(batch, bonus, hunger)
        else:
            transition, target = batch, self._targets(batch, bonus, hunger)
        seen = self.seen(transition.observation, hunger)
        value = self.critics(seen, transition.action)  # pairs 2 batch
        loss = critic_loss(value, target.unsqueeze(1))
        self._step("critics", loss)
        value = value.detach()
        self.spreads.lerp_(value.mean(1).std(-1, correction=0), 1 - SPREAD_DECAY)
        return {
            "critic_loss": loss.detach(),
            "value": value[0].mean(),
            "curiosity_value": value[1:].sum(0).mean(),
        }

    @torch.no_grad()
    def _targets(
        self, transition: Transition, bonus: BonusFunction | None, hunger: Hunger
    ) -> Float[Tensor, "pairs batch"]:
        """One-step targets of the extrinsic value and, where it is learned, of the curious one."""
        next_value = self._next_values(transition.next_observation, hunger)
        rewards, ends = self._rewards(transition, bonus), transition.terminated
        if not self.curiosity_episodic and self.has_curiosity_critic:
            ends = torch.stack([ends, torch.zeros_like(ends)])
        return critic_target(rewards, ends, next_value, self.discounts)

    @torch.no_grad()
    def _targets_ahead(
        self, sequences: Sequences, bonus: BonusFunction | None, hunger: Hunger
    ) -> Float[Tensor, "pairs batch"]:
        """The same over several steps, for each value as many as are its own."""
        rewards = self._rewards(sequences.steps, bonus).unflatten(-1, sequences.alive.shape)
        lasts = {number: sequences.last(number) for number in set(self.num_steps)}
        next_values = {
            number: self._next_values(last.next_observation, hunger)
            for number, last in lasts.items()
        }
        targets = []
        for pair, reward in enumerate(rewards):
            number = self.num_steps[pair]
            ends = lasts[number].terminated
            if pair == 1 and not self.curiosity_episodic:
                ends = torch.zeros_like(ends)
            targets.append(
                multi_step_target(
                    reward[:number],
                    sequences.alive[:number],
                    ends,
                    next_values[number][pair],
                    self.discounts[pair],
                )
            )
        return torch.stack(targets)

    def _rewards(
        self, transition: Transition, bonus: BonusFunction | None
    ) -> Float[Tensor, "pairs batch"]:
        """Reward and, where its value is learned, bonus."""
        rewards = [transition.reward]
        if bonus is not None and self.has_curiosity_critic:
            observation, action, _, next_observation, *_ = transition
            rewards.append(bonus(observation, action, next_observation))
        return torch.stack(rewards)

    def _next_values(
        self, observation: Float[Tensor, "batch observation_dim"], hunger: Hunger
    ) -> Float[Tensor, "pairs batch"]:
        """Values of the states that are reached, under the policy of now."""
        seen = self.seen(observation, hunger)
        policy = self.policy(seen)
        pre_action = policy.draw()
        value = self.target_critics.lower(seen, torch.tanh(pre_action))
        if self.soft_backup:
            information_cost = policy.log_prob(pre_action) - self.prior.log_prob(pre_action)
            value[0] -= self.log_temperature.exp() * information_cost
        return value

    def _thinned(
        self, observation: Float[Tensor, "batch observation_dim"], hunger: Hunger
    ) -> tuple[Tensor, Tensor]:
        """Observations from which the actor learns, and the hunger of each or of all."""
        rows = slice(None, None, self.actor_stride)
        return observation[rows], hunger[rows] if hunger.ndim else hunger

    def _update_actor(
        self,
        observation: Float[Tensor, "rows observation_dim"],
        hunger: Hunger,
        bonus: BonusFunction | None,
    ) -> tuple[PolicyDraws, dict[str, Tensor]]:
        """Step the policy; return its draws and what to log."""
        policy = self.policy(self.seen(observation, hunger))
        weight = policy.log_weight.exp()
        pre_action = policy.pre_actions(torch.randn_like(policy.loc))
        information_cost = policy.log_prob(pre_action) - self.prior.log_prob(pre_action)
        value, curiosity_value = self._values(observation, torch.tanh(pre_action), bonus, hunger)
        loss = actor_loss(
            information_cost,
            value,
            curiosity_value,
            temperature=self.log_temperature.detach().exp(),
            hunger=hunger,
            weight=weight,
        )
        self._step("policy", loss)
        metrics = {
            "policy_loss": loss.detach(),
            "policy_std": policy.log_std.detach().exp().mean(),
        }
        draws = PolicyDraws(pre_action.detach(), information_cost.detach(), weight.detach())
        return draws, metrics

    def _values(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "modes batch action_dim"],
        bonus: BonusFunction | None,
        hunger: Hunger,
    ) -> tuple[Float[Tensor, "modes batch"], Float[Tensor, "modes batch"] | float]:
        """Extrinsic and weighted curiosity value of the policy's actions, to be climbed."""
        modes, batch, _ = action.shape
        seen = self.seen(observation, hunger).repeat(modes, 1)
        observation, action = observation.repeat(modes, 1), action.flatten(0, 1)
        ask = self.critics.in_turn if self.critic_per_row else self.critics.lower
        value = ask(seen, action).unflatten(-1, (modes, batch))
        if self.has_curiosity_critic:
            curiosity_value = value[1]
        elif bonus is not None:
            curiosity_value = bonus(observation, action).unflatten(0, (modes, batch))
        else:
            return value[0], 0.0
        return value[0], self._share_of_curiosity(hunger) * curiosity_value

    def _share_of_curiosity(self, hunger: Hunger) -> Hunger:
        """Weight of the curiosity value in the actor at each hunger."""
        if not self.has_curiosity_critic:
            ratio = torch.ones_like(self._hunger)
        else:
            extrinsic, curious = self.spreads
            ratio = curious / extrinsic.clamp(min=torch.finfo(extrinsic.dtype).tiny)
        if self.dial:
            return self._curiosity_weight * (1 - hunger) / ratio.clamp(PARITY_FLOOR, 1.0)
        return self._curiosity_weight * (ratio.clamp(max=1.0) if self.yielding else 1.0)

    def _update_prior(self, draws: PolicyDraws) -> dict[str, Tensor]:
        if isinstance(self.prior, UniformPrior):
            return {}
        loss = prior_loss(self.prior.log_prob(draws.pre_action), draws.weight)
        self._step("prior", loss)
        return {"prior_log_prob": -loss.detach()}

    def _update_temperature(self, draws: PolicyDraws) -> dict[str, Tensor]:
        information_cost = (draws.weight * draws.information_cost).sum(0)
        rate = information_cost + self._log_volume  # nats from a normalised prior
        metrics = {
            "information_rate": rate.mean(),
            "temperature": self.log_temperature.detach().exp(),
        }
        if self.tune_temperature:
            loss = temperature_loss(self.log_temperature, rate, self.target_information_rate)
            self._step("temperature", loss)
        return metrics

    def _move_targets(self) -> None:
        """Polyak averaging, all parameters in one call."""
        targets: list[Tensor] = list(self.target_critics.parameters())
        sources: list[Tensor] = list(self.critics.parameters())
        with torch.no_grad():
            torch._foreach_lerp_(targets, sources, self.polyak)

    def _step(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        assert isinstance(optimizer, Adam)
        optimizer.step(loss)

    def _trained_parameters(self) -> dict[str, list[nn.Parameter]]:
        parts: dict[str, list[nn.Parameter]] = {
            "policy": list(self.policy.parameters()),
            "critics": list(self.critics.parameters()),
            "prior": list(self.prior.parameters()),
            "temperature": [self.log_temperature] if self.tune_temperature else [],
        }
        return {name: parameters for name, parameters in parts.items() if parameters}

    @property
    def has_curiosity_critic(self) -> bool:
        """Whether the bonus is a reward of its own, asked for once, and never climbed itself."""
        return self.critics.pairs == 2

    @property
    def _log_volume(self) -> float:
        """What turns a cost relative to the prior in use into nats from a normalised prior."""
        return self.prior.log_volume if isinstance(self.prior, UniformPrior) else 0.0


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"`{name}` must be finite and positive, got {value}.")


def _check_discount(name: str, value: float) -> None:
    if not 0 <= value < 1:
        raise ValueError(f"`{name}` must lie in [0, 1), got {value}.")
