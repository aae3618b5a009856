"""What the agent consists of: a policy, critics stacked into one call, and a prior over actions.

An action is `tanh(pre_action)`. The change of variables multiplies every density by the same
Jacobian, so it cancels from differences such as `log pi - log p` when both densities are taken of
the pre-action: nothing is rounded near the edge of the action box.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import logsigmoid, softplus

from deep_curiosity.gaussians import DiagonalMixture
from deep_curiosity.nn.networks import StackedMLP, assign_rows, log_softmax_of_rest, restore_order
from deep_curiosity.transitions import check_counts

Value = TypeVar("Value", Tensor, np.ndarray)
LOG_STD_RANGE = (-5.0, 2.0)  # below -5 the tanh density is sharper than float32 resolves
LOG_STD_FLOOR = math.log(0.05)  # of a prior's component, pre-squash: no habit is narrower
MOST_HABIT = 2.0  # mean of a prior's component, pre-squash: 0.96 of a full action
FIRST_LOGIT = 2.0  # of a prior's standard deviation: then 0.93, near the 0.91 of a uniform action
UNIFORM_EDGE = 1 - 1e-6  # atanh is infinite at the edge of the action box
OF_REWARD, OF_OTHERS = slice(0, 2), slice(2, None)  # critics
FIRST_OUTPUT = 0.01  # of the usual weights of the last layer, behind normalised ones
NUM_PRIOR_SAMPLES = 256  # for the reported divergence of the prior from uniform
DEFAULT_RATE = 1 + math.log(2)
"""Nats for each action dimension by which a policy may differ from its prior: from the uniform one
that is soft actor-critic's usual target entropy of minus the number of action dimensions."""


class GaussianPolicy(nn.Module):
    """Observation to a mixture of diagonal Gaussians over pre-actions, often of one.

    Several policies may be stacked: batches then hold the rows of the first, then those
    of the second, and so on, and `hidden` and `at` are those of the last.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        policies: Number of policies.
        mixture_components: Number of Gaussians. One holds a single way of doing things; with more,
            the policy can keep several apart, such as full left and full right.
        hidden_dims: Width of every hidden layer.

    Raises:
        ValueError: If `mixture_components` is below 1.
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        policies: int = 1,
        mixture_components: int = 1,
        hidden_dims: Sequence[int] = (256, 256),
    ) -> None:
        super().__init__()
        check_counts(mixture_components=mixture_components)
        self.mixture_components = mixture_components
        self.action_dim = action_dim
        num_outputs = mixture_components * (2 * action_dim + 1) - 1
        self.network = StackedMLP(policies, observation_dim, hidden_dims, num_outputs)

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"]
        | Float[Tensor, "policies batch observation_dim"],
        policy: int | None = None,
    ) -> DiagonalMixture:
        """Distribution over pre-actions at each observation, of all policies or of one of them.

        Policies look at the same observations, or each at its own.
        """
        # not by way of `at`: a product would copy activations that have lost their leading axis
        features = self.network(observation)
        return self._mixture(features.flatten(0, 1) if policy is None else features[policy])

    def hidden(
        self, observation: Float[Tensor, "batch observation_dim"]
    ) -> Float[Tensor, "batch hidden_dim"]:
        """Activations of the last hidden layer."""
        return self.network.hidden(observation)[-1]

    def at(self, hidden: Float[Tensor, "batch hidden_dim"]) -> DiagonalMixture:
        """Distribution over pre-actions where the last hidden layer has these activations."""
        layer = self.network.layers[-1]
        return self._mixture(hidden @ layer.weight[-1] + layer.bias[-1])

    def _mixture(self, features: Float[Tensor, "batch features"]) -> DiagonalMixture:
        split = 2 * self.mixture_components * self.action_dim
        shape, logits = features.tensor_split([split], dim=-1)
        loc, raw_log_std = shape.unflatten(-1, (self.mixture_components, -1)).chunk(2, dim=-1)
        log_std = in_log_std_range(torch.tanh(raw_log_std))
        return DiagonalMixture(loc, 2 * log_std, log_softmax_of_rest(logits))


def in_log_std_range(squashed: Value) -> Value:
    """Stretch [-1, 1] to the range of the log standard deviation."""
    low, high = LOG_STD_RANGE
    return low + 0.5 * (high - low) * (squashed + 1)


class Critics(nn.Module):
    """State-action values, all in one stacked network: that of the reward twice, others once.

    Reward's value is maximised, and the smaller of two estimates guards against overestimation
    (Fujimoto et al., 2018). What is not known yet is no reason for pessimism where it is sought,
    nor for a bound.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        others: Number of other values, such as that of curiosity.
        hidden_dims: Width of every hidden layer.
        layer_norm: Normalise every hidden layer of reward's two estimates, which bounds what these
            extrapolate, and begin with values near zero: what they start with would else tell
            states apart, where no reward was met yet, by as much as curiosity does.
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        others: int = 1,
        hidden_dims: Sequence[int] = (256, 256),
        layer_norm: bool = False,
    ) -> None:
        super().__init__()
        self.network = StackedMLP(
            2 + others,
            observation_dim + action_dim,
            hidden_dims,
            1,
            normalized=2 * layer_norm,
        )
        if layer_norm:
            last = self.network.layers[-1]
            with torch.no_grad():
                last.weight[OF_REWARD] *= FIRST_OUTPUT
                last.bias[OF_REWARD] = 0

    def forward(
        self,
        observation: Float[Tensor, "*#values batch observation_dim"],
        action: Float[Tensor, "*#values batch action_dim"],
    ) -> Float[Tensor, "critics batch"]:
        """Every estimate of every value, at one state and action for all or one for each value."""
        if observation.ndim < action.ndim:
            observation = observation.expand(*action.shape[:-1], -1)
        entered = torch.cat([observation, action], dim=-1)
        if entered.ndim == 3:
            entered = for_each_critic(entered)
        return self.network(entered).squeeze(-1)

    def lower(
        self,
        observation: Float[Tensor, "*#values batch observation_dim"],
        action: Float[Tensor, "*#values batch action_dim"],
    ) -> Float[Tensor, "values batch"]:
        """Every value, that of the reward by its smaller estimate."""
        value = self(observation, action)
        return torch.cat([value[:2].amin(0, keepdim=True), value[2:]])

    def of_reward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        *,
        alternate: bool = False,
    ) -> Float[Tensor, " batch"]:
        """Reward's value alone, the smaller estimate or, at half the cost, row `r` by `r % 2`."""
        entered = torch.cat([observation, action], dim=-1)
        if not alternate:
            return self.network(entered, OF_REWARD).squeeze(-1).amin(0)
        row, _ = assign_rows(len(entered), 2, entered.device)
        value = self.network(entered[row], OF_REWARD).squeeze(-1)  # critics rows
        return restore_order(value, len(entered))

    def of_others(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> Float[Tensor, "others batch"]:
        """The other values alone."""
        return self.network(torch.cat([observation, action], dim=-1), OF_OTHERS).squeeze(-1)


def for_each_critic(value: Float[Tensor, "values *rest"]) -> Float[Tensor, "critics *rest"]:
    """What belongs to each value, for each of its critics."""
    return torch.cat([value[:1], value])


class Prior(nn.Module, ABC):
    """What the agent usually does, whatever the state: a density over pre-actions.

    Args:
        action_dim: Length of an action.
    """

    soft_backup: ClassVar[bool]
    """Whether, without curiosity, the value is charged with later information costs by default."""
    log_excess: float = 0.0
    """Log of what the density integrates to: a cost plus this is in nats from a normalised one."""

    def __init__(self, action_dim: int) -> None:
        super().__init__()
        self.log_volume = action_dim * math.log(2)

    @abstractmethod
    def log_prob(self, pre_action: Float[Tensor, "*batch action_dim"]) -> Float[Tensor, "*batch"]:
        """Log density of each pre-action, in nats."""

    def metrics(self) -> dict[str, Tensor]:
        """What to log."""
        return {}


class UniformPrior(Prior):
    """All actions alike, with density one on the action box: soft actor-critic's implicit prior.

    The normalised uniform density is lower by `log_volume`, a constant that moves no gradient.

    Args:
        action_dim: Length of an action.
    """

    soft_backup = True

    def __init__(self, action_dim: int) -> None:
        super().__init__(action_dim)
        self.log_excess = self.log_volume

    def log_prob(self, pre_action: Float[Tensor, "*batch action_dim"]) -> Float[Tensor, "*batch"]:
        """Log density of each pre-action, in nats."""
        return log_abs_det_tanh(pre_action)


class LearnedPrior(Prior):
    r"""The action marginal `p(a)`, fitted to the policy's own actions, (14) and (23).

    .. math:: p(u) = (1 - \epsilon) \sum_k w_k N(u; \mu_k, \sigma_k) + \epsilon \, p_{uniform}(u)

    With a learned prior a policy that ignores the state costs nothing, so prior and policy could
    shrink together to a point. Two floors forbid it: a uniform share and a least component width.
    Nor may they run off together to where `tanh` tells no two actions apart, but pre-actions do:
    the rate would be spent on differences that are none in the world. Means lie within
    `MOST_HABIT`, standard deviations within 1.05, and what goes further pays for it.

    Args:
        action_dim: Length of an action.
        components: Number of Gaussians.
        uniform_share: Weight of the uniform density on the action box.

    Raises:
        ValueError: If `components` is below 1 or `uniform_share` outside (0, 1).
    """

    soft_backup = False

    def __init__(
        self, action_dim: int, *, components: int = 8, uniform_share: float = 0.1
    ) -> None:
        super().__init__(action_dim)
        check_counts(components=components)
        if not 0 < uniform_share < 1:
            raise ValueError(f"`uniform_share` must lie inside (0, 1), got {uniform_share}.")
        self.uniform_share = uniform_share
        self.raw_loc = nn.Parameter(torch.randn(components, action_dim))
        self.raw_std = nn.Parameter(torch.full((components, action_dim), FIRST_LOGIT))
        self.logits = nn.Parameter(torch.zeros(components))

    @property
    def habit(self) -> DiagonalMixture:
        """The learned part of the density."""
        loc = MOST_HABIT * torch.tanh(self.raw_loc / MOST_HABIT)
        floor = torch.full_like(self.raw_std, LOG_STD_FLOOR)
        log_std = torch.logaddexp(logsigmoid(self.raw_std), floor)
        return DiagonalMixture(loc, 2 * log_std, torch.log_softmax(self.logits, dim=0))

    def log_prob(self, pre_action: Float[Tensor, "*batch action_dim"]) -> Float[Tensor, "*batch"]:
        """Log density of each pre-action, in nats."""
        habit = self.habit.log_prob(pre_action)
        uniform = log_abs_det_tanh(pre_action) - self.log_volume
        return torch.logaddexp(
            habit + math.log1p(-self.uniform_share), uniform + math.log(self.uniform_share)
        )

    def kl_to_uniform(self, noise: Float[Tensor, "samples action_dim"]) -> Float[Tensor, ""]:
        """Divergence of the marginal from the uniform density, in nats: how habitual the agent is.

        Args:
            noise: Standard normal samples, used for every component and for the uniform share.
        """
        habit = self.habit
        habitual = habit.component_samples(noise.unsqueeze(1)).transpose(0, 1)
        uniform = torch.atanh(torch.erf(noise / math.sqrt(2)) * UNIFORM_EDGE)
        pre_action = torch.cat([habitual, uniform.unsqueeze(0)])  # components+1 samples
        log_ratio = self.log_prob(pre_action) - log_abs_det_tanh(pre_action) + self.log_volume
        habit_share = (1 - self.uniform_share) * torch.softmax(self.logits, dim=0)
        return torch.cat([habit_share, habit_share.new_tensor([self.uniform_share])]) @ (
            log_ratio.mean(-1)
        )

    @torch.no_grad()
    def metrics(self) -> dict[str, Tensor]:
        """How far the prior is from uniform, in nats, always over the same samples."""
        generator = torch.Generator().manual_seed(0)  # leaves the global stream where it is
        noise = torch.randn(NUM_PRIOR_SAMPLES, self.raw_loc.shape[1], generator=generator)
        return {"prior_kl_to_uniform": self.kl_to_uniform(noise.to(self.raw_loc))}


PRIORS: dict[str, type[Prior]] = {"uniform": UniformPrior, "learned": LearnedPrior}
"""Action priors by name."""


def log_abs_det_tanh(pre_action: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch"]:
    """Log volume change of the squash, `sum log(1 - tanh(u)^2)`, exact at any `u`.

    It is also the log density, pre-squash, of the flat measure with density one on the action box;
    the uniform distribution on the box is that divided by its volume, `2 ** dim`.

    Uses `1 - tanh(u)^2 = 4 / (exp(u) + exp(-u))^2`, which neither overflows nor needs an epsilon.
    """
    return (2 * (math.log(2) - pre_action - softplus(-2 * pre_action))).sum(-1)
