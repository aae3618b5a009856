"""Running statistics of a stream of vectors, kept in buffers, and what is standardised by them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

VARIANCE_FLOOR = 1e-8  # a feature that never moves is whitened by 1e-4 of its unit, not by zero
STATISTICS_MEMORY = 50_000.0  # rows; a bonus drifts as its model learns, so old ones fade
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


class Standardization(nn.Module):
    """Brings a bonus to a scale of its own: `weight * (value - mean) / std`.

    Args:
        weight: Factor of the result.
        center: Subtract the running mean. Ending an episode is then worth as much as an average
            step: neither bait nor threat.
        scale: Divide by the running standard deviation; without it the value keeps its unit.

    Raises:
        ValueError: If `weight` is negative or not finite.
    """

    def __init__(self, *, weight: float, center: bool, scale: bool) -> None:
        super().__init__()
        if not (math.isfinite(weight) and weight >= 0):
            raise ValueError(f"`weight` must be finite and not negative, got {weight}.")
        self.weight = weight
        self.center = center
        self.scale = scale
        self.moments = RunningMoments(1, memory=STATISTICS_MEMORY)

    def forward(self, value: Float[Tensor, " batch"]) -> Float[Tensor, " batch"]:
        """Standardised value; changes no statistics."""
        if self.center:
            value = value - self.moments.mean
        if self.scale:
            value = value / self.moments.scale
        return self.weight * value

    def update(self, value: Float[Tensor, " batch"]) -> None:
        """Let the statistics see a batch."""
        self.moments.update(value.unsqueeze(-1))
