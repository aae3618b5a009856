"""Finding out that a run has diverged, before its weights are saved over good ones."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn


class DivergedError(RuntimeError):
    """A loss or a weight of a run is no longer finite."""


def broken_loss(metrics: Mapping[str, Tensor]) -> str | None:
    """The first loss among the metrics that is not finite, with its value; `None` without any."""
    for name, value in metrics.items():
        if name.endswith("loss") and not torch.isfinite(value).all():
            return f"`{name}` must stay finite, got {value.item()}"
    return None


def broken_weight(**modules: nn.Module | None) -> str | None:
    """The first weight of some modules that is not finite, by its name; `None` without any."""
    for part, module in modules.items():
        for name, weight in () if module is None else module.named_parameters():
            finite = torch.isfinite(weight)
            if not finite.all():
                return f"`{part}.{name}` must stay finite, got {weight[~finite][0].item()}"
    return None
