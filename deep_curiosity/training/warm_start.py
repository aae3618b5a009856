"""Beginning a run with what another has learned."""

from typing import Any

from torch import Tensor

from deep_curiosity.training.checkpoint import load_checkpoint, usual_observation_of
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import IGNORED, Config
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.log import read_values

LEARNED = (
    "policy.",
    "critics.",
    "target_critics.",
    "prior.",
    "observation_scaling.",
    "value_stds",
    "curiosity_mean",
)
"""What of an agent is learned; the rest are settings, optimisers, and what settings start."""
BY_SETTINGS = ("value", "tuned_weight.log_factor")
"""What of a bonus starts as `bonus_weight` says: a constant, and how far a weight was tuned."""
OF_MEANING = ("whitening", "features", "features_of", "bonus_parts")
"""Settings of a bonus that say what its weights and statistics mean, whatever their shapes."""


def begin_from(config: Config, learner: Learner, collector: Collector) -> None:
    """Give a learner the weights, models and statistics of the run in `init_from`, if one is set.

    Optimisers, temperature, hunger and the weight of the bonus start as the settings of this run
    say.

    Args:
        config: Settings of the run that begins.
        learner: Receives what was learned; it must not have been compiled yet.
        collector: Receives how large observations usually are.

    Raises:
        FileNotFoundError: If the folder holds no run, or no checkpoint that can be read.
        ValueError: If that run has another bonus, one that is of something else, or parts of other
            sizes.
    """
    folder = config.run.init_from
    if folder is None:
        return
    there = read_values(folder, "init_from")
    _check_bonus(config, there)
    checkpoint = load_checkpoint(folder, argument="init_from")
    state = checkpoint["learner"]
    _check_sizes(_learned(learner.agent.state_dict()), _learned(state["agent"]), config, there)
    learner.agent.load_state_dict(learner.agent.state_dict() | _learned(state["agent"]))
    if learner.bonus is not None:
        own = learner.bonus.state_dict()
        _check_sizes(own, state["bonus"], config, there)
        as_set = {name: own[name] for name in BY_SETTINGS if name in own}
        learner.bonus.load_state_dict(state["bonus"] | as_set)
    usual = usual_observation_of(checkpoint)
    if usual is not None:  # a checkpoint that is older has none
        collector.begin_from(usual.numpy())
    if config.run.init_replay:
        _check_num_envs(config, there)
        learner.replay.take_over(state["replay"])


def _learned(agent: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: value for name, value in agent.items() if name.startswith(LEARNED)}


def _check_bonus(config: Config, there: dict[str, Any]) -> None:
    """Refuse a bonus that the other run has not, or whose numbers mean something else there."""
    here = config.to_json()
    for name in ("bonus", *OF_MEANING):
        other = there.get(name, here.get(name))  # a run that is older says nothing
        if name in here and here[name] != other:
            raise ValueError(
                f"`{name}` must be {other!r}, that of the run in {config.run.init_from}, to begin "
                f"from it, got {here[name]!r}."
            )


def _check_sizes(
    own: dict[str, Tensor], other: dict[str, Tensor], config: Config, there: dict[str, Any]
) -> None:
    """Refuse parts that the other run has not, or has in other shapes."""
    for name in sorted(own.keys() | other.keys()):
        shapes = [tuple(each[name].shape) if name in each else None for each in (own, other)]
        if shapes[0] != shapes[1]:
            raise ValueError(
                "`init_from` must be a run whose parts have the sizes of this one, got "
                f"{config.run.init_from}, where {name} has shape {shapes[1]}, here {shapes[0]}. "
                f"Settings that differ: {_differences(config, there)}."
            )


def _differences(config: Config, there: dict[str, Any]) -> str:
    """Settings of two runs that differ, as far as they have to do with sizes."""
    here = config.to_json()
    aside = (*IGNORED, "seed", "init_from", "init_replay", "total_steps")
    differing = [
        f"{name} ({there.get(name)!r} there, {value!r} here)"
        for name, value in here.items()
        if name not in aside and there.get(name) != value
    ]
    return ", ".join(differing) or "none; the tasks must have other sizes"


def _check_num_envs(config: Config, there: dict[str, Any]) -> None:
    here, other = config.environment.num_envs, there.get("num_envs")
    if here != other:
        raise ValueError(
            f"`num_envs` must be {other}, that of the run in {config.run.init_from}, to take its "
            f"replay, got {here}."
        )
