"""What an outcome would tell about the models, in nats, with a weight that tunes itself."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.bonuses.baselines.base import BaselineBonus
from deep_curiosity.bonuses.baselines.disagreement import PointEnsemble, change_of
from deep_curiosity.bonuses.weight_tuning import TunedWeight
from deep_curiosity.transitions import Transition, check_flags, check_positive


class InformationGainBonus(BaselineBonus):
    r"""Upper bound of what an outcome would tell of the model, in nats a dimension.

    .. math:: \frac{1}{d + 1} \sum_i \log(1 + Var_e[\hat y_{e,i}(x, a)] / \sigma^2)

    where the outcome `y` is the change of state and the reward. Its weight is tuned: it rises
    while the policy of now gains less than the policies of the recent past did, and falls while it
    gains more, see `TunedWeight`.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        weight: Factor of the bonus, the initial one where it is tuned.
        center: Subtract the running mean.
        scale: Divide by the running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.
        num_members: Number of models, at least 2.
        hidden_dims: Width of every hidden layer.
        noise_std: Standard deviation of the outcome's noise, in whitened units.
        tune_weight: Adjust the weight in `observe`, where it is given a policy.
        weight_learning_rate: Step size of the log weight.

    Raises:
        ValueError: If a number is out of range.

    Reference: Sukhija et al., "MaxInfoRL: Boosting exploration in reinforcement learning through
    information gain maximization" (2024), https://arxiv.org/abs/2412.12098.
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
        noise_std: float = 1e-3,
        tune_weight: bool = True,
        weight_learning_rate: float = 3e-4,
    ) -> None:
        super().__init__(
            observation_dim,
            action_dim,
            weight=weight,
            center=center,
            scale=scale,
            refresh_interval=refresh_interval,
        )
        check_positive(noise_std=noise_std)
        check_flags(tune_weight=tune_weight)
        self.noise_std = float(noise_std)
        self.asks_policy = tune_weight
        self.tuned_weight = TunedWeight(learning_rate=weight_learning_rate)
        self.ensemble = PointEnsemble(
            observation_dim + action_dim,
            observation_dim + 1,
            num_members=num_members,
            hidden_dims=hidden_dims,
        )

    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """Weighted, standardised gain of each pair, differentiable in both."""
        return self.tuned_weight.factor * super().forward(observation, action, next_observation)

    def score(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None
    ) -> Tensor:
        """Bound of each pair, in nats a dimension: twice the gain where all is Gaussian."""
        variance = self.ensemble.variance(self.pair_features(observation, action))
        return torch.log1p(variance / self.noise_std**2).mean(-1)

    def network_loss(self, transition: Transition) -> Tensor:
        """Squared error of the predictions."""
        features = self.pair_features(transition.observation, transition.action)
        return self.ensemble.loss(features, _change_and_reward(transition))

    def update_statistics(self, transition: Transition, fresh_action: Tensor | None) -> None:
        """Statistics of the outcomes; and the step of the weight, where a policy is given."""
        self.ensemble.outcome_moments.update(_change_and_reward(transition))
        if fresh_action is None:
            return
        gain = self.score(transition.observation, fresh_action, None).mean()
        self.tuned_weight.follow(self.standardization.in_deviations(gain), self.every.interval)

    def metrics(self) -> dict[str, Tensor]:
        """Statistics of the gain, in nats a dimension, and the weight as it now stands."""
        weight = self.standardization.weight * self.tuned_weight.factor
        return super().metrics() | {"weight": weight}


def _change_and_reward(transition: Transition) -> Float[Tensor, "batch outcome_dim"]:
    return torch.cat([change_of(transition), transition.reward.unsqueeze(-1)], dim=-1)
