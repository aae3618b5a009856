"""What the divergence of an action is made of, and how much of each part is rewarded."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from deep_curiosity.gaussians import DiagonalMixture, jensen_shannon_lower
from deep_curiosity.transitions import check_number_kind, is_number


class Coefficients(NamedTuple):
    """How much of each closed form a reward is made of; every sum of parts is one of these."""

    divergence: float
    information_gain: float
    conditional_entropy: float


DIVERGENCE = Coefficients(1.0, 0.0, 0.0)

PARTS: dict[str, Coefficients] = {
    "predictive_power": Coefficients(1.0, -1.0, 0.0),  # what is left of D without the gain
    "information_gain": Coefficients(0.0, 1.0, 0.0),
    "negative_entropy": Coefficients(0.0, 0.0, -1.0),
    "cross_entropy": Coefficients(1.0, 0.0, 1.0),  # D is this less the conditional entropy
}
"""Parts of the divergence by name: the first two make it up, and so do the last two."""


def coefficients_of(parts: Mapping[str, float] | None) -> Coefficients:
    """Sum of parts by their weights, as coefficients of the closed forms.

    Args:
        parts: Weight of each part that is rewarded; `None` is the divergence itself.

    Raises:
        TypeError: If `parts` is no mapping, or a weight no number.
        ValueError: If no part is named, a name is unknown, a weight is not finite, or the weights
            leave nothing.
    """
    if parts is None:
        return DIVERGENCE
    if not isinstance(parts, Mapping):
        raise TypeError(f"`parts` must map names to weights, got {parts!r}.")
    if not parts:
        raise ValueError(f"`parts` must name at least one of {', '.join(PARTS)}, got {parts}.")
    for name, weight in parts.items():
        if name not in PARTS:
            raise ValueError(f"`parts` must be named {', '.join(PARTS)}, got {name!r}.")
        if not is_number(weight):
            check_number_kind(**{f"parts[{name!r}]": weight})
            raise ValueError(f"`parts` must have finite weights, got {weight!r} for {name!r}.")
    weighted = [[weight * share for share in PARTS[name]] for name, weight in parts.items()]
    coefficients = Coefficients(*map(sum, zip(*weighted, strict=True)))
    if not any(coefficients):
        raise ValueError(f"`parts` must leave something when they are summed, got {parts}.")
    return coefficients


def information_gain(
    prediction: DiagonalMixture,
) -> Float[Tensor, " batch"]:
    r"""What a next state would tell about which member is right, in nats, at most `log members`.

    .. math:: JSD(p_1, \dots, p_E) = I(e; x') = I(e, k; x') - I(k; x' | e)

    for members `e` and their components `k`. Each information is the pairwise lower bound by
    Bhattacharyya distances, which is exact where members agree and where they lie far apart; with
    one component the last one is zero, and the result a lower bound.

    Reference: Kolchinsky & Tracey, "Estimating mixture entropy with pairwise distances" (2017).
    """
    loc, log_var, log_weight = (
        field.transpose(0, 1).flatten(1, 2) for field in prediction
    )  # batch members*components ...
    log_weight = log_weight - math.log(len(prediction.loc))
    joint = jensen_shannon_lower(loc, log_var, log_weight)
    return joint - jensen_shannon_lower(*prediction).mean(0)
