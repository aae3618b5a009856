"""Random network distillation: what has not been observed is predicted badly."""

from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor

from deep_curiosity.bonuses.baselines.base import BaselineBonus, log_of_score
from deep_curiosity.nn.networks import StackedMLP, frozen
from deep_curiosity.transitions import Transition, check_counts

OBSERVATION_BOUND = 5.0  # standard deviations at which the paper cuts observations


class RNDBonus(BaselineBonus):
    r"""Error of a network that learns a random one, at the next state.

    .. math:: \log \frac{1}{k} \| \hat f(x') - f(x') \|^2

    The log is ours, so that the bonus keeps its scale as the error shrinks by orders of magnitude.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; it is not looked at.
        weight: Factor of the bonus; the paper weighs it half as much as reward, and does not
            centre it.
        center: Subtract the running mean.
        scale: Divide by the running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.
        random_features: Outputs of the random network.
        hidden_dims: Width of every hidden layer of both networks.

    Raises:
        ValueError: If a count is below 1.

    Reference: Burda et al., "Exploration by Random Network Distillation" (2018),
    https://arxiv.org/abs/1810.12894; section 2.2. The running standard deviation is that of the
    bonus, where the paper takes that of its discounted sum.
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
        random_features: int = 512,
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
        check_counts(random_features=random_features)
        self.random = StackedMLP(1, observation_dim, hidden_dims, random_features).requires_grad_(
            False
        )
        self.predictor = StackedMLP(1, observation_dim, hidden_dims, random_features)

    def score(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None
    ) -> Tensor:
        """Log of the mean squared error over features."""
        assert next_observation is not None
        with frozen(self.predictor):
            return log_of_score(self._error(next_observation))

    def network_loss(self, transition: Transition) -> Tensor:
        """The same error, averaged over the batch."""
        return self._error(transition.next_observation).mean()

    def _error(self, next_observation: Tensor) -> Tensor:
        state = self.observation_moments.normalize(next_observation)
        state = state.clamp(-OBSERVATION_BOUND, OBSERVATION_BOUND)
        return (self.predictor(state) - self.random(state)).square().mean(-1)[0]
