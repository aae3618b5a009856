"""A bonus beside a buffer: what all the curious buffers share."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from inspect import signature
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.type_aliases import PyTorchObs
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.bonuses.registry import make_bonus
from deep_curiosity.integrations.stable_baselines3.spaces import CPU, bounded_space, observed_space
from deep_curiosity.transitions import Transition

Actor = Callable[[PyTorchObs], Tensor]
"""Samples actions in [-1, 1] for observations as the agent's own networks take them."""

GIVEN_BY_AGENT = {
    "self", "buffer_size", "observation_space", "action_space", "device", "n_envs",
}  # fmt: skip
"""Parameters of buffers that are no options of theirs."""


class BonusAttachment:
    """A bonus with its learner, on the buffer's device; pickled with the buffer.

    Args:
        observation_space: Of the environment.
        action_space: Of the environment.
        bonus: A name from `BONUSES`, or a bonus, which is then used itself and not copied.
        bonus_kwargs: Settings of the bonus as `make_bonus` takes them, where it is given by name.
        learning_rate: Of the networks of the bonus.
        update_interval: Batches from one gradient step of the bonus to the next.
        observation_key: Entry of a dictionary observation that the bonus is about.
        refresh_interval: Of a bonus given by name, where `bonus_kwargs` has none; its own default
            when `None`.

    Raises:
        TypeError: If `bonus` is neither a name nor a bonus, or has no such setting.
        ValueError: If the spaces hold no vectors, or an option is out of range or out of place.
    """

    actor: Actor | None

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        *,
        bonus: str | Bonus = "curiosity",
        bonus_kwargs: Mapping[str, Any] | None = None,
        learning_rate: float = 1e-3,
        update_interval: int = 1,
        observation_key: str | None = None,
        refresh_interval: int | None = None,
    ) -> None:
        (observation_dim,) = observed_space(observation_space, observation_key).shape
        self.action_space = bounded_space(action_space)
        (action_dim,) = self.action_space.shape
        self.observation_key = observation_key
        self.learner = BonusLearner(
            _find_bonus(bonus, observation_dim, action_dim, bonus_kwargs, refresh_interval),
            learning_rate=learning_rate,
            update_interval=update_interval,
        )
        self.device = CPU
        self.actor = None
        self.newest = torch.zeros(())

    def to(self, device: torch.device) -> "BonusAttachment":
        """The same, on the device where the buffer now hands out its samples."""
        if device != self.device:
            self.learner.to(device)
            self.device = device
        return self

    @property
    def has_learned(self) -> bool:
        """Whether the bonus has been shown a batch yet."""
        return int(self.learner.every.num_calls) > 0

    def select_observation(self, observation: Any) -> Any:
        """The part of an observation, or of all that are stored, that the bonus is about."""
        return observation if self.observation_key is None else observation[self.observation_key]

    def learn(self, transition: Transition, actor_input: PyTorchObs | None = None) -> None:
        """Show the bonus a batch, and let it learn from it at its own pace.

        Args:
            transition: Raw, in the units of the environment.
            actor_input: The same observations as the agent's networks take them: all keys of a
                dictionary, normalised where the agent's are.
        """
        policy = None
        if self.actor is not None and actor_input is not None:
            policy = _policy_at(transition.observation, self.actor, actor_input)
        self.learner.learn(transition, policy)

    def compute(self, transition: Transition) -> Tensor:
        """Bonus of each transition as the networks now stand, in the precision of rewards."""
        bonus = self.learner.compute(transition).float()
        self.newest = bonus.mean()
        return bonus

    def metrics(self) -> dict[str, float]:
        """What to log: the mean bonus of the newest batch, and the bonus's own metrics."""
        metrics = {"bonus": self.newest} | self.learner.bonus.metrics()
        return {name: value.item() for name, value in metrics.items()}

    def __getstate__(self) -> dict[str, Any]:
        """Without the agent, and on the CPU, so that any machine can load it."""
        learner = self.learner
        if self.device.type != "cpu":
            learner = deepcopy(learner).cpu()
        cpu = {"device": CPU, "newest": self.newest.cpu()}
        return self.__dict__ | cpu | {"learner": learner, "actor": None}


def check_known(options: Mapping[str, Any], buffer_class: type) -> None:
    """Reject options that neither the bonus nor a buffer has.

    Raises:
        TypeError: Naming the option and all that there are.
    """
    own = {"bonus", "bonus_kwargs", "learning_rate", "update_interval", "observation_key"}
    bases = [vars(base)["__init__"] for base in buffer_class.__mro__ if "__init__" in vars(base)]
    of_buffers = {
        name
        for init in bases
        for name, parameter in signature(init).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }
    known = (own | of_buffers) - GIVEN_BY_AGENT
    for name, value in options.items():
        if name not in known:
            raise TypeError(
                f"`{name}` must be one of the options {', '.join(sorted(known))}, got {value!r}."
            )


def _find_bonus(
    bonus: str | Bonus,
    observation_dim: int,
    action_dim: int,
    options: Mapping[str, Any] | None,
    refresh_interval: int | None,
) -> Bonus:
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"`bonus_kwargs` must map settings to their values, got {options!r}.")
    if isinstance(bonus, str):
        default = {} if refresh_interval is None else {"refresh_interval": refresh_interval}
        return make_bonus(bonus, observation_dim, action_dim, **default | dict(options or {}))
    if not isinstance(bonus, Bonus):
        raise TypeError(f"`bonus` must be a name or a Bonus, got {type(bonus).__name__}.")
    if options:
        raise ValueError(f"`bonus_kwargs` is for a bonus given by name, got {dict(options)}.")
    _check_fits(bonus, observation_dim=observation_dim, action_dim=action_dim)
    return bonus


def _check_fits(bonus: Bonus, **sizes: int) -> None:
    """Reject a bonus that is known to be for other spaces, or never to be computed.

    Raises:
        ValueError: Naming the bonus.
    """
    own = {name: getattr(bonus, name, size) for name, size in sizes.items()}
    if own != sizes:
        raise ValueError(f"`bonus` must be for spaces with {sizes}, got one with {own}.")
    if bonus.should_skip and not bonus.ready:
        raise ValueError(
            f"`bonus` must observe batches, or be ready, got a {type(bonus).__name__} that does "
            "not and is not: freeze a bonus once it has learned."
        )


def _policy_at(observation: Tensor, actor: Actor, actor_input: PyTorchObs) -> Policy:
    """The actor as a function of the observations of one batch, as the bonus is given them."""

    def act(queried: Tensor) -> Tensor:
        if queried is not observation:
            raise ValueError(
                "`policy` must be called with `transition.observation` itself, since the agent "
                "may observe more than the bonus, got another tensor of shape "
                f"{tuple(queried.shape)}."
            )
        return actor(actor_input)

    return act
