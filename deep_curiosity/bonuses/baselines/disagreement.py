"""Models that disagree: the variance of their predictions."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.bonuses.baselines.base import BaselineBonus, log_of_score
from deep_curiosity.nn.networks import StackedMLP, frozen
from deep_curiosity.nn.statistics import WHITENINGS
from deep_curiosity.transitions import Transition, check_counts


class PointEnsemble(nn.Module):
    """Models that each predict one whitened outcome, a point and no density.

    Args:
        in_features: Length of their input.
        out_features: Length of what they predict.
        num_members: Number of models, at least 2.
        hidden_dims: Width of every hidden layer.

    Raises:
        ValueError: If `num_members` is below 2.
    """

    def __init__(
        self, in_features: int, out_features: int, *, num_members: int, hidden_dims: Sequence[int]
    ) -> None:
        super().__init__()
        check_counts(num_members=num_members)
        if num_members < 2:
            raise ValueError(
                f"`num_members` must be at least 2 to measure disagreement, got {num_members}."
            )
        self.network = StackedMLP(num_members, in_features, hidden_dims, out_features)
        self.outcome_moments = WHITENINGS["moments"](out_features)

    def variance(
        self, features: Float[Tensor, "batch in_features"]
    ) -> Float[Tensor, "batch out_features"]:
        """Variance over members of each whitened prediction; gradients pass to the features."""
        with frozen(self):
            prediction = self.network(features)
        if len(features) == 0:  # of which torch would warn that it has no variance
            return prediction[0]
        return prediction.var(0, correction=0)

    def loss(
        self,
        features: Float[Tensor, "batch in_features"],
        outcome: Float[Tensor, "batch out_features"],
    ) -> Float[Tensor, ""]:
        """Squared error of whitened outcomes, averaged over the batch, summed over members.

        Every member weighs the batch by its own bootstrap (Poisson counts).
        """
        error = self.network(features) - self.outcome_moments.normalize(outcome)
        weight = torch.poisson(torch.ones_like(error[..., 0]))
        return (weight * error.square().mean(-1)).mean(1).sum()


class DisagreementBonus(BaselineBonus):
    r"""Variance of an ensemble's predictions of the next state.

    .. math:: \log \frac{1}{d} \sum_i Var_e[\hat x'_{e,i}(x, a)]

    The log is ours, so that a few pairs do not drown all others, and so are the changes of state
    in place of features of images; each member learns from a bootstrap of every batch.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        weight: Factor of the bonus.
        center: Subtract the running mean.
        scale: Divide by the running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.
        num_members: Number of models, at least 2.
        hidden_dims: Width of every hidden layer.

    Reference: Pathak et al., "Self-Supervised Exploration via Disagreement" (2019),
    https://arxiv.org/abs/1906.04161; equation (1).
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        weight: float = 0.1,
        center: bool = True,
        scale: bool = True,
        refresh_interval: int = 20,
        num_members: int = 5,
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
        self.ensemble = PointEnsemble(
            observation_dim + action_dim,
            observation_dim,
            num_members=num_members,
            hidden_dims=hidden_dims,
        )

    def score(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None
    ) -> Tensor:
        """Log of the mean variance of the predictions, in whitened units squared."""
        features = self.pair_features(observation, action)
        return log_of_score(self.ensemble.variance(features).mean(-1))

    def network_loss(self, transition: Transition) -> Tensor:
        """Squared error of the predictions."""
        features = self.pair_features(transition.observation, transition.action)
        return self.ensemble.loss(features, change_of(transition))

    def update_statistics(self, transition: Transition, fresh_action: Tensor | None) -> None:
        """Statistics of the changes."""
        self.ensemble.outcome_moments.update(change_of(transition))


def change_of(transition: Transition) -> Float[Tensor, "batch observation_dim"]:
    """Change of state of each transition."""
    return transition.next_observation - transition.observation
