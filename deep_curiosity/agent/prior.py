"""The action marginal `p(a)`: what the agent usually does, whatever the state."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.distributions import flat_log_prob, mixture_log_prob

LOG_STD_FLOOR = math.log(0.05)  # of a component, pre-squash: no habit is narrower
UNIFORM_EDGE = 1 - 1e-6  # atanh is infinite at the edge of the action box


class UniformPrior(nn.Module):
    """All actions alike, with density one on the action box: soft actor-critic's implicit prior.

    The normalised uniform density is lower by `log_volume`, a constant that moves no gradient.

    Args:
        action_dim: Length of an action.
    """

    def __init__(self, action_dim: int) -> None:
        super().__init__()
        self.log_volume = action_dim * math.log(2)

    def log_prob(self, pre_action: Float[Tensor, "*batch action_dim"]) -> Float[Tensor, "*batch"]:
        """Log density of each pre-action, in nats."""
        return flat_log_prob(pre_action)


class LearnedPrior(nn.Module):
    r"""Learned mixture over pre-actions, fitted to the policy's own actions, (14) and (23).

    .. math:: p(u) = (1 - \epsilon) \sum_k w_k N(u; \mu_k, \sigma_k) + \epsilon \, p_{uniform}(u)

    With a learned prior a policy that ignores the state costs nothing, so prior and policy could
    shrink together to a point. Two floors forbid it: a uniform share and a least component width.

    Args:
        action_dim: Length of an action.
        components: Number of Gaussians.
        uniform_share: Weight of the uniform density on the action box.

    Raises:
        ValueError: If `components` is below 1 or `uniform_share` outside (0, 1).
    """

    def __init__(
        self, action_dim: int, *, components: int = 8, uniform_share: float = 0.1
    ) -> None:
        super().__init__()
        if components < 1:
            raise ValueError(f"`components` must be at least 1, got {components}.")
        if not 0 < uniform_share < 1:
            raise ValueError(f"`uniform_share` must lie inside (0, 1), got {uniform_share}.")
        self.log_volume = action_dim * math.log(2)
        self.uniform_share = uniform_share
        self.loc = nn.Parameter(torch.randn(components, action_dim))
        self.raw_log_std = nn.Parameter(torch.zeros(components, action_dim))
        self.logits = nn.Parameter(torch.zeros(components))

    def log_prob(self, pre_action: Float[Tensor, "*batch action_dim"]) -> Float[Tensor, "*batch"]:
        """Log density of each pre-action, in nats."""
        log_weight = torch.log_softmax(self.logits, dim=0)
        habit = mixture_log_prob(pre_action, self.loc, self._log_std, log_weight)
        uniform = flat_log_prob(pre_action) - self.log_volume
        return torch.logaddexp(
            habit + math.log1p(-self.uniform_share), uniform + math.log(self.uniform_share)
        )

    def kl_to_uniform(self, noise: Float[Tensor, "samples action_dim"]) -> Float[Tensor, ""]:
        """Divergence of the marginal from the uniform density, in nats: how habitual the agent is.

        Args:
            noise: Standard normal draws, used once for every component and for the uniform share.
        """
        draws = self.loc.unsqueeze(1) + self._log_std.exp().unsqueeze(1) * noise
        uniform_action = torch.erf(noise / math.sqrt(2)) * UNIFORM_EDGE
        draws = torch.cat(
            [draws, torch.atanh(uniform_action).unsqueeze(0)]
        )  # components+1 samples
        log_ratio = self.log_prob(draws) - flat_log_prob(draws) + self.log_volume
        habit_share = (1 - self.uniform_share) * torch.softmax(self.logits, dim=0)
        return torch.cat([habit_share, habit_share.new_tensor([self.uniform_share])]) @ (
            log_ratio.mean(-1)
        )

    @property
    def _log_std(self) -> Float[Tensor, "components action_dim"]:
        floor = torch.full_like(self.raw_log_std, LOG_STD_FLOOR)
        return torch.logaddexp(self.raw_log_std, floor)
