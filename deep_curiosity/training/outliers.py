"""Bounds for what an environment says, so that one absurd number cannot spoil what is learned."""

import numpy as np

FACTOR = 100.0  # times the usual size of an entry, beyond which it is absurd
LIMIT = FACTOR * (1 + 1e-6)  # the same, so that rounding puts no declared bound beyond itself
RISE = 0.05  # of the usual size, in logarithm, at a step that exceeds it
SHARE = 0.01  # of the steps exceeds the usual size: where rise and fall balance
MAX_DECLARED = 1e4  # a space that allows more says nothing of what is usual
USUAL_REWARD = 10.0  # whatever was seen so far, since one that is sparse comes unannounced


class UsualSize:
    """Learns how large each entry of a stream usually is, and cuts what is absurdly larger.

    The usual size is the 99 % quantile of the absolute value, tracked by steps of 5 %: numbers of
    a new order of magnitude are taken as they are some 50 steps later, while one in a hundred
    moves nothing. What is beyond a hundred times its usual size is absurd.

    Args:
        floor: `(dim,)`, sizes that are usual from the start, and always will be.
        kept: How much of an absurd number is kept, in usual sizes: 1 where it says nothing, as of
            an observation, on which networks would extrapolate; up to a hundred where much is
            more, as of a reward.
    """

    def __init__(self, floor: np.ndarray, kept: float = 1.0) -> None:
        self.floor = floor
        self.kept = kept
        self.size = floor.copy()

    def begin(self, value: np.ndarray) -> None:
        """Take as usual what a stream begins with, `(rows, dim)` and finite."""
        self.size = np.maximum(self.size, np.abs(value).max(0))

    def cut(self, value: np.ndarray) -> np.ndarray:
        """The value, `(rows, dim)` and finite, with nothing absurd in it; learns from it."""
        exceeds = (np.abs(value) > self.size).mean(0)
        cut = cut_absurd(value, self.size, self.kept)
        self.size = np.maximum(self.size * np.exp(RISE * (exceeds - SHARE)), self.floor)
        return cut


def cut_absurd(value: np.ndarray, usual: np.ndarray, kept: float = 1.0) -> np.ndarray:
    """A value, `(rows, dim)` and finite, with nothing absurd in it; itself where there is nothing.

    Args:
        value: To be cut.
        usual: `(dim,)`, how large each entry usually is.
        kept: How much of an absurd number is kept, in usual sizes.
    """
    absurd = np.abs(value) > LIMIT * usual
    if not absurd.any():
        return value
    return np.where(absurd, np.sign(value) * (kept * usual), value).astype(value.dtype)


def usual_size(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Sizes of observations that are usual from the start: 1, or what their space says."""
    bound = np.maximum(np.abs(low), np.abs(high)).astype(float)
    return np.where(bound <= MAX_DECLARED, np.maximum(bound / FACTOR, 1.0), 1.0)
