"""What environments and policies tell each other, as types."""

from collections.abc import Callable, Mapping
from typing import Any

from torch import Tensor

Info = Mapping[str, Any]
"""Entries of the info of every environment, `(num_envs,)` each."""
Policy = Callable[[Tensor, Info], Tensor]
"""Observations `(batch, observation_dim)`, and the info that came with them, to actions
`(batch, action_dim)`."""
