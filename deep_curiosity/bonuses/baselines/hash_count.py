"""Pseudo-counts: states that share a hash code share a count."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from deep_curiosity.bonuses.baselines.base import BaselineBonus
from deep_curiosity.transitions import Transition, check_counts

TABLE_SIZES = (131_011, 131_023, 131_041)  # primes: codes that share a slot in one part in others
LEAST_STD, ROUNDING = 1e-8, 1e-6  # below these, the latter of its mean, an entry counts as resting


class HashCountBonus(BaselineBonus):
    r"""One over the root of how often a state like the next one has been observed.

    .. math:: 1 / \sqrt{n(\phi(x'))}, \quad \phi(x) = sign(A g(x))

    The code is a random projection's signs (SimHash), `g` whitens by the statistics of the first
    batch, for ever: a state must keep its code; entries that rest in it are taken as they are.
    `g` also appends a one: the paper's hyperplanes
    all pass through the origin, which gives all states on a ray from there one code. Counts lie in
    several tables, of which the least is believed. What is counted are the rows shown to
    `observe` as visited, or else the batch: of batches from replay, one state is counted as often
    as it is sampled.

    Args:
        observation_dim: Length of an observation.
        action_dim: Length of an action; it is not looked at.
        weight: Factor of the bonus.
        center: Subtract the running mean.
        scale: Divide by the running standard deviation.
        refresh_interval: Calls of `observe` from one that looks at its batch to the next.
        bits: Length of a code: more distinguish states more finely.

    Raises:
        ValueError: If `bits` is below 1 or above 62.

    Reference: Tang et al., "#Exploration: A Study of Count-Based Exploration for Deep
    Reinforcement Learning" (2017), https://arxiv.org/abs/1611.04717; equations (1)-(2).
    """

    scores_outcomes = True
    follows_visits = True
    projection: Tensor
    powers: Tensor
    code_loc: Tensor
    code_scale: Tensor
    counts: Tensor
    is_fixed: Tensor

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        *,
        weight: float = 0.1,
        center: bool = True,
        scale: bool = True,
        refresh_interval: int = 20,
        bits: int = 32,
    ) -> None:
        super().__init__(
            observation_dim,
            action_dim,
            weight=weight,
            center=center,
            scale=scale,
            refresh_interval=refresh_interval,
        )
        check_counts(bits=bits)
        if bits > 62:
            raise ValueError(f"`bits` must be at most 62 to fit an integer, got {bits}.")
        self.register_buffer("projection", torch.randn(observation_dim + 1, bits))
        self.register_buffer("powers", 2 ** torch.arange(bits))
        self.register_buffer("code_loc", torch.zeros(observation_dim))
        self.register_buffer("code_scale", torch.ones(observation_dim))
        self.register_buffer("counts", torch.zeros(len(TABLE_SIZES), max(TABLE_SIZES)))
        self.register_buffer("is_fixed", torch.zeros((), dtype=torch.bool))

    @property
    def ready(self) -> bool:
        """Whether the code is fixed yet."""
        return bool(self.is_fixed)

    def score(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None
    ) -> Tensor:
        """One over the root of the count; 1 for what was never observed."""
        assert next_observation is not None
        slot = self._slots(next_observation)
        count = self.counts.gather(1, slot).amin(0)
        return count.clamp(min=1).rsqrt()

    def update_statistics(self, transition: Transition, fresh_action: Tensor | None) -> None:
        """Count the batch's next states; the first batch fixes the code."""
        moments = self.observation_moments
        # an entry that rests has no unit yet; in that of its rounding, it would drown the others
        std = moments.var.sqrt()
        rests = std <= LEAST_STD + ROUNDING * moments.mean.abs()
        scale = torch.where(rests, 1.0, torch.where(moments.rests, std, moments.scale))
        self.code_loc.copy_(torch.where(self.is_fixed, self.code_loc, moments.mean))
        self.code_scale.copy_(torch.where(self.is_fixed, self.code_scale, scale))
        self.is_fixed.fill_(True)
        slot = self._slots(transition.next_observation)
        self.counts.scatter_add_(1, slot, torch.ones_like(slot, dtype=self.counts.dtype))

    def _slots(self, state: Float[Tensor, "batch dim"]) -> Int[Tensor, "tables batch"]:
        """Place of each state's code in every table."""
        whitened = (state - self.code_loc) / self.code_scale
        bits = (torch.cat([whitened, torch.ones_like(state[:, :1])], -1) @ self.projection) > 0
        code = (bits * self.powers).sum(-1)
        sizes = torch.tensor(TABLE_SIZES, device=code.device)
        return code % sizes.unsqueeze(1)
