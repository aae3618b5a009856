"""Action densities, all on the pre-squash side of the tanh, where they are exact.

An action is `tanh(pre_action)`. The change of variables multiplies every density by the same
Jacobian, so it cancels from differences such as `log pi - log p` when both densities are taken of
the pre-action: nothing is rounded near the edge of the action box.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
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


class SquashedMixture(NamedTuple):
    """A mixture of diagonal Gaussians over pre-actions, often of one; the action is the tanh.

    Expectations over it are taken mode by mode, with one draw from each and its weight: unbiased,
    and differentiable in the weights as well.
    """

    loc: Float[Tensor, "modes batch action_dim"]
    log_std: Float[Tensor, "modes batch action_dim"]
    log_weight: Float[Tensor, "modes batch"]

    def pre_actions(
        self, noise: Float[Tensor, "modes batch action_dim"]
    ) -> Float[Tensor, "modes batch action_dim"]:
        """One pre-action of each mode for standard normal `noise`, differentiable."""
        return self.loc + self.log_std.exp() * noise

    def draw(self) -> Float[Tensor, "batch action_dim"]:
        """One pre-action for each row, from a mode chosen by its weight."""
        pre_action = self.pre_actions(torch.randn_like(self.loc))
        if len(pre_action) == 1:
            return pre_action[0]
        return _rows_of(pre_action, drawn(self.log_weight, dim=0))

    def log_prob(
        self, pre_action: Float[Tensor, "*draws batch action_dim"]
    ) -> Float[Tensor, "*draws batch"]:
        """Log density of pre-actions under the whole mixture, in nats."""
        log_prob = gaussian_log_prob(pre_action.unsqueeze(-3), self.loc, self.log_std)
        if len(self.loc) == 1:
            return log_prob.squeeze(-2)
        return torch.logsumexp(log_prob + self.log_weight, dim=-2)

    @property
    def mode(self) -> Float[Tensor, "batch action_dim"]:
        """Action at the centre of the weightiest Gaussian."""
        return torch.tanh(_rows_of(self.loc, self.log_weight.argmax(0)))


def drawn(log_weight: Float[Tensor, "..."], *, dim: int) -> Int[Tensor, "..."]:
    """An index along `dim` for each place elsewhere, by its probability: Gumbel's trick.

    `torch.multinomial` would look at the values first, for which a device is waited.
    """
    gumbel = -(-torch.rand_like(log_weight).log()).log()
    return (log_weight + gumbel).argmax(dim)


def _rows_of(
    value: Float[Tensor, "modes batch action_dim"], mode: Int[Tensor, " batch"]
) -> Float[Tensor, "batch action_dim"]:
    """Each row from a mode of its own."""
    return value[mode, torch.arange(mode.shape[0], device=mode.device)]
