"""All bonuses by name."""

from collections.abc import Mapping, Sequence
from typing import Any

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.config import BONUS_CONFIGS, bonus_config
from deep_curiosity.configuration import flat, override, unknown_setting

BONUSES = tuple(name for name in BONUS_CONFIGS if name not in ("constant", "none"))
"""Curiosity and the baselines that it is compared with, all weighed and standardised alike."""
OF_THE_LOOP = {
    "model_learning_rate": "give `learning_rate` to the BonusLearner, or to its buffer",
    "features_of": "choose `features` among the entries of what the bonus is given",
    "marginal_half_life": "show `observe` what was visited of late, as `visited`",
}
"""Settings that only the trainer reads, and what does their work in another loop."""


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
            `features` may also be a function or a module. `model_learning_rate` and
            `marginal_half_life` are the trainer's: a `BonusLearner` has the `learning_rate`, and
            `Bonus.observe` is given what was `visited`.

    Raises:
        TypeError: If the bonus has no such setting, or it is one that only the trainer reads.
        ValueError: If the name is unknown, or a value out of range.
    """
    if name not in BONUSES:
        raise ValueError(f"`bonus` must be one of {', '.join(BONUSES)}, got {name!r}.")
    built_with: dict[str, Any] = {}
    if name == "curiosity" and callable(options.get("features")):
        built_with["encoder"] = options.pop("features")
    config = bonus_config(name)
    _check_settings(options, flat(config))
    config = override(config, **options)
    bonus = config.make(observation_dim, action_dim, hidden_dims, **built_with)
    assert isinstance(bonus, Bonus)
    return bonus


def _check_settings(options: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Reject settings that are none of the bonus, or would do nothing."""
    for option, value in options.items():
        if option in known and option in OF_THE_LOOP:
            raise TypeError(
                f"`{option}` must be left out, got {value!r}: only the trainer reads it; "
                f"{OF_THE_LOOP[option]}."
            )
        if option not in known:
            there_are = [name for name in known if name not in OF_THE_LOOP]
            raise unknown_setting(option, [*there_are, "hidden_dims"])
