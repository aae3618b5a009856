"""Arguments of the actor-critic loss: checked, and translated to those of `SACLoss`."""

import math
from inspect import signature
from typing import Any, Literal

from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.objectives import SACLoss

from deep_curiosity.agent.networks import PRIORS
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.torchrl.action_box import ActionBox
from deep_curiosity.transitions import is_number

REFUSED_OPTIONS = {"value_network", "target_entropy", "skip_done_states", "delay_actor"}
"""Keyword arguments of `SACLoss` that mean nothing here, or have another name."""
GIVEN = {"self", "args", "kwargs", "actor_network", "qvalue_network", "action_spec"}
"""Parameters of `SACLoss` that are parameters of the loss itself."""


def action_box(
    actor_network: ProbabilisticTensorDictSequential, action_spec: TensorSpec | None
) -> ActionBox:
    """Range of the actions: as given, or as the actor has it, or else [-1, 1]."""
    action_key = actor_network.dist_sample_keys[0]
    if action_spec is None:
        action_spec = getattr(actor_network, "spec", None)
        if isinstance(action_spec, Composite) and action_spec.get(action_key, None) is None:
            action_spec = None  # an actor that was given none has an empty entry for it
    return ActionBox() if action_spec is None else ActionBox.from_spec(action_spec, action_key)


def target_entropy(
    target_information_rate: float | None, prior: str, box: ActionBox
) -> float | Literal["auto"]:
    """Target entropy for `SACLoss`, by which the rate from the prior is held."""
    if target_information_rate is None:
        return "auto"
    log_volume = box.log_half_volume + box.dim * math.log(2)
    return (log_volume if prior == "uniform" else 0.0) - target_information_rate


def check_options(options: dict[str, Any]) -> None:
    """Reject options of `SACLoss` that are not taken, and what is no option at all.

    Raises:
        TypeError: Naming one of them, and those that there are.
    """
    known = {*signature(SACLoss.__init__).parameters} - GIVEN - REFUSED_OPTIONS
    for name in options.keys() - known:
        raise TypeError(
            f"`{name}` is no option of this loss, got {options[name]!r}: there are its own and "
            f"{', '.join(sorted(known))}."
        )


def check_numbers(
    curiosity_discount: float,
    hunger: float,
    prior: str,
    target_information_rate: float | None,
) -> None:
    """Reject what is out of range.

    Raises:
        ValueError: Naming the first of them and its value.
    """
    if not (is_number(curiosity_discount) and 0 <= curiosity_discount < 1):
        raise ValueError(f"`curiosity_discount` must lie in [0, 1), got {curiosity_discount!r}.")
    check_hunger(hunger)
    if prior not in PRIORS:
        raise ValueError(f"`prior` must be 'uniform' or 'learned', got {prior!r}.")
    if not (target_information_rate is None or is_number(target_information_rate)):
        raise ValueError(
            "`target_information_rate` must be a finite number or None, "
            f"got {target_information_rate!r}."
        )
    if target_information_rate is not None and target_information_rate < 0:
        raise ValueError(
            "`target_information_rate` must not be negative, as no divergence is, "
            f"got {target_information_rate}."
        )


def check_hunger(hunger: Any) -> None:
    """Reject a weight of the extrinsic value that is none.

    Raises:
        ValueError: If it is no number, not finite or negative.
    """
    if isinstance(hunger, Tensor) and hunger.numel() == 1:
        hunger = hunger.item()
    if not (is_number(hunger) and hunger >= 0):
        raise ValueError(f"`hunger` must be finite and not negative, got {hunger!r}.")


def check_differentiable(bonus: Bonus | None, curiosity_discount: float) -> None:
    """Reject a bonus that is none, or has no gradient in the action where the actor needs it.

    Raises:
        TypeError: If it is something else than a `Bonus`.
        ValueError: If it scores outcomes and no critic is to learn it.
    """
    if not (bonus is None or isinstance(bonus, Bonus)):
        raise TypeError(f"`bonus` must be a Bonus or None, got {bonus!r}.")
    if bonus is not None and bonus.scores_outcomes and curiosity_discount == 0:
        raise ValueError(
            "`curiosity_discount` must be above 0 with a bonus that scores outcomes, "
            f"got {curiosity_discount} with a {type(bonus).__name__}."
        )
