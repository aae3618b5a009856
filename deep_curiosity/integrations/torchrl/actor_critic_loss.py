"""Torchrl's soft actor-critic loss with a second, curious value and an action prior."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, dispatch
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import SACLoss, ValueEstimators
from torchrl.objectives.sac import compute_rsample_log_prob
from torchrl.objectives.utils import _cache_values, build_value_estimator, distance_loss

from deep_curiosity.agent.config import PriorName
from deep_curiosity.agent.networks import DEFAULT_RATE, PRIORS, log_abs_det_tanh
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.torchrl.action_box import Key
from deep_curiosity.integrations.torchrl.arguments import (
    action_box,
    check_differentiable,
    check_hunger,
    check_numbers,
    check_options,
    target_entropy,
)
from deep_curiosity.integrations.torchrl.tensordicts import TransitionKeys, TransitionReader
from deep_curiosity.losses import price_shares
from deep_curiosity.nn.networks import frozen
from deep_curiosity.transitions import check_flags


class ActionSample(NamedTuple):
    """Actions of the policy, their log density and information cost in nats."""

    action: Tensor
    log_prob: Tensor
    information_cost: Tensor


class CuriousActorCriticLoss(SACLoss):
    r"""Losses of an actor-critic whose policy follows equation (21), for torchrl's loops.

    .. math:: \pi(a|x) \propto p(a) \exp((Q_D(x, a) + \alpha Q(x, a)) / \lambda)

    `Q` is learned from the reward alone and `Q_D` from the bonus, which is computed afresh for
    every batch: the reward must not hold it as well. Without a bonus and with the uniform prior
    this is `SACLoss`, to the last term. Written are `loss_actor`, `loss_qvalue` and `loss_alpha`,
    as there; `loss_curiosity` of the curiosity critics; and `loss_prior` of a learned prior. The
    gradient of each reaches its own parameters only.

    The bonus is not part of this module: a `CuriosityTransform` on the replay buffer, or a
    `BonusLoss`, lets it learn. Until it has observed a batch, it counts as zero. Where the
    transform has set observations aside, it is given these, and not what was made of them.

    Args:
        actor_network: As `SACLoss` takes it, over actions in a bounded range.
        qvalue_network: As `SACLoss` takes it; the curiosity critics get the same architecture.
        bonus: What is computed for each batch; `None` for no curiosity.
        curiosity_discount: Of the bonus, per step. 0 is the paper's equation as written: the actor
            maximises the bonus itself, differentiated through the model, and no critic learns it.
        hunger: Weight of the extrinsic value, alpha; may be set at any step.
        prior: `"uniform"` for soft actor-critic's flat prior, `"learned"` for the action marginal.
        target_information_rate: Nats per action by which the policy may differ from the prior. By
            default SACLoss's target entropy from the uniform prior, and 1.69 per action dimension
            from the learned one.
        soft_backup: Charge the values with the information cost of later actions. By default only
            without a bonus and with the uniform prior.
        action_spec: Range of the actions; that of the actor when `None`, or else [-1, 1].
        **options: Keyword arguments of `SACLoss`: `alpha_init`, `fixed_alpha`, `loss_function`,
            `num_qvalue_nets`, `reduction` and others.

    Raises:
        TypeError: If an option of `SACLoss` means nothing here, or the bonus is none.
        ValueError: If a number is out of range, or a bonus to be maximised scores outcomes.

    Reference: Still & Precup (2012), equations (10), (14), (21); Haarnoja et al., "Soft
    Actor-Critic Algorithms and Applications" (2018), https://arxiv.org/abs/1812.05905.
    """

    @dataclass
    class _AcceptedKeys(SACLoss._AcceptedKeys, TransitionKeys):
        """Keys of `SACLoss`, those a bonus needs, and those written between the two."""

        curiosity: Key = "curiosity"
        curiosity_value: Key = "curiosity_value"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    _schedulable_buffers = frozenset({"hunger"})

    hunger: Tensor
    curiosity_network: TensorDictModule
    curiosity_network_params: TensorDictParams
    target_curiosity_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        qvalue_network: TensorDictModule | list[TensorDictModule],
        bonus: Bonus | None = None,
        *,
        curiosity_discount: float = 0.97,
        hunger: float = 1.0,
        prior: PriorName = "uniform",
        target_information_rate: float | None = None,
        soft_backup: bool | None = None,
        action_spec: TensorSpec | None = None,
        **options: Any,
    ) -> None:
        check_options(options)
        check_numbers(curiosity_discount, hunger, prior, target_information_rate)
        check_differentiable(bonus, curiosity_discount)
        check_flags(soft_backup=soft_backup is not None and soft_backup)
        box = action_box(actor_network, action_spec)
        if target_information_rate is None and prior == "learned":
            target_information_rate = DEFAULT_RATE * box.dim
        super().__init__(
            actor_network,
            qvalue_network,
            action_spec=action_spec,
            target_entropy=target_entropy(target_information_rate, prior, box),
            **options,
        )
        self.box = box
        self.reader = None if bonus is None else TransitionReader(bonus, self.tensor_keys, box)
        self.curiosity_discount = curiosity_discount
        by_default = PRIORS[prior].soft_backup and bonus is None
        self.soft_backup = by_default if soft_backup is None else soft_backup
        self.prior = PRIORS[prior](box.dim) if prior == "learned" else None
        self.register_buffer("hunger", torch.tensor(float(hunger)))
        if self.has_curiosity_critic:
            self._make_curiosity_critics(actor_network, qvalue_network, options)
        self.out_keys = self._written_keys()
        self.make_value_estimator()  # now, so that the state holds its discounts from the start

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute, as `hunger`, which is checked."""
        if name == "hunger":
            check_hunger(value)
            value = value if isinstance(value, Tensor) else float(value)
        super().__setattr__(name, value)

    @property
    def bonus(self) -> Bonus | None:
        """The bonus in use."""
        return None if self.reader is None else self.reader.bonus

    @property
    def has_curiosity_critic(self) -> bool:
        """Whether the bonus is learned as a value of its own."""
        return self.reader is not None and self.curiosity_discount > 0

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """All losses on a batch, and what to log beside them.

        Raises:
            ValueError: If its rewards hold a bonus already.
        """
        loss_qvalue, critic = self.qvalue_v2_loss(tensordict)
        loss_actor, actor = self.actor_loss(tensordict)
        tensordict.set(self.tensor_keys.priority, critic.pop("td_error"))
        loss_alpha = self._alpha_loss(log_prob=actor["information_cost"])
        out = {
            "loss_actor": loss_actor,
            "loss_qvalue": loss_qvalue,
            "loss_alpha": self._reduced(loss_alpha, tensordict),
            "alpha": self._alpha,
            "entropy": -actor["log_prob"].mean(),
        }
        if self.prior is not None:
            loss_prior = -self.prior.log_prob(self.box.pre_action(actor["action"]))
            out["loss_prior"] = self._reduced(loss_prior, tensordict)
        return TensorDict(out | critic)

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of the extrinsic critics; beside it that of the curiosity critics, if any."""
        target, curiosity_target = self._targets(tensordict)
        loss, td_error = self._critic_loss(tensordict, self.qvalue_network_params, target)
        metadata = {"td_error": td_error}
        if curiosity_target is not None:
            metadata["loss_curiosity"], _ = self._critic_loss(
                tensordict, self.curiosity_network_params, curiosity_target
            )
        return loss, metadata

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        r"""Loss of the actor, :math:`E[\lambda (\log \pi - \log p) - \alpha Q - Q_D]`."""
        sample = self._sample(tensordict)
        chosen = tensordict.copy().set(self.tensor_keys.action, sample.action)
        value = self._lower_value(chosen, self._cached_detached_qvalue_params)
        loss = self._alpha * sample.information_cost - self.hunger * value
        if self.reader is not None:
            loss = loss - self._curiosity_value(chosen, self.reader)
        metadata = {name: part.detach() for name, part in sample._asdict().items()}
        return self._reduced(loss, tensordict), metadata

    def make_value_estimator(
        self, value_type: ValueEstimators | None = None, **hyperparams: Any
    ) -> "CuriousActorCriticLoss":
        """Choose how both values are estimated: TD(0), TD(1) or TD(lambda).

        Args:
            value_type: As for `SACLoss`.
            **hyperparams: As there; `gamma` is the discount of the reward alone.
        """
        super().make_value_estimator(value_type, **hyperparams)
        if self.has_curiosity_critic:
            hyperparams["gamma"] = self.curiosity_discount
            self._curiosity_estimator = build_value_estimator(
                self, self.value_type, value_network=None, **hyperparams
            )
            self._forward_value_estimator_keys()
        return self

    def _make_curiosity_critics(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        qvalue_network: TensorDictModule | list[TensorDictModule],
        options: dict[str, Any],
    ) -> None:
        """Critics of the same architecture, from parameters of their own."""
        template = qvalue_network[0] if isinstance(qvalue_network, list) else qvalue_network
        shared = list(actor_network.parameters()) if options.get("separate_losses") else None
        self.convert_to_functional(
            template,
            "curiosity_network",
            self.num_qvalue_nets,
            create_target_params=self.delay_qvalue,
            compare_against=shared,
        )

    def _sample(self, tensordict: TensorDictBase) -> ActionSample:
        """Fresh actions of the policy, differentiable."""
        with (
            set_exploration_type(ExplorationType.RANDOM),
            self.actor_network_params.to_module(self.actor_network, preserve_module_state=False),
        ):
            # which writes there, and a storage may hand out what it holds
            policy = self.actor_network.get_dist(tensordict.clone(False))
            action, log_prob = compute_rsample_log_prob(policy)
        if self.prior is None:
            return ActionSample(action, log_prob, log_prob)
        pre_action = self.box.pre_action(action)
        with frozen(self.prior):
            log_prior = self.prior.log_prob(pre_action) - log_abs_det_tanh(pre_action)
        log_prior = log_prior - self.box.log_half_volume  # density in the units of the action
        return ActionSample(action, log_prob, log_prob - log_prior)

    @torch.no_grad()
    def _targets(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor | None]:
        """Targets of the extrinsic value and, where it is learned, of the curiosity value."""
        if self.reader is not None:
            self.reader.check_unpaid(tensordict)
        tensordict = tensordict.clone(False)
        next_tensordict = tensordict.get("next")
        sample = self._sample(next_tensordict)
        chosen = next_tensordict.copy().set(self.tensor_keys.action, sample.action)
        value = self._lower_value(chosen, self.target_qvalue_network_params)
        shares = price_shares(self.hunger, torch.ones_like(self.hunger))
        if not self.has_curiosity_critic:
            shares = price_shares(self.hunger, None)
        price = self._alpha * sample.information_cost
        if self.soft_backup:
            value = value - shares[0] * price
        target = _backed_up(tensordict, value, self.value_estimator)
        if self.reader is None or not self.has_curiosity_critic:
            return target, None
        next_tensordict.set(self.tensor_keys.curiosity, self._bonus(tensordict, self.reader))
        value = self._lower_value(chosen, self.target_curiosity_network_params)
        if self.soft_backup:
            value = value - shares[1] * price
        return target, _backed_up(tensordict, value, self._curiosity_estimator)

    def _critic_loss(
        self, tensordict: TensorDictBase, params: TensorDictBase | TensorDictParams, target: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Loss summed over critics, and the largest error of each transition."""
        value = self._values(tensordict, params)
        loss = distance_loss(value, target.expand_as(value), self.loss_function).sum(0)
        return self._reduced(loss, tensordict), (value - target).abs().detach().amax(0)

    def _curiosity_value(self, chosen: TensorDictBase, reader: TransitionReader) -> Tensor:
        """Curiosity value of the policy's actions, for the actor to maximise."""
        if self.has_curiosity_critic:
            return self._lower_value(chosen, self._cached_detached_curiosity_params)
        observation, action = reader.read_pair(chosen)
        shape = chosen.get(self.tensor_keys.observation).shape[:-1]
        if not reader.bonus.ready:
            return observation.new_zeros(shape)
        bonus: Tensor = reader.bonus(observation, action)
        rows = reader.real_rows(chosen)
        return (bonus if rows is None else bonus * rows.to(bonus)).reshape(shape)

    def _bonus(self, tensordict: TensorDictBase, reader: TransitionReader) -> Tensor:
        """Bonus of each transition as a reward."""
        reward = tensordict.get(("next", self.tensor_keys.reward))
        return reader.compute(reader.read(tensordict), reward, reader.real_rows(tensordict))

    def _values(
        self, tensordict: TensorDictBase, params: TensorDictBase | TensorDictParams
    ) -> Tensor:
        """Value of each pair by each critic."""
        pair = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        values = self._vmap_qnetworkN0(pair, params)
        value: Tensor = values.get(self.tensor_keys.state_action_value).squeeze(-1)
        return value

    def _lower_value(
        self, tensordict: TensorDictBase, params: TensorDictBase | TensorDictParams
    ) -> Tensor:
        """The smallest estimate of every value, against overestimation."""
        return self._values(tensordict, params).amin(0)

    def _reduced(self, loss: Tensor, tensordict: TensorDictBase) -> Tensor:
        weights = self._maybe_get_priority_weight(tensordict)
        reduced: Tensor = self._reduce_loss(loss, tensordict=tensordict, weights=weights)
        return reduced

    @property
    @_cache_values
    def _cached_detached_curiosity_params(self) -> TensorDictBase:
        return self.curiosity_network_params.detach()

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        super()._forward_value_estimator_keys(**kwargs)
        estimator = getattr(self, "_curiosity_estimator", None)
        if estimator is not None:
            keys = self.tensor_keys
            estimator.set_keys(
                value=keys.curiosity_value,
                reward=keys.curiosity,
                done=keys.done,
                terminated=keys.terminated,
            )

    def _written_keys(self) -> list[str]:
        curiosity = ["loss_curiosity"] if self.has_curiosity_critic else []
        prior = ["loss_prior"] if self.prior is not None else []
        return ["loss_actor", "loss_qvalue", "loss_alpha", *curiosity, *prior, "alpha", "entropy"]


def _backed_up(tensordict: TensorDictBase, next_value: Tensor, estimator: Any) -> Tensor:
    """Target by a value estimator, from the value of the next state."""
    tensordict.set(("next", estimator.tensor_keys.value), next_value.unsqueeze(-1))
    target: Tensor = estimator.value_estimate(tensordict).squeeze(-1)
    return target
