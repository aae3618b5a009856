"""The loss of a bonus as a torchrl loss module, for torchrl's trainers and any optimiser."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.objectives import LossModule

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.torchrl.action_box import ActionBox, Key
from deep_curiosity.integrations.torchrl.tensordicts import (
    FreshActions,
    TransitionKeys,
    TransitionReader,
)
from deep_curiosity.transitions import check_flags


class BonusLoss(LossModule):
    """What the bonus learns, as `loss_bonus`; its parameters are those of the bonus itself.

    Keys are changed by `set_keys(observation=..., action=..., reward=..., terminated=...,
    truncated=...)`.

    Args:
        bonus: What is learned.
        observe: Also show the bonus each batch, so that it renews its statistics.
        policy: Samples fresh actions for `Bonus.observe`; `None` takes those of the batch.
        action_spec: Range of the actions; `low` and `high` when `None`. Of a composite one it is
            that of the action's entry, whose key may be set up to the first batch.
        low: Lowest action. The bonus is given actions brought to [-1, 1].
        high: Highest action.

    Raises:
        TypeError: If `bonus` is no `Bonus`, or `policy` no module that names what it reads.
        ValueError: If the actions have no finite range. That a composite spec has no entry for
            them is said where their key is set, or at the first batch.
    """

    _AcceptedKeys = TransitionKeys
    default_keys = TransitionKeys
    tensor_keys: TransitionKeys

    def __init__(
        self,
        bonus: Bonus,
        *,
        observe: bool = True,
        policy: TensorDictModuleBase | None = None,
        action_spec: TensorSpec | None = None,
        low: float | Tensor = -1.0,
        high: float | Tensor = 1.0,
    ) -> None:
        super().__init__()
        check_flags(observe=observe)
        self.bonus = bonus
        self.observe = observe
        box = ActionBox(low, high) if action_spec is None else ActionBox()
        self.reader = TransitionReader(bonus, self.tensor_keys, box)
        self._action_spec = action_spec
        self._range_key: Key | None = None  # of the action whose range has been read
        self.policy = None if policy is None else FreshActions(policy, self.reader)
        self.out_keys = ["loss_bonus"]
        self._set_in_keys()
        self._read_range(must_be_there=False)

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Loss of the bonus on a batch, after it has observed it.

        Raises:
            ValueError: If all of it is padding, or the spec has no entry for the action.
        """
        self._read_range(must_be_there=True)
        transition = self.reader.read(tensordict)
        if not len(transition.reward):
            raise ValueError("`mask` must leave a step to learn from, got padding alone.")
        if self.observe:
            policy = None
            if self.policy is not None:
                policy = self.policy.at(tensordict, transition.observation)
            self.bonus.observe(transition, policy)
        with torch.enable_grad():
            return TensorDict({"loss_bonus": self.bonus.loss(transition)})

    def _set_in_keys(self) -> None:
        keys = self.tensor_keys
        outcome = (keys.observation, keys.reward, keys.terminated)
        self.in_keys = [
            keys.observation,
            keys.action,
            *(unravel_key(("next", key)) for key in outcome),
        ]

    def _read_range(self, *, must_be_there: bool) -> None:
        """Read the range of the actions from the spec, which may have no entry for them so far."""
        spec, key = self._action_spec, self.tensor_keys.action
        if spec is None or key == self._range_key:
            return
        has_entry = not isinstance(spec, Composite) or spec.get(key, None) is not None
        if has_entry or must_be_there:
            self.reader.box = ActionBox.from_spec(spec, key)
            self._range_key = key

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        self._set_in_keys()
        self._read_range(must_be_there="action" in kwargs)
