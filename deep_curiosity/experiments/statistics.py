"""Statistics over seeds and tasks, with intervals by the bootstrap.

Reference: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice"
(2021), https://arxiv.org/abs/2108.13264; sections 4.1 and 4.3.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

NUM_RESAMPLES = 10_000
LEVEL = 0.95
Statistic = Callable[[np.ndarray], np.ndarray]
"""From values along the last axis to one number."""
Groups = Sequence[Sequence[float | int]]
"""Values of one agent's runs, a group for each task, in the order of the seeds."""


class Estimate(NamedTuple):
    """A statistic and the ends of its confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """As tables show it."""
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of the values along the last axis.

    Example:
        >>> float(interquartile_mean(np.array([0.0, 1.0, 3.0, 100.0])))
        2.0
    """
    cut = values.shape[-1] // 4
    ordered = np.sort(values, axis=-1)
    return np.asarray(ordered[..., cut : values.shape[-1] - cut].mean(-1))


def bootstrap(
    groups: Groups, statistic: Statistic = interquartile_mean, *, seed: int = 0
) -> Estimate:
    """A statistic over all runs, with its 95 % interval: runs are resampled within each task.

    Raises:
        ValueError: If a group is empty.
    """
    _check_groups(groups)
    random = np.random.default_rng(seed)
    arrays = [np.asarray(group, dtype=float) for group in groups]
    resampled = [
        group[random.integers(len(group), size=(NUM_RESAMPLES, len(group)))] for group in arrays
    ]
    low, high = _interval(statistic(np.concatenate(resampled, axis=1)))
    return Estimate(float(statistic(np.concatenate(arrays))), low, high)


def probability_of_improvement(first: Groups, second: Groups, *, seed: int = 0) -> Estimate:
    """Chance that a run of the first agent beats one of the second, on a task drawn at random.

    Every run of the one is compared with every run of the other, equal values count half, and for
    the interval the runs of each are resampled by themselves within each task, as in section 4.3.

    Raises:
        ValueError: If the agents do not have the same tasks and seeds.
    """
    if [*map(len, first)] != [*map(len, second)]:
        raise ValueError(
            "`first` and `second` must have the same tasks and seeds, "
            f"got {[*map(len, first)]} and {[*map(len, second)]} runs."
        )
    _check_groups(first)
    random = np.random.default_rng(seed)
    values, resampled = [], []
    for one, other in zip(first, second, strict=True):
        ours, theirs = np.asarray([one, other], dtype=float)  # truth values, too
        # runs runs; without a difference, which of two infinities is none
        wins = np.greater.outer(ours, theirs) + 0.5 * np.equal.outer(ours, theirs)
        drawn, against = (_resampled_counts(random, len(wins)) for _ in range(2))
        resampled.append(((drawn @ wins) * against).sum(1) / wins.size)
        values.append(wins.mean())
    return Estimate(float(np.mean(values)), *_interval(np.mean(resampled, axis=0)))


def _resampled_counts(random: np.random.Generator, num_runs: int) -> np.ndarray:
    """How often each run was drawn, in every resample: resamples runs."""
    return random.multinomial(num_runs, [1 / num_runs] * num_runs, size=NUM_RESAMPLES)


def rank_correlation(first: Sequence[float | int], second: Sequence[float | int]) -> float:
    """Spearman's correlation of two sequences; equal values share the mean of their ranks.

    Returns:
        From -1 to 1; NaN where either holds a NaN, or nothing but equal values.

    Example:
        >>> round(rank_correlation([1, 2, 3], [0.0, 5.0, 5.0]), 3)
        0.866
    """
    ranks = np.array([_mean_ranks(values) for values in (first, second)])
    if np.isnan(ranks).any() or (np.ptp(ranks, axis=1) == 0).any():
        return math.nan
    return float(np.corrcoef(ranks)[0, 1])


def _mean_ranks(values: Sequence[float | int]) -> np.ndarray:
    """Rank of each value from 1; NaN where there is one."""
    known = np.asarray(values, dtype=float)
    _, place, counts = np.unique(known, return_inverse=True, return_counts=True)
    ranks = counts.cumsum() - (counts - 1) / 2
    return np.where(np.isnan(known), math.nan, ranks[place])


def _check_groups(groups: Groups) -> None:
    if not groups or not all(map(len, groups)):
        raise ValueError(
            f"`groups` must hold at least one run of each task, got {[*map(len, groups)]}."
        )


def _interval(resampled: np.ndarray) -> tuple[float, float]:
    ends = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    if np.isfinite(resampled).all():
        low, high = np.quantile(resampled, ends)
    else:  # nothing lies between a number and infinity
        low, high = np.quantile(resampled, ends, method="nearest")
    return float(low), float(high)
