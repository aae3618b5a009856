"""Action densities, all on the pre-squash side of the tanh, where they are exact.

An action is `tanh(pre_action)`. The change of variables multiplies every density by the same
Jacobian, so it cancels from differences such as `log pi - log p` when both densities are taken of
the pre-action: nothing is rounded near the edge of the action box.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

LOG_TWO_PI = math.log(2 * math.pi)


def gaussian_log_prob(
    value: Float[Tensor, "*#batch dim"],
    loc: Float[Tensor, "*#batch dim"],
    log_std: Float[Tensor, "*#batch dim"],
) -> Float[Tensor, "*batch"]:
    """Log density of a diagonal Gaussian, in nats."""
    standard = (value - loc) * torch.exp(-log_std)
    return -(0.5 * standard.square() + log_std + 0.5 * LOG_TWO_PI).sum(-1)


def log_abs_det_tanh(pre_action: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch"]:
    """Log volume change of the squash, `sum log(1 - tanh(u)^2)`, exact at any `u`.

    Uses `1 - tanh(u)^2 = 4 / (exp(u) + exp(-u))^2`, which neither overflows nor needs an epsilon.
    """
    return (2 * (math.log(2) - pre_action - softplus(-2 * pre_action))).sum(-1)


def squashed_log_prob(
    pre_log_prob: Float[Tensor, "*batch"], pre_action: Float[Tensor, "*batch dim"]
) -> Float[Tensor, "*batch"]:
    """Log density of `tanh(pre_action)` on the action box, from that of the pre-action."""
    return pre_log_prob - log_abs_det_tanh(pre_action)


def flat_log_prob(pre_action: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch"]:
    """Log density, pre-squash, of the flat measure that has density one on the action box.

    The uniform distribution on the box is this divided by its volume, `2 ** dim`.
    """
    return log_abs_det_tanh(pre_action)


def mixture_log_prob(
    value: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_std: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"],
) -> Float[Tensor, "*batch"]:
    """Log density of a mixture of diagonal Gaussians, in nats."""
    log_prob = gaussian_log_prob(value.unsqueeze(-2), component_loc, component_log_std)
    return torch.logsumexp(log_prob + component_log_weight, dim=-1)


class SquashedGaussian(NamedTuple):
    """A diagonal Gaussian over pre-actions; the action is its tanh."""

    loc: Float[Tensor, "batch action_dim"]
    log_std: Float[Tensor, "batch action_dim"]

    def pre_action(
        self, noise: Float[Tensor, "batch action_dim"]
    ) -> Float[Tensor, "batch action_dim"]:
        """Pre-action for standard normal `noise`, differentiable in the parameters."""
        return self.loc + self.log_std.exp() * noise

    def log_prob(self, pre_action: Float[Tensor, "batch action_dim"]) -> Float[Tensor, " batch"]:
        """Log density of the pre-action, in nats."""
        return gaussian_log_prob(pre_action, self.loc, self.log_std)

    @property
    def mode(self) -> Float[Tensor, "batch action_dim"]:
        """Action at the centre of the Gaussian."""
        return torch.tanh(self.loc)
