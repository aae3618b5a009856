"""All bonuses by name."""

from collections.abc import Sequence
from typing import Any

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.config import BONUS_CONFIGS, bonus_config
from deep_curiosity.configuration import flat, override, unknown_setting

BONUSES = tuple(name for name in BONUS_CONFIGS if name not in ("constant", "none"))
"""Curiosity and the baselines that it is compared with, all weighed and standardised alike."""


def make_bonus(
    name: str,
    observation_dim: int,
    action_dim: int,
    *,
    hidden_dims: Sequence[int] = (256, 256),
    **options: Any,
) -> Bonus:
    """Make a bonus by its name, by default as the trainer does.

    Args:
        name: One of `BONUSES`.
        observation_dim: Length of an observation.
        action_dim: Length of an action; actions lie in [-1, 1].
        hidden_dims: Width of every hidden layer of its networks, where it has any.
        **options: Settings of the bonus by their flat names, such as `bonus_weight`; for curiosity
            `features` may also be a function or a module.

    Raises:
        TypeError: If the bonus has no such setting.
        ValueError: If the name is unknown, or a value out of range.
    """
    if name not in BONUSES:
        raise ValueError(f"`bonus` must be one of {', '.join(BONUSES)}, got {name!r}.")
    built_with: dict[str, Any] = {}
    if name == "curiosity" and callable(options.get("features")):
        built_with["encoder"] = options.pop("features")
    config = bonus_config(name)
    known = flat(config)
    for option in options:
        if option not in known:
            raise unknown_setting(option, [*known, "hidden_dims"])
    config = override(config, **options)
    bonus = config.make(observation_dim, action_dim, hidden_dims, **built_with)
    assert isinstance(bonus, Bonus)
    return bonus
