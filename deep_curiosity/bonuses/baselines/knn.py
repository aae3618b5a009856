"""State entropy by nearest neighbours: far from all that is remembered is new."""

import torch
from torch import Tensor

from deep_curiosity.bonuses.baselines.base import BaselineBonus
from deep_curiosity.transitions import Transition, check_counts


class NearestNeighboursBonus(BaselineBonus):
    r"""Log distance of the next state to its nearest neighbours among those remembered.

    .. math:: \log(1 + \frac{1}{k} \sum_{j \in N_k(x')} \| x' - x_j \|)

    It is a particle estimate of the entropy of visited states, in whitened units. Where the
    references have a random encoder of images, or a learned one, states need none.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; it is not looked at.
        weight: Factor of the bonus.
        center: Subtract the running mean.
        scale: Divide by the running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.
        neighbours: Number of neighbours, k.
        memory: States remembered; the newest batches take the place of the oldest.

    Raises:
        ValueError: If a count is below 1, or `neighbours` above `memory`.

    Reference: Liu & Abbeel, "Behavior From the Void: Unsupervised Active Pre-Training" (2021),
    https://arxiv.org/abs/2103.04551, equation (5), for the mean over k = 12; Seo et al., "State
    Entropy Maximization with Random Encoders for Efficient Exploration" (2021),
    https://arxiv.org/abs/2102.09430, for the use beside a reward and the scale.
    """

    scores_outcomes = True
    states: Tensor
    num_seen: Tensor

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        weight: float = 0.1,
        center: bool = True,
        scale: bool = True,
        refresh_interval: int = 20,
        neighbours: int = 12,
        memory: int = 2048,
    ) -> None:
        super().__init__(
            observation_dim,
            action_dim,
            weight=weight,
            center=center,
            scale=scale,
            refresh_interval=refresh_interval,
        )
        check_counts(neighbours=neighbours, memory=memory)
        if neighbours > memory:
            raise ValueError(
                f"`neighbours` must be at most `memory` ({memory}), got {neighbours}."
            )
        self.neighbours = neighbours
        self.register_buffer("states", torch.zeros(memory, observation_dim))
        self.register_buffer("num_seen", torch.zeros((), dtype=torch.long))

    @property
    def ready(self) -> bool:
        """Whether a state is remembered yet."""
        return bool(self.num_seen > 0)

    def score(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None
    ) -> Tensor:
        """Log of one more than the mean distance, in whitened units; 0 while all is new.

        A state that is itself remembered is no neighbour of its own; other visits of it are.
        """
        assert next_observation is not None
        scale = self.observation_moments.scale
        filled = torch.arange(len(self.states), device=scale.device) < self.num_seen
        # without products of matrices, which would round away that a state is itself remembered
        distance = torch.cdist(
            next_observation / scale,
            self.states / scale,
            compute_mode="donot_use_mm_for_euclid_dist",
        )
        distance = torch.nn.functional.pad(
            distance.masked_fill(~filled, torch.inf), (0, 1), value=torch.inf
        )
        nearest = distance.topk(self.neighbours + 1, largest=False).values
        is_itself = nearest[:, :1] == 0
        nearest = torch.where(is_itself, nearest[:, 1:], nearest[:, :-1])
        known = nearest.isfinite()
        total = nearest.masked_fill(~known, 0.0).sum(-1)
        return torch.log1p(total / known.sum(-1).clamp(min=1))

    def update_statistics(self, transition: Transition, fresh_action: Tensor | None) -> None:
        """Write the batch's next states over the oldest."""
        memory = self.states.shape[0]
        newest = transition.next_observation[-memory:]
        slot = (self.num_seen + torch.arange(len(newest), device=newest.device)) % memory
        self.states[slot] = newest
        self.num_seen.add_(len(newest))
