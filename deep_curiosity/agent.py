"""The curious agent: soft actor-critic with an action prior and a second, curious value."""

import math
from collections.abc import Sequence
from copy import deepcopy
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.action_prior import ActionMarginal, FlatPrior
from deep_curiosity.actor_critic import Critics, GaussianPolicy
from deep_curiosity.bonus import Bonus
from deep_curiosity.losses import (
    actor_loss,
    critic_loss,
    critic_target,
    prior_loss,
    temperature_loss,
)
from deep_curiosity.optimization import Adam
from deep_curiosity.transitions import Transition, check_batch, check_transition

SPREAD_DECAY = 0.99  # of the running spreads of the values, for each update
NUM_PRIOR_DRAWS = 256  # for the reported divergence of the prior from uniform
RATE_PER_ACTION_DIM = {
    "uniform": 1 + math.log(2),  # nats from uniform: soft actor-critic's target entropy of -1
    "learned": 1.0,
}


class PolicyDraws(NamedTuple):
    """What the actor's step leaves to the prior's and the temperature's, without gradient."""

    pre_action: Float[Tensor, "modes batch action_dim"]
    information_cost: Float[Tensor, "modes batch"]
    weight: Float[Tensor, "modes batch"]


class CuriousActorCritic(nn.Module):
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
        hunger: Weight of the extrinsic value, alpha.
        yielding: Let curiosity yield to reward: its value is weighed by the ratio of the spreads
            of `Q_D` and `Q` over replay, at most 1. While no state is worth more than another,
            curiosity has its full weight; where reward tells states apart, it fades.
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
        polyak: Share of the critics that moves into the target critics at each update.

    Raises:
        ValueError: If a number is out of range.

    Reference: Still & Precup (2012), equations (10), (14), (21); Haarnoja et al., "Soft
    Actor-Critic Algorithms and Applications" (2018), https://arxiv.org/abs/1812.05905.
    """

    _hunger: Tensor
    discounts: Tensor
    spreads: Tensor
    prior: FlatPrior | ActionMarginal

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
        hunger: float = 1.0,
        yielding: bool = False,
        prior: Literal["uniform", "learned"] = "uniform",
        temperature: float = 1.0,
        tune_temperature: bool = True,
        target_information_rate: float | None = None,
        soft_backup: bool | None = None,
        learning_rate: float = 3e-4,
        polyak: float = 0.005,
    ) -> None:
        super().__init__()
        _check_discount("discount", discount)
        _check_discount("curiosity_discount", curiosity_discount)
        _check_positive("learning_rate", learning_rate)
        if not 0 < polyak <= 1:
            raise ValueError(f"`polyak` must lie in (0, 1], got {polyak}.")
        if prior not in RATE_PER_ACTION_DIM:
            raise ValueError(f"`prior` must be 'uniform' or 'learned', got {prior!r}.")
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.curiosity = curiosity
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
        self.polyak = polyak

        has_curiosity_critic = curiosity and curiosity_discount > 0
        discounts = [discount, curiosity_discount] if has_curiosity_critic else [discount]
        self.policy = GaussianPolicy(
            observation_dim, action_dim, modes=policy_modes, hidden_dims=hidden_dims
        )
        self.critics = Critics(
            observation_dim, action_dim, pairs=len(discounts), hidden_dims=hidden_dims
        )
        self.target_critics = deepcopy(self.critics).requires_grad_(False)
        self.prior = FlatPrior(action_dim) if prior == "uniform" else ActionMarginal(action_dim)
        self.log_temperature = nn.Parameter(torch.zeros(()), requires_grad=tune_temperature)
        self.register_buffer("_hunger", torch.zeros(()))
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
        self._hunger.fill_(value)

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
        """Weight of the curiosity value in the actor: 1, or less where curiosity yields."""
        if not (self.yielding and self._has_curiosity_critic):
            return torch.ones_like(self._hunger)
        extrinsic, curious = self.spreads
        return (curious / extrinsic.clamp(min=torch.finfo(extrinsic.dtype).tiny)).clamp(max=1.0)

    @torch.no_grad()
    def act(
        self, observation: Float[Tensor, "batch observation_dim"], *, deterministic: bool = False
    ) -> Float[Tensor, "batch action_dim"]:
        """Draw actions in [-1, 1], or take the centre of the policy."""
        dtype = self.log_temperature.dtype
        check_batch("observation", observation, self.observation_dim, dtype)
        policy = self.policy(observation)
        if deterministic:
            return policy.mode
        return torch.tanh(policy.draw())

    def update(self, transition: Transition, bonus: Bonus | None = None) -> dict[str, Tensor]:
        """Take one gradient step on every part.

        Args:
            transition: A batch from replay, its reward as the environment gave it.
            bonus: Asked afresh for the batch, so that nothing in replay is ever stale.

        Returns:
            What to log: detached 0-d tensors, information in nats.

        Raises:
            TypeError: If a field of the transition has the wrong kind.
            ValueError: If a bonus is given to an agent without curiosity, or not to a curious one,
                or a field of the transition has the wrong shape or holds NaN or infinity.
        """
        if self.curiosity != (bonus is not None):
            raise ValueError(
                "`bonus` must be given if and only if the agent has `curiosity`, "
                f"got {bonus!r} with curiosity={self.curiosity}."
            )
        dtype = self.log_temperature.dtype
        check_transition(transition, self.observation_dim, self.action_dim, dtype)
        metrics = self._update_critics(transition, bonus)
        policy_draws, actor_metrics = self._update_actor(transition, bonus)
        metrics |= actor_metrics | self._update_prior(policy_draws)
        metrics |= self._update_temperature(policy_draws)
        self._move_targets()
        return metrics

    @torch.no_grad()
    def metrics(self) -> dict[str, Tensor]:
        """What is too dear for every update: how far a learned prior is from uniform, in nats."""
        metrics = {"curiosity_share": self.curiosity_share} if self._has_curiosity_critic else {}
        if isinstance(self.prior, FlatPrior):
            return metrics
        generator = torch.Generator().manual_seed(0)  # leaves the global stream where it is
        noise = torch.randn(NUM_PRIOR_DRAWS, self.action_dim, generator=generator)
        kl = self.prior.kl_to_uniform(noise.to(self.log_temperature))
        return metrics | {"prior_kl_to_uniform": kl}

    def _update_critics(self, transition: Transition, bonus: Bonus | None) -> dict[str, Tensor]:
        value = self.critics(transition.observation, transition.action)  # pairs 2 batch
        target = self._targets(transition, bonus)  # pairs batch
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
        self, transition: Transition, bonus: Bonus | None
    ) -> Float[Tensor, "pairs batch"]:
        """Targets of the extrinsic value and, where it is learned, of the curiosity value."""
        next_policy = self.policy(transition.next_observation)
        pre_action = next_policy.draw()
        next_value = self.target_critics.lower(transition.next_observation, torch.tanh(pre_action))
        if self.soft_backup:
            information_cost = next_policy.log_prob(pre_action) - self.prior.log_prob(pre_action)
            next_value[0] -= self.log_temperature.exp() * information_cost
        rewards = [transition.reward]
        if bonus is not None and self._has_curiosity_critic:
            observation, action, _, next_observation, *_ = transition
            rewards.append(bonus(observation, action, next_observation))
        return critic_target(
            torch.stack(rewards), transition.terminated, next_value, self.discounts
        )

    def _update_actor(
        self, transition: Transition, bonus: Bonus | None
    ) -> tuple[PolicyDraws, dict[str, Tensor]]:
        """Step the policy; return its draws and what to log."""
        policy = self.policy(transition.observation)
        weight = policy.log_weight.exp()
        pre_action = policy.pre_actions(torch.randn_like(policy.loc))
        information_cost = policy.log_prob(pre_action) - self.prior.log_prob(pre_action)
        value, curiosity_value = self._values(
            transition.observation, torch.tanh(pre_action), bonus
        )
        loss = actor_loss(
            information_cost,
            value,
            curiosity_value,
            temperature=self.log_temperature.detach().exp(),
            hunger=self._hunger,
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
        bonus: Bonus | None,
    ) -> tuple[Float[Tensor, "modes batch"], Float[Tensor, "modes batch"] | float]:
        """Extrinsic and curiosity value of the policy's actions, for the actor to climb."""
        modes, batch, _ = action.shape
        observation, action = observation.repeat(modes, 1), action.flatten(0, 1)
        value = self.critics.lower(observation, action).unflatten(-1, (modes, batch))
        if self._has_curiosity_critic:
            return value[0], self.curiosity_share * value[1]
        if bonus is None:
            return value[0], 0.0
        return value[0], bonus(observation, action).unflatten(0, (modes, batch))

    def _update_prior(self, draws: PolicyDraws) -> dict[str, Tensor]:
        if isinstance(self.prior, FlatPrior):
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
    def _has_curiosity_critic(self) -> bool:
        return self.critics.pairs == 2

    @property
    def _log_volume(self) -> float:
        """What turns a cost relative to the prior in use into nats from a normalised prior."""
        return self.prior.log_volume if isinstance(self.prior, FlatPrior) else 0.0


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"`{name}` must be finite and positive, got {value}.")


def _check_discount(name: str, value: float) -> None:
    if not 0 <= value < 1:
        raise ValueError(f"`{name}` must lie in [0, 1), got {value}.")
