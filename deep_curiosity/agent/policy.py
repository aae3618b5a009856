"""The networks of the agent: one policy, and critics stacked into one call."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn

from deep_curiosity.distributions import SquashedMixture
from deep_curiosity.nn.mlp import StackedMLP, restore_order, log_softmax_of_rest, assign_rows
from deep_curiosity.transitions import check_counts

Value = TypeVar("Value", Tensor, np.ndarray)
LOG_STD_RANGE = (-5.0, 2.0)  # below -5 the tanh density is sharper than float32 resolves


class GaussianPolicy(nn.Module):
    """Observation to squashed Gaussian over actions, or to a mixture of several.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        modes: Number of Gaussians. One holds a single way of doing things; with more, the policy
            can keep several apart, such as full left and full right.
        hidden_dims: Width of every hidden layer.

    Raises:
        ValueError: If `modes` is below 1.
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        modes: int = 1,
        hidden_dims: Sequence[int] = (256, 256),
    ) -> None:
        super().__init__()
        check_counts(modes=modes)
        self.modes = modes
        self.action_dim = action_dim
        self.network = StackedMLP(
            1, observation_dim, hidden_dims, 2 * modes * action_dim + modes - 1
        )

    def forward(self, observation: Float[Tensor, "batch observation_dim"]) -> SquashedMixture:
        """Distribution over actions at each observation."""
        # not by way of `at`: a product would copy activations that have lost their leading axis
        return self._mixture(self.network(observation)[0])

    def hidden(
        self, observation: Float[Tensor, "batch observation_dim"]
    ) -> Float[Tensor, "batch hidden_dim"]:
        """Activations of the last hidden layer."""
        return self.network.hidden(observation)[0]

    def at(self, hidden: Float[Tensor, "batch hidden_dim"]) -> SquashedMixture:
        """Distribution over actions where the last hidden layer has these activations."""
        return self._mixture(self.network.layers[-1](hidden.unsqueeze(0))[0])

    def _mixture(self, features: Float[Tensor, "batch features"]) -> SquashedMixture:
        shape, logits = features.tensor_split([2 * self.modes * self.action_dim], dim=-1)
        loc, raw_log_std = shape.unflatten(-1, (self.modes, -1)).transpose(0, 1).chunk(2, dim=-1)
        log_std = _in_log_std_range(torch.tanh(raw_log_std))
        return SquashedMixture(loc, log_std, log_softmax_of_rest(logits).mT)


class NumpyPolicy:
    """A policy of one Gaussian on NumPy views of its weights, for one observation at a time.

    Between two updates torch's small products find cold caches: this answers in a quarter of the
    time. The views follow every update made in place.

    Args:
        policy: On the CPU, of one mode.

    Raises:
        ValueError: If the policy has several modes.
    """

    def __init__(self, policy: GaussianPolicy) -> None:
        if policy.modes != 1:
            raise ValueError(f"`policy` must have one mode, got {policy.modes}.")
        self._layers = [
            (weight.detach()[0].numpy(), bias.detach()[0, 0].numpy())
            for weight, bias in (layer.parameters() for layer in policy.network.layers)
        ]
        self._outputs = [np.empty_like(bias) for _, bias in self._layers]

    def act(
        self, observation: Float32[np.ndarray, " observation_dim"], noise: np.ndarray
    ) -> Float32[np.ndarray, " action_dim"]:
        """Action in [-1, 1] for standard normal `noise`, one number for each action dimension."""
        value = observation
        for (weight, bias), output in zip(self._layers, self._outputs, strict=True):
            if value is not observation:
                np.maximum(value, 0, out=value)
            value = np.dot(value, weight, out=output)
            value += bias
        action_dim = len(noise)
        log_std = _in_log_std_range(np.tanh(value[action_dim:]))
        action: np.ndarray = np.tanh(value[:action_dim] + np.exp(log_std) * noise)
        return action


def _in_log_std_range(squashed: Value) -> Value:
    """Stretch [-1, 1] to the range of the log standard deviation."""
    low, high = LOG_STD_RANGE
    return low + 0.5 * (high - low) * (squashed + 1)


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

    def in_turn(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
    ) -> Float[Tensor, "pairs batch"]:
        """One estimate of every value: row `r` asks critic `r % 2`, for half of what both cost."""
        pair = torch.cat([observation, action], dim=-1)
        row, _ = assign_rows(len(pair), 2, pair.device)
        value = self.network(pair[row].repeat(self.pairs, 1, 1)).squeeze(-1)  # critics turns
        return restore_order(value.unflatten(0, (self.pairs, 2)).movedim(0, -1), len(pair)).mT
