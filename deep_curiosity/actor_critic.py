"""The networks of the agent: one policy, and critics stacked into one call."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.distributions import SquashedGaussian
from deep_curiosity.networks import StackedMLP

LOG_STD_RANGE = (-5.0, 2.0)  # below -5 the tanh density is sharper than float32 resolves


class GaussianPolicy(nn.Module):
    """Observation to squashed Gaussian over actions.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        hidden_dims: Width of every hidden layer.
    """

    def __init__(
        self, observation_dim: int, action_dim: int, *, hidden_dims: Sequence[int] = (256, 256)
    ) -> None:
        super().__init__()
        self.network = StackedMLP(1, observation_dim, hidden_dims, 2 * action_dim)

    def forward(self, observation: Float[Tensor, "batch observation_dim"]) -> SquashedGaussian:
        """Distribution over actions at each observation."""
        loc, raw_log_std = self.network(observation)[0].chunk(2, dim=-1)
        low, high = LOG_STD_RANGE
        log_std = low + 0.5 * (high - low) * (torch.tanh(raw_log_std) + 1)
        return SquashedGaussian(loc, log_std)


class Critics(nn.Module):
    """Pairs of state-action values, all in one stacked network.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        pairs: Number of values, each learned twice.
        hidden_dims: Width of every hidden layer.
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        pairs: int = 2,
        hidden_dims: Sequence[int] = (256, 256),
    ) -> None:
        super().__init__()
        self.pairs = pairs
        self.network = StackedMLP(2 * pairs, observation_dim + action_dim, hidden_dims, 1)

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> Float[Tensor, "pairs 2 batch"]:
        """Both estimates of every value."""
        value = self.network(torch.cat([observation, action], dim=-1)).squeeze(-1)
        return value.unflatten(0, (self.pairs, 2))

    def lower(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> Float[Tensor, "pairs batch"]:
        """The smaller estimate of every value, against overestimation (Fujimoto et al., 2018)."""
        return self(observation, action).amin(1)
