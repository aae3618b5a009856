"""Hunger from step to step, set by the clock, a function, chance, or a bandit.

Hunger is the weight of reward. Where the agent is conditioned on it, it lies in [0, 1], and
curiosity has the rest.
"""

import abc
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.schedules import Schedule
from deep_curiosity.training.config import Config
from deep_curiosity.training.infos import is_told
from deep_curiosity.training.interfaces import Info

RANDOM_HUNGERS = (0.0, 0.5, 1.0, 1.0)  # one episode of four is purely curious, two are greedy
CHARGE_OF_FULL_HUNGER = 0.5  # of a charge, at which only reward counts
BANDIT_ARMS = (0.0, 0.5, 1.0)
BANDIT_SEGMENT = 250  # environment steps for which an arm is held
BANDIT_MEMORY = 40  # segments that an arm is judged by
BANDIT_EXPLORATION = 0.5  # weight of what is not known of an arm, in units of the range of scores

HungerFunction = Callable[[np.ndarray, Info], float | Sequence[float] | np.ndarray]
"""Observations `(num_envs, observation_dim)`, and the info that came with them, to hunger: one
number or `(num_envs,)`, of which an agent that is not conditioned on its hunger has the mean. What
an environment does not tell while others do is NaN among real numbers, False among flags and
`None` among all else; an entry `_name` says who tells `name`."""


class HungerController(abc.ABC):
    """Sets the hunger in each environment before a step, and records what the step brought."""

    @abc.abstractmethod
    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger in each environment, `(num_envs,)`.

        Args:
            step: Environment steps taken so far.
            observation: `(num_envs, observation_dim)`.
            info: Infos that came with the observation.
        """

    def in_evaluation(self, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger while the agent is evaluated: by default all for reward."""
        return np.ones(len(observation))

    def record(self, reward: np.ndarray, ended: np.ndarray) -> None:  # noqa: B027  most ignore it
        """Record the newest step of each environment: its reward, and whether an episode ended."""

    def begin(self, index: int) -> None:  # noqa: B027  most ignore it
        """Choose afresh for an environment whose episode begins; `record` does so by itself."""

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run must know."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # noqa: B027  most have no state
        """Restore what `state_dict` gave."""


class ScheduledHunger(HungerController):
    """The same hunger in all environments, which may go with time.

    Args:
        schedule: Environment step to hunger.
    """

    def __init__(self, schedule: Callable[[int], float]) -> None:
        self.schedule = schedule

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger of this step, once for each environment."""
        # `np.full` costs twice as much where caches are cold
        return np.array([self.schedule(step)] * len(observation))


class FunctionHunger(HungerController):
    """Hunger that is a function of observation and info, in training as in evaluations.

    Args:
        function: From observations and infos to hunger.
        highest: Largest hunger there is, 1 where the agent is conditioned on it.
    """

    def __init__(self, function: HungerFunction, highest: float) -> None:
        self.function = function
        self.highest = highest

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """What the function says."""
        return self.in_evaluation(observation, info)

    def in_evaluation(self, observation: np.ndarray, info: Info) -> np.ndarray:
        """What the function says.

        Raises:
            ValueError: If that is not one hunger, or one for each environment, within its bounds.
        """
        own = observation.copy()  # replay holds the other
        hunger = np.asarray(self.function(own, info), dtype=float)
        if hunger.shape not in ((), (len(observation),)):
            raise ValueError(
                f"`hunger` must return one number or {len(observation)}, got {hunger.shape}."
            )
        if not ((hunger >= 0) & (hunger <= self.highest) & np.isfinite(hunger)).all():
            raise ValueError(
                f"`hunger` must return finite numbers in [0, {self.highest:g}], got {hunger}."
            )
        return np.full(len(observation), hunger)


def battery_hunger(entry: int | str, observation_dim: int) -> HungerFunction:
    """The emptier the battery, the hungrier: the paper's own example, in its section 3.

    Hunger is full at half a charge: the way back must be gone on the other half.

    Args:
        entry: Of the observation, or of `info`, that holds the charge from 0 to 1.
        observation_dim: Length of an observation; of a window it is the newest one that is read.

    Raises:
        ValueError: If an observation has no such entry; once it is used, if an `info` has not.
    """
    if isinstance(entry, int) and not -observation_dim <= entry < observation_dim:
        raise ValueError(
            f"`battery` must be an entry of an observation of {observation_dim}, got {entry}."
        )

    def hunger(observation: np.ndarray, info: Info) -> np.ndarray:
        if isinstance(entry, int):
            charge = observation[:, entry % observation_dim - observation_dim]
        else:
            charge = _charge(info, entry)
        return np.clip((1.0 - charge) / CHARGE_OF_FULL_HUNGER, 0.0, 1.0)

    return hunger


def _charge(info: Info, entry: str) -> np.ndarray:
    """Charge of the battery in each environment, by their infos.

    Raises:
        ValueError: If one of them does not tell it, or tells no finite number.
    """
    told = is_told(info, entry)
    if not told.all():
        without = f", of which number {np.argmin(told)} has none" if told.ndim else ""
        raise ValueError(
            f"`battery` must be an entry of every info, {sorted(info)}{without}, got {entry!r}."
        )
    charge = np.atleast_1d(info[entry])
    if charge.dtype.kind not in "biuf" or not np.isfinite(charge).all():
        raise ValueError(
            f"`battery` must be a finite number in every info, got {charge.tolist()} as {entry!r}."
        )
    return charge


class RandomHunger(HungerController):
    """A hunger for each episode, sampled from a few.

    Args:
        num_envs: Number of environments.
        hungers: What is sampled from, all alike.
    """

    def __init__(self, num_envs: int, hungers: Sequence[float] = RANDOM_HUNGERS) -> None:
        self.hungers = hungers
        self._held = np.array([self._sample() for _ in range(num_envs)])

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger of the episode in each environment."""
        return self._held

    def record(self, reward: np.ndarray, ended: np.ndarray) -> None:
        """Sample again where an episode has ended."""
        for index in np.flatnonzero(ended):
            self.begin(int(index))

    def begin(self, index: int) -> None:
        """Sample for the episode that begins."""
        self._held[index] = self._sample()

    def state_dict(self) -> dict[str, Any]:
        """The hunger in each environment."""
        return {"held": self._held.tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self._held = np.array(state["held"])

    def _sample(self) -> float:
        return self.hungers[int(torch.randint(len(self.hungers), ()))]


class BanditHunger(HungerController):
    r"""A bandit over a few hungers, judged by the reward that each has brought of late.

    An arm is held for a segment of steps. Its score is the mean reward per step of its segments
    within memory, brought to [0, 1] by the least and the largest of them all; the next arm is the
    one of the highest `score + exploration * sqrt(log N / n)`. The arms alternate where they earn
    alike, and where they do not the hunger goes where reward is.

    Args:
        hungers: The arms.
        segment: Environment steps, of all environments together, for which an arm is held.
        memory: Number of segments that count.
        exploration: Weight of what is not known of an arm.

    Reference: Garivier & Moulines, "On Upper-Confidence Bound Policies for Switching Bandit
    Problems" (2011), for the sliding window; Badia et al., "Agent57" (2020), for the use.
    """

    def __init__(
        self,
        hungers: Sequence[float] = BANDIT_ARMS,
        *,
        segment: int = BANDIT_SEGMENT,
        memory: int = BANDIT_MEMORY,
        exploration: float = BANDIT_EXPLORATION,
    ) -> None:
        self.hungers = hungers
        self.segment = segment
        self.exploration = exploration
        self._past: deque[tuple[int, float]] = deque(maxlen=memory)
        self._num_steps, self._reward = 0, 0.0
        self._arm = self._choose()

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """The arm that is held, in all environments."""
        return np.full(len(observation), self.hungers[self._arm])

    def record(self, reward: np.ndarray, ended: np.ndarray) -> None:
        """Add up a segment; at its end, judge it and choose again."""
        self._num_steps += len(reward)
        self._reward += float(reward.sum())
        if self._num_steps >= self.segment:
            self._past.append((self._arm, self._reward / self._num_steps))
            self._num_steps, self._reward = 0, 0.0
            self._arm = self._choose()

    def state_dict(self) -> dict[str, Any]:
        """The segments within memory and the one in progress."""
        return {
            "past": list(self._past),
            "num_steps": self._num_steps,
            "reward": self._reward,
            "arm": self._arm,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self._past = deque(map(tuple, state["past"]), maxlen=self._past.maxlen)
        self._num_steps, self._reward = state["num_steps"], state["reward"]
        self._arm = state["arm"]

    def _choose(self) -> int:
        """The most promising arm; the first of all, or one of equals, by chance."""
        promise = np.array([self._promise(arm) for arm in range(len(self.hungers))])
        best = np.flatnonzero(promise == promise.max())
        return int(best[int(torch.randint(len(best), ()))])

    def _promise(self, arm: int) -> float:
        scores = [score for tried, score in self._past if tried == arm]
        if not scores:
            return math.inf
        everything = [score for _, score in self._past]
        least, span = min(everything), max(everything) - min(everything)
        mean = (sum(scores) / len(scores) - least) / span if span > 0 else 0.0
        return mean + self.exploration * math.sqrt(math.log(len(everything)) / len(scores))


def make_hunger_controller(
    config: Config,
    observation_dim: int,
    action_dim: int,
    function: HungerFunction | None = None,
) -> HungerController:
    """Make what sets the hunger in a run.

    Args:
        config: Settings of the run.
        observation_dim: Length of an observation, or of a window where there is a frame stack.
        action_dim: Length of an action.
        function: The caller's own, where the settings leave the hunger where it is.

    Raises:
        ValueError: If the battery is to be read where the observation has no entry, or the caller
            and the settings both set the hunger.
    """
    hunger = config.agent.hunger
    highest = 1.0 if config.agent.is_conditioned else math.inf
    is_fixed = isinstance(hunger, ConditionedHunger) and hunger.source == "fixed"
    if function is not None:
        if not (is_fixed or isinstance(hunger, float)):
            raise ValueError(
                "`hunger` must be a number or conditioned:VALUE where a function is given, "
                f"got {hunger}."
            )
        return FunctionHunger(function, highest)
    if isinstance(hunger, float):
        return ScheduledHunger(lambda step: hunger)
    if isinstance(hunger, Schedule):
        return ScheduledHunger(lambda step: hunger(step / config.run.total_steps))
    match hunger.source:
        case "random":
            return RandomHunger(config.environment.num_envs)
        case "bandit":
            return BanditHunger()
        case "battery":
            frames = config.environment.frame_stack
            newest_dim = (observation_dim - (frames - 1) * action_dim) // frames
            return FunctionHunger(battery_hunger(hunger.entry, newest_dim), highest)
        case _:
            return ScheduledHunger(lambda step: hunger.value)
