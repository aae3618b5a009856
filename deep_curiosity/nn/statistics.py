"""Running statistics of a stream: counts, moments, and what is standardised by them."""

import math
from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from deep_curiosity.transitions import (
    LARGEST,
    check_counts,
    check_flags,
    check_number_kind,
    is_number,
)

VARIANCE_FLOOR = 1e-8  # a feature that never moves is whitened by 1e-4 of its unit, not by zero
NUM_DRAWN = 2_048  # rows: an interquartile range of so many is right to 3 %
QUARTILES = torch.tensor([0.25, 0.5, 0.75])
NORMAL_RANGE = 1.349  # interquartile range of a standard Gaussian
FAR = 3.0  # scales beyond which a value is as good as at this distance, to a saturating scale
REST = 1e-3  # of the distance of a far row, within which a feature rests
FEW_ROWS = 0.01  # beyond that far row
MOST_ROWS = 0.5  # share from which a feature counts as one that rests, in part
ALL_ROWS = 0.75  # in full: a feature of two values must not change its unit from row to row
TIED_ROWS = 0.2  # share of rows at one value from which this is kept as a median
NEAR_HALF = 0.6  # as long as no more than this share lies on one side of it
NORMAL_SHARE = 0.99501  # mean of min(z^2, FAR^2) of a standard Gaussian
SCALE_STEPS = 12  # of the fixed-point iteration for that scale, from above
MORE_SCALE_STEPS, FALLING = 24, 0.9  # where it still falls, as with an absurd row among few
WHITENED_BOUND = 10.0  # a feature that starts to move late would drown all others
STATISTICS_MEMORY = 1_280.0  # rows; a bonus drifts as its model learns, so old ones fade
STATISTICS_BATCHES = 20.0  # after which old ones fade where these are small: it is time that fades
LEAST_MEMORY = 40.0  # rows, however small batches are: fewer tell of no standard deviation
STATISTICS_REACH = 10.0  # scales within which a row counts as it is: one alone must not rule them
INPUT_MEMORY = 51_200.0  # rows after which old ones fade; replay widens as it fills
INPUT_SIZES = 0.1, 10.0  # root mean squares that a network is shown as they are
ABSURD = 1e4  # sizes of a feature, at which it is cut where it keeps its unit
INPUT_FLOOR = 1e-16  # mean square of what is noise of arithmetic, and stays as it is
FEW_TO_COMPARE = 4  # rows of a batch below which it does not tell what rests
MOST_WEIGHT = 1e37  # of a bonus that float32 holds at five standard deviations
BONUS_BOUND = 5.0  # standard deviations at which a bonus is cut, so that no tail rules
HASH_OFFSET = 0x9E3779B9  # so that zeros count; the golden ratio's digits
HASH_FACTOR = 0x5851F42D4C957F2D  # odd, of Knuth's generator MMIX


class Every(nn.Module):
    """Counts calls; the first is due, and every `interval`-th after it.

    Args:
        interval: Calls from one that is due to the next, at least 1.
    """

    num_calls: Tensor

    def __init__(self, interval: int) -> None:
        super().__init__()
        check_counts(interval=interval)
        self.interval = interval
        self.register_buffer("num_calls", torch.zeros((), dtype=torch.long))
        self._num_calls = 0  # the same as a plain number: to read it waits for no device
        self.register_load_state_dict_post_hook(_recount)

    @property
    def should_skip(self) -> bool:
        """Whether the next call is to do nothing. A query that changes nothing."""
        return self._num_calls % self.interval != 0

    def count(self) -> None:
        """Note that a call has ended well, or was skipped."""
        self._num_calls += 1
        self.num_calls.fill_(self._num_calls)


class RunningMoments(nn.Module):
    """Mean and variance of each feature over all rows so far.

    Args:
        dim: Number of features.
        memory: Rows after which old ones fade: from then on every update is an exponential moving
            average. Infinity weighs all rows alike.
        reach: Scales from the centre at which a value is counted that lies beyond, once there is
            a scale: one absurd row cannot widen it for all others, and what has moved for good
            is followed. Where a feature rests in most rows, its scale is that of the others.
            Infinity counts all rows as they are.
        batches: Batches after which old rows fade, where this is sooner and batches are small.
    """

    mean: Tensor
    var: Tensor
    count: Tensor
    moving: Tensor
    """Share of rows in which each feature does not rest; one where it rests in less than half."""
    center: Tensor
    """Middle of each feature."""
    scale: Tensor
    """Standard deviation of each feature, never zero; one while a single row is known."""

    def __init__(
        self,
        dim: int,
        *,
        memory: float = float("inf"),
        reach: float = float("inf"),
        batches: float = float("inf"),
    ) -> None:
        super().__init__()
        check_counts(dim=dim)
        for name, number in (("memory", memory), ("reach", reach), ("batches", batches)):
            if not (is_number(number) or number == math.inf) or number <= 0:
                raise ValueError(f"`{name}` must be positive, got {number!r}.")
        self.memory = memory
        self.reach = reach
        self.batches = batches
        self.register_buffer("mean", torch.zeros(dim))
        self.register_buffer("var", torch.ones(dim))
        self.register_buffer("count", torch.zeros(()))
        self.register_buffer("moving", torch.ones(dim))
        self.register_buffer("center", torch.zeros(dim), persistent=False)
        self.register_buffer("scale", torch.ones(dim), persistent=False)
        self.register_load_state_dict_pre_hook(_add_moving)
        self.register_load_state_dict_post_hook(_restore_units)

    @torch.no_grad()
    def update(self, value: Float[Tensor, "batch dim"]) -> None:
        """Merge a batch by the parallel formula of Chan, Golub and LeVeque (1979)."""
        if not len(value):
            return
        self._merge(value)
        self._set_units()

    def normalize(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """Centre, scale, and cut at 10 of its scales."""
        return ((value - self.center) / self.scale).clamp(-WHITENED_BOUND, WHITENED_BOUND)

    def is_far(self, value: Float[Tensor, "batch dim"]) -> Bool[Tensor, " batch"]:
        """Rows with an entry further from the usual than 10 of its scales where it moves."""
        distance = ((value - self.center) / self.scale).abs()
        return (distance >= WHITENED_BOUND * self.moving.rsqrt()).any(-1)

    def denormalize(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """What `normalize` makes this value of, where it cuts nothing."""
        return self.center + self.scale * value

    @property
    def rests(self) -> Bool[Tensor, " dim"]:
        """Features that have not moved yet, and so have no unit but the least."""
        return self.var <= VARIANCE_FLOOR

    def _merge(self, value: Tensor) -> None:
        if self.reach < math.inf:
            # what has never moved has no size yet by which to call a row absurd
            is_new = (self.count < 2) | self.rests
            bound = self.reach * self.scale * self.moving.rsqrt()
            bound = torch.where(is_new, torch.inf, bound)
            value = value.clamp(self.center - bound, self.center + bound)
        num_rows = value.shape[0]
        batch_mean = value.mean(0)
        batch_var = value.var(0, correction=0)
        memory = min(self.memory, max(self.batches * num_rows, LEAST_MEMORY))
        self.count.add_(num_rows).clamp_(max=max(memory, num_rows))
        share = num_rows / self.count
        if self.reach < math.inf and num_rows >= FEW_TO_COMPARE:
            resting = value.mT.contiguous().median(-1).values
            self.moving.lerp_(_moving_share((value != resting).to(value)), share)
        difference = batch_mean - self.mean
        self.var.lerp_(batch_var, share).add_(difference.square() * share * (1 - share))
        self.mean.lerp_(batch_mean, share)

    def _set_units(self) -> None:
        """Work out centre and scale once, for all uses up to the next update."""
        self.center.copy_(self.mean)
        self.scale.copy_(torch.where(self.count < 2, 1.0, (self.var + VARIANCE_FLOOR).sqrt()))


class RobustMoments(RunningMoments):
    """Median and interquartile range of each feature, which heavy tails leave where they are.

    They are those of a fair sample of 2 048 of all rows so far, exact until there are more. Of a
    Gaussian, the scale is the standard deviation. A feature that rests in most rows and moves in
    the others has no such range, and is scaled by its standard deviation.

    Args:
        dim: Number of features.

    Reference: the sample keeps the rows of the least random keys, as in Efraimidis & Spirakis,
    "Weighted random sampling with a reservoir" (2006); a key is a hash of the row's number.
    """

    rows: Tensor
    keys: Tensor
    num_seen: Tensor
    median: Tensor
    robust_std: Tensor

    def __init__(self, dim: int) -> None:
        super().__init__(dim)
        self.register_buffer("rows", torch.zeros(NUM_DRAWN, dim))
        self.register_buffer("keys", torch.full((NUM_DRAWN,), torch.iinfo(torch.long).max))
        self.register_buffer("num_seen", torch.zeros((), dtype=torch.long))
        self.register_buffer("median", torch.zeros(dim))
        self.register_buffer("robust_std", torch.ones(dim))

    def _merge(self, value: Tensor) -> None:
        """Let a batch take part in the sample, and measure it."""
        super()._merge(value)
        number = self.num_seen + torch.arange(len(value), device=value.device)
        self.num_seen.add_(len(value))
        keys = torch.cat([self.keys, scrambled(number + HASH_OFFSET)])
        keys, kept = torch.topk(keys, NUM_DRAWN, largest=False, sorted=True)
        self.keys.copy_(keys)
        self.rows.copy_(torch.cat([self.rows, value])[kept])
        self._measure(self.rows[: int(self.num_seen)])  # empty places have the largest keys

    def _measure(self, sample: Float[Tensor, "rows dim"]) -> None:
        low, median, high = sample.quantile(QUARTILES.to(sample), dim=0)
        self.median.copy_(median)
        self.robust_std.copy_((high - low) / NORMAL_RANGE)

    def _set_units(self) -> None:
        """Median, and interquartile range over that of a standard Gaussian, never zero."""
        self.center.copy_(self.median)
        rests = self.robust_std.square() <= VARIANCE_FLOOR
        var = torch.where(rests, self.var, self.robust_std.square())
        self.scale.copy_(torch.where(self.count < 2, 1.0, (var + VARIANCE_FLOOR).sqrt()))


class SaturatingMoments(RobustMoments):
    r"""Units in which what is far from the usual counts by its logarithm.

    .. math:: y = asinh((x - median) / scale)

    Near the median it is the value in units of its scale; a speed ten times as large is 2.3 units
    further, whatever it was. The scale solves `mean(min((x - median)^2, 9 scale^2)) = scale^2`, up
    to a factor that makes it the standard deviation of a Gaussian: no row counts for more than
    three scales, so a thousandth of all rows cannot coarsen the sight of the others, while a tenth
    of them widens it. A feature that rests at its median in most rows is measured in the others
    alone: beside so many zeros, all that it does when it moves would count as far.

    Args:
        dim: Number of features.

    Reference: the scale is Huber's proposal 2, "Robust Estimation of a Location Parameter" (1964).
    """

    def normalize(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """Centre, scale, saturate, and cut at ten thousand scales."""
        saturated = torch.asinh((value - self.center) / self.scale)
        return saturated.clamp(-WHITENED_BOUND, WHITENED_BOUND)

    def denormalize(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """What `normalize` makes this value of, up to ten thousand scales from the centre."""
        bounded = value.clamp(-WHITENED_BOUND, WHITENED_BOUND)  # float32 holds no sinh of 90
        return self.center + self.scale * torch.sinh(bounded)

    def _measure(self, sample: Float[Tensor, "rows dim"]) -> None:
        median = sample.mT.contiguous().median(-1).values
        below, above = ((sample - self.median).sign() == side for side in (-1, 1))
        below, above = below.float().mean(0), above.float().mean(0)
        # of two values, each in half of the rows, the median would be now the one, now the other
        is_median = (1 - below - above >= TIED_ROWS) & (torch.maximum(below, above) <= NEAR_HALF)
        self.median.copy_(torch.where(is_median, self.median, median))
        square = (sample - self.median).square()
        # the farthest hundredth is left out, of which a single absurd row may be
        place = 1 + int((1 - FEW_ROWS) * (len(square) - 1))
        far = square.mT.contiguous().kthvalue(place, -1).values
        rests = square <= REST**2 * far
        resting = (ALL_ROWS - rests.float().mean(0)) / (ALL_ROWS - MOST_ROWS)
        counted = torch.where(rests, resting.clamp(0, 1), 1.0)
        counted = counted / counted.sum(0).clamp(min=1)
        var = (counted * square).sum(0)
        for _ in range(SCALE_STEPS):
            var = (counted * torch.minimum(square, FAR**2 * var)).sum(0) / NORMAL_SHARE
        for _ in range(MORE_SCALE_STEPS):
            further = (counted * torch.minimum(square, FAR**2 * var)).sum(0) / NORMAL_SHARE
            falls = further < FALLING * var
            if not falls.any():
                break
            var = torch.where(falls, further, var)
        self.robust_std.copy_(var.sqrt())


class InputScaling(nn.Module):
    """Brings each feature to a root mean square between 0.1 and 10.

    It is that of the other rows where a feature is zero in most, such as a flag that is seldom
    set. A feature within these keeps its unit exactly, and is cut at ten thousand of its sizes:
    one such row would stop what learns from it for good. None is shifted: a mean that follows what
    is learned from would move all that a network has learned, most where nearly equal states must
    be told apart, such as those of a pole that is held upright.

    Args:
        dim: Number of features.
    """

    square: Tensor
    count: Tensor
    moving: Tensor
    """Share of rows in which each feature is not zero; one where it is zero in less than half."""
    gain: Tensor
    """Factor of each feature; one until its root mean square is above 1e-8."""
    bound: Tensor
    """Where each feature is cut, once scaled: at ten of its sizes if it is widened, else at ten
    thousand; nowhere while it has no size."""
    reach: Tensor
    """Value above which none counts for more: ten sizes of its feature, once there is a size."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        check_counts(dim=dim)
        self.register_buffer("square", torch.zeros(dim))
        self.register_buffer("count", torch.zeros(()))
        self.register_buffer("moving", torch.ones(dim))
        self.register_buffer("gain", torch.ones(dim), persistent=False)
        self.register_buffer("bound", torch.full((dim,), torch.inf), persistent=False)
        self.register_buffer("reach", torch.full((dim,), LARGEST), persistent=False)
        self.register_load_state_dict_pre_hook(_add_moving)
        self.register_load_state_dict_post_hook(_restore_units)

    @torch.no_grad()
    def update(self, value: Float[Tensor, "batch dim"]) -> None:
        """Let a batch count; no entry of it for more than ten sizes of its feature."""
        if not len(value):
            return
        square = value.clamp(-self.reach, self.reach).square().mean(0)
        self.count.add_(len(value)).clamp_(max=max(INPUT_MEMORY, len(value)))
        share = len(value) / self.count
        self.square.lerp_(square, share)
        self.moving.lerp_(_moving_share((value != 0).to(value)), share)
        self._set_units()

    def forward(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """The features as a network sees them."""
        return (self.gain * value).clamp(-self.bound, self.bound)

    def _set_units(self) -> None:
        """Work out gain, bound and reach once, for all uses up to the next update."""
        least, most = INPUT_SIZES
        rests = self.square <= INPUT_FLOOR
        size = torch.where(rests, least, (self.square / self.moving).sqrt())
        self.reach.copy_(torch.where(rests, LARGEST, WHITENED_BOUND * size))
        self.gain.copy_(size.clamp(least, most) / size)
        absurd = torch.where(rests, torch.inf, ABSURD * size.clamp(max=most))
        self.bound.copy_(torch.where(self.gain > 1, WHITENED_BOUND * least, absurd))


WHITENINGS: dict[str, Callable[[int], RunningMoments]] = {
    "moments": partial(RunningMoments, reach=WHITENED_BOUND),
    "robust": RobustMoments,
    "saturating": SaturatingMoments,
}
"""What a vector can be whitened by, by name."""


class Standardization(nn.Module):
    """Brings a bonus to a scale of its own: `weight * (value - mean) / std`, cut at 5 `std`.

    Until there are statistics the bonus is zero, unless it is neither centred nor scaled.

    Args:
        weight: Factor of the result.
        center: Subtract the running mean. Ending an episode is then worth as much as an average
            step: neither bait nor threat.
        scale: Divide by the running standard deviation; without it the value keeps its unit.

    Raises:
        TypeError: If `weight` is no number, or another argument neither True nor False.
        ValueError: If `weight` is negative or beyond 1e37.
    """

    def __init__(self, *, weight: float, center: bool, scale: bool) -> None:
        super().__init__()
        if not (is_number(weight) and weight >= 0):
            check_number_kind(weight=weight)
            raise ValueError(f"`weight` must be finite and not negative, got {weight}.")
        if weight > MOST_WEIGHT:
            raise ValueError(f"`weight` must be at most {MOST_WEIGHT:g}, got {weight}.")
        check_flags(center=center, scale=scale)
        self.weight = float(weight)  # torch takes no large whole number
        self.center = center
        self.scale = scale
        self.moments = RunningMoments(
            1,
            memory=STATISTICS_MEMORY,
            reach=STATISTICS_REACH,
            batches=STATISTICS_BATCHES,
        )

    def forward(self, value: Float[Tensor, " batch"]) -> Float[Tensor, " batch"]:
        """Standardised value; changes no statistics."""
        if not (self.center or self.scale):
            return self.weight * value
        centered = value - self.moments.mean
        bound = BONUS_BOUND * self.moments.scale
        value = centered.clamp(-bound, bound) + (0.0 if self.center else self.moments.mean)
        if self.scale:
            value = value / self.moments.scale
        return torch.where(self.moments.count > 0, self.weight * value, 0.0)

    def in_deviations(self, value: Float[Tensor, ""]) -> Float[Tensor, ""]:
        """A mean of values in standard deviations from the usual, neither weighed nor cut."""
        return (value - self.moments.mean[0]) / self.moments.scale[0]

    def update(self, value: Float[Tensor, " batch"]) -> None:
        """Update the statistics from a batch."""
        self.moments.update(value.unsqueeze(-1))

    def forget(self) -> None:
        """Let the next batch count as the first."""
        self.moments.count.zero_()


def replaced_by_mean(
    value: Float[Tensor, " batch"], is_absurd: Bool[Tensor, " batch"]
) -> Float[Tensor, " batch"]:
    """Values, with the mean of the others in the place of absurd ones; all, where all are."""
    is_usual = ~is_absurd
    mean = torch.where(is_usual, value, 0.0).sum() / is_usual.sum().clamp(min=1)
    return torch.where(is_usual | ~is_usual.any(), value, mean)


def scrambled(number: Int[Tensor, "*batch"]) -> Int[Tensor, "*batch"]:
    """Mix the bits of 64-bit whole numbers."""
    for _ in range(2):  # round numbers have empty low bits: bring the high ones down
        number = (number ^ (number >> 29)) * HASH_FACTOR
    return number


def _moving_share(moves: Float[Tensor, "batch dim"]) -> Float[Tensor, " dim"]:
    """Share of the rows in which each feature moves, or one where that is more than half."""
    share = moves.mean(0)
    return torch.where(share > MOST_ROWS, 1.0, share)


def _add_moving(
    statistics: RunningMoments | InputScaling, state: dict[str, Tensor], prefix: str, *_: object
) -> None:
    """Take states of before there was `moving`, by which every feature moves in all rows."""
    state.setdefault(f"{prefix}moving", torch.ones_like(statistics.moving))


def _restore_units(statistics: RunningMoments | InputScaling, _: object) -> None:
    statistics._set_units()


def _recount(every: Every, _: object) -> None:
    every._num_calls = int(every.num_calls)
