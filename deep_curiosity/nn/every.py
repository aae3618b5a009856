"""Counting calls of which only some are to do something."""

import torch
from torch import Tensor, nn


class Every(nn.Module):
    """Counts calls; the first is due, and every `interval`-th after it.

    Args:
        interval: Calls from one that is due to the next, at least 1.
    """

    num_calls: Tensor

    def __init__(self, interval: int) -> None:
        super().__init__()
        self.interval = interval
        self.register_buffer("num_calls", torch.zeros((), dtype=torch.long))
        self._num_calls = 0  # the same as a plain number: to read it waits for no device
        self.register_load_state_dict_post_hook(_recount)

    @property
    def is_due(self) -> bool:
        """Whether the call in progress is one that does something."""
        return self._num_calls % self.interval == 0

    def passes(self) -> bool:
        """Count the call in progress where it is not due; say whether it was counted."""
        if self.is_due:
            return False
        self.count()
        return True

    def count(self) -> None:
        """Note that a call has ended well."""
        self._num_calls += 1
        self.num_calls.fill_(self._num_calls)


def _recount(every: Every, _: object) -> None:
    every._num_calls = int(every.num_calls)
