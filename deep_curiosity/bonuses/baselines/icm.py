"""The error of a forward model, in learned features or in the state itself."""

from collections.abc import Sequence
from typing import ClassVar, Literal, get_args

import torch
from torch import Tensor, nn

from deep_curiosity.bonuses.baselines.base import BaselineBonus, log_of_score
from deep_curiosity.nn.networks import StackedMLP, frozen
from deep_curiosity.transitions import Transition, check_counts

Features = Literal["inverse", "state"]
FORWARD_SHARE = 0.2  # of the forward model in the loss, the paper's beta


class ICMBonus(BaselineBonus):
    r"""How wrong a forward model was about the next state: the intrinsic curiosity module.

    .. math:: \log(\frac{1}{2} \| \hat\phi(x, a) - \phi(x') \|^2)

    The paper's bonus is what the logarithm, which is ours, is taken of: without it few rows rule.

    The features `phi` are those from which an inverse model predicts what was done.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        weight: Factor of the bonus.
        center: Subtract the running mean.
        scale: Divide by the running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.
        features: `"inverse"` for the paper's; `"state"` for the whitened state itself, the plain
            prediction error of Stadie et al. (2015), https://arxiv.org/abs/1507.00814.
        feature_dim: Length of the learned features.
        hidden_dims: Width of every hidden layer.

    Raises:
        ValueError: If `features` is another one or a count is below 1.

    Reference: Pathak et al., "Curiosity-driven Exploration by Self-supervised Prediction" (2017),
    https://arxiv.org/abs/1705.05363; equations (2)-(7).
    """

    scores_outcomes: ClassVar[bool] = True

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        weight: float = 0.1,
        center: bool = True,
        scale: bool = True,
        refresh_interval: int = 20,
        features: Features = "inverse",
        feature_dim: int = 32,
        hidden_dims: Sequence[int] = (256, 256),
    ) -> None:
        super().__init__(
            observation_dim,
            action_dim,
            weight=weight,
            center=center,
            scale=scale,
            refresh_interval=refresh_interval,
        )
        check_counts(feature_dim=feature_dim)
        if features not in get_args(Features):
            raise ValueError(f"`features` must be 'inverse' or 'state', got {features!r}.")
        self.features = features
        learned = features == "inverse"
        dim = feature_dim if learned else observation_dim
        self.encoder: nn.Module = nn.Identity()
        self.inverse: nn.Module | None = None
        if learned:
            self.encoder = StackedMLP(1, observation_dim, hidden_dims, dim)
            self.inverse = StackedMLP(1, 2 * dim, hidden_dims, action_dim)
        self.forward_model = StackedMLP(1, dim + action_dim, hidden_dims, dim)

    def score(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None
    ) -> Tensor:
        """Log of half the squared error of the forward model, summed over features."""
        assert next_observation is not None
        with frozen(self):
            before, after = self._encode(observation), self._encode(next_observation)
            return log_of_score(self._error(before, action, after))

    def network_loss(self, transition: Transition) -> Tensor:
        """Loss of forward and inverse model; the forward model does not shape its own target."""
        before = self._encode(transition.observation)
        after = self._encode(transition.next_observation)
        forward_loss = self._error(before, transition.action, after.detach()).mean()
        if self.inverse is None:
            return forward_loss
        guess = self.inverse(torch.cat([before, after], dim=-1))[0]
        inverse_loss = (guess - transition.action).square().sum(-1).mean()
        return FORWARD_SHARE * forward_loss + (1 - FORWARD_SHARE) * inverse_loss

    def _encode(self, observation: Tensor) -> Tensor:
        features: Tensor = self.encoder(self.observation_moments.normalize(observation))
        return features if self.inverse is None else features[0]

    def _error(self, before: Tensor, action: Tensor, after: Tensor) -> Tensor:
        predicted = self.forward_model(torch.cat([before, action], dim=-1))[0]
        return 0.5 * (predicted - after).square().sum(-1)
