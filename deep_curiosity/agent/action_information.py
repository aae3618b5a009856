"""The information that actions carry about states, estimated without any prior."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.gaussians import DiagonalMixture


class ActionInformation(NamedTuple):
    """Estimates of `I(A;X)` in nats, whose means lie on either side of it."""

    lower: Float[Tensor, ""]
    upper: Float[Tensor, ""]


def action_information(
    policy: DiagonalMixture, pre_action: Float[Tensor, "batch action_dim"]
) -> ActionInformation:
    r"""Mutual information of action and state, with the policies at all states for a marginal.

    .. math:: I(A; X) \approx \frac{1}{N} \sum_i
        \log \frac{\pi(a_i | x_i)}{\frac{1}{N} \sum_j \pi(a_i | x_j)}

    The policy at the action's own state belongs to the sum in the lower estimate, which is at most
    `log N`, and is left out of it, with `N - 1` for `N`, in the upper.

    Args:
        policy: At states sampled as the agent meets them.
        pre_action: One sample of each.

    Raises:
        ValueError: If there are fewer than two states.

    Reference: Still & Precup (2012), equation (14); Poole et al., "On Variational Bounds of Mutual
    Information" (2019), https://arxiv.org/abs/1905.06922, for both estimates.
    """
    num_states = len(pre_action)
    if num_states < 2:
        raise ValueError(f"`pre_action` must have at least 2 rows, got {num_states}.")
    everywhere = pre_action.unsqueeze(1).expand(-1, num_states, -1)
    log_prob = policy.log_prob(everywhere)  # actions states
    own = log_prob.diagonal()
    others = log_prob.masked_fill(
        torch.eye(num_states, dtype=torch.bool, device=own.device), -math.inf
    )
    with_own = torch.logsumexp(log_prob, dim=1) - math.log(num_states)
    without_own = torch.logsumexp(others, dim=1) - math.log(num_states - 1)
    return ActionInformation(lower=(own - with_own).mean(), upper=(own - without_own).mean())
