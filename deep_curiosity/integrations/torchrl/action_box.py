"""The range of actions in the environment, which is [-1, 1] for bonuses and priors."""

import torch
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec

Key = str | tuple[str, ...]
"""Name of an entry of a tensordict, or the path to it."""
UNIT_EDGE = 1 - 1e-6  # atanh is infinite at the edge of the action box


class ActionBox:
    """The range of actions in the environment, which is [-1, 1] for a bonus.

    Args:
        low: Lowest action, one number or one for each entry.
        high: Highest action, likewise.

    Raises:
        ValueError: If `low` is not below `high`, one of them is not finite, or the range is wider
            than float32 holds.
    """

    def __init__(self, low: float | Tensor = -1.0, high: float | Tensor = 1.0) -> None:
        self.low, self.high = _real(low), _real(high)
        width = self.high.float() - self.low.float()
        if not (torch.isfinite(width).all() and (width > 0).all()):
            raise ValueError(
                "`low` must be finite and below `high`, "
                f"got {self.low.tolist()} and {self.high.tolist()} in float32."
            )

    @classmethod
    def from_spec(cls, action_spec: TensorSpec, action_key: Key = "action") -> "ActionBox":
        """Range of a bounded spec, or of the entry for the action in a composite one.

        Raises:
            ValueError: If the actions are not bounded, or a composite spec has no such entry.
        """
        leaf = action_spec
        if isinstance(action_spec, Composite):
            leaf = action_spec.get(action_key, None)
            if leaf is None:
                entries = [*action_spec.keys(include_nested=True, leaves_only=True)]
                raise ValueError(
                    f"`action_spec` must have an entry {action_key!r}, or be the spec of the "
                    f"action itself, got entries {entries}."
                )
        if not isinstance(leaf, Bounded):
            raise ValueError(f"`action_spec` must be bounded, got {leaf}.")
        last = (0,) * (leaf.ndim - 1)  # all environments share one range
        return cls(leaf.space.low[last], leaf.space.high[last])

    @classmethod
    def from_either(
        cls,
        action_spec: TensorSpec | None,
        low: float | Tensor,
        high: float | Tensor,
        action_key: Key = "action",
    ) -> "ActionBox":
        """Range of the spec, or where there is none, the one given."""
        return cls(low, high) if action_spec is None else cls.from_spec(action_spec, action_key)

    @property
    def dim(self) -> int:
        """Length of an action.

        Raises:
            ValueError: If one number was given for all its entries.
        """
        if self.low.ndim == 0:
            raise ValueError(
                "`action_spec` must be given where the length of an action counts, got None."
            )
        return self.low.shape[-1]

    @property
    def log_half_volume(self) -> float:
        """Log of the volume of the range over that of [-1, 1]."""
        return float(((self.high - self.low) / 2).log().sum())

    def to_unit(self, action: Tensor) -> Tensor:
        """An action of the environment as one in [-1, 1]."""
        low, high = self.low.to(action), self.high.to(action)
        return 2 * (action - low) / (high - low) - 1

    def pre_action(self, action: Tensor) -> Tensor:
        """What the tanh was taken of, as far as the rounding of the action allows."""
        return torch.atanh(self.to_unit(action).clamp(-UNIT_EDGE, UNIT_EDGE))


def _real(bound: float | Tensor) -> Tensor:
    """A bound as real numbers: of small whole ones, the width would overflow."""
    bound = torch.as_tensor(bound)
    return bound if bound.is_floating_point() else bound.float()
