"""Running statistics of a stream of vectors, kept in buffers."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

VARIANCE_FLOOR = 1e-8  # a feature that never moves is whitened by 1e-4 of its unit, not by zero
WHITENED_BOUND = 10.0  # a feature that starts to move late would drown all others


class RunningMoments(nn.Module):
    """Mean and variance of each feature over the rows seen so far.

    Args:
        dim: Number of features.
        memory: Rows after which old ones fade: from then on every update is an exponential moving
            average. Infinity weighs all rows alike.
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, dim: int, *, memory: float = float("inf")) -> None:
        super().__init__()
        if not memory > 0:
            raise ValueError(f"`memory` must be positive, got {memory}.")
        self.memory = memory
        self.register_buffer("mean", torch.zeros(dim))
        self.register_buffer("var", torch.ones(dim))
        self.register_buffer("count", torch.zeros(()))

    @torch.no_grad()
    def update(self, value: Float[Tensor, "batch dim"]) -> None:
        """Merge a batch by the parallel formula of Chan, Golub and LeVeque (1979)."""
        batch_mean = value.mean(0)
        batch_var = value.var(0, correction=0)
        self.count.add_(value.shape[0]).clamp_(max=max(self.memory, value.shape[0]))
        share = value.shape[0] / self.count
        difference = batch_mean - self.mean
        self.var.lerp_(batch_var, share).add_(difference.square() * share * (1 - share))
        self.mean.lerp_(batch_mean, share)

    @property
    def scale(self) -> Float[Tensor, " dim"]:
        """Standard deviation of each feature, never zero; one while a single row is known."""
        return torch.where(self.count < 2, 1.0, (self.var + VARIANCE_FLOOR).sqrt())

    def normalize(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """Centre, scale, and cut at 10 standard deviations."""
        return ((value - self.mean) / self.scale).clamp(-WHITENED_BOUND, WHITENED_BOUND)
