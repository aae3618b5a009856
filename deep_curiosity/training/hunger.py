"""Who says how hungry the agent is, from step to step: the clock, a sense, draws, or a bandit.

Hunger is the weight of reward. On a dial it lies in [0, 1], and curiosity has the rest.
"""

import abc
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from deep_curiosity.schedules import Schedule
from deep_curiosity.training.collector import Info
from deep_curiosity.training.config import Settings

DRAWN_HUNGERS = (0.0, 0.5, 1.0, 1.0)  # one episode of four is purely curious, two are greedy
LACK_OF_HUNGRY = 0.5  # of a charge, at which only reward counts
BANDIT_ARMS = (0.0, 0.5, 1.0)
BANDIT_SEGMENT = 250  # environment steps for which an arm is held
BANDIT_MEMORY = 40  # segments that an arm is judged by
BANDIT_BOLDNESS = 0.5  # weight of what is not known of an arm, in units of the range of scores

HungerFunction = Callable[[np.ndarray, Info], ArrayLike]
"""Observations `(num_envs, observation_dim)`, and the info that came with them, to hunger: one
number or `(num_envs,)`."""


class HungerController(abc.ABC):
    """Says how hungry the agent is in each world before a step, and sees what came of it."""

    @abc.abstractmethod
    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger in each world, `(num_envs,)`.

        Args:
            step: Environment steps taken so far.
            observation: `(num_envs, observation_dim)`.
            info: What the worlds say with the observation.
        """

    def in_evaluation(self, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger while the agent is evaluated: by default all for reward."""
        return np.ones(len(observation))

    def record(self, reward: np.ndarray, ended: np.ndarray) -> None:  # noqa: B027  most do not look
        """Look at the newest step of each world: its reward, and whether it ended the episode."""

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run must know."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # noqa: B027  most update_statistics nothing
        """Restore what `state_dict` gave."""


class ScheduledHunger(HungerController):
    """The same hunger in all worlds, which may go with time.

    Args:
        schedule: Environment step to hunger.
    """

    def __init__(self, schedule: Callable[[int], float]) -> None:
        self.schedule = schedule

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """Hunger of this step, once for each world."""
        # `np.full` costs twice as much where caches are cold
        return np.array([self.schedule(step)] * len(observation))


class FunctionHunger(HungerController):
    """Hunger that is a function of what is seen or told, in training as in evaluations.

    Args:
        sense: From observations and infos to hunger.
        highest: Largest hunger there is, 1 on a dial.
    """

    def __init__(self, sense: HungerFunction, highest: float) -> None:
        self.sense = sense
        self.highest = highest

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """What is sensed."""
        return self.in_evaluation(observation, info)

    def in_evaluation(self, observation: np.ndarray, info: Info) -> np.ndarray:
        """What is sensed.

        Raises:
            ValueError: If it is not one hunger, or one for each world, that there is.
        """
        hunger = np.asarray(self.sense(observation, info), dtype=float)
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
        observation_dim: Length of an observation.

    Raises:
        ValueError: If an observation has no such entry; once it is used, if an `info` has not.
    """
    if isinstance(entry, int) and not -observation_dim <= entry < observation_dim:
        raise ValueError(
            f"`battery` must be an entry of an observation of {observation_dim}, got {entry}."
        )

    def sense(observation: np.ndarray, info: Info) -> np.ndarray:
        if isinstance(entry, int):
            charge = observation[:, entry]
        elif entry in info:
            charge = np.atleast_1d(info[entry])
        else:
            raise ValueError(
                f"`battery` must be told by every info, {sorted(info)}, got {entry!r}."
            )
        return np.clip((1.0 - charge) / LACK_OF_HUNGRY, 0.0, 1.0)

    return sense


class RandomHunger(HungerController):
    """A hunger for each episode, drawn from a few.

    Args:
        num_envs: Number of worlds.
        hungers: What is drawn from, all alike.
    """

    def __init__(self, num_envs: int, hungers: Sequence[float] = DRAWN_HUNGERS) -> None:
        self.hungers = hungers
        self._held = np.array([self._draw() for _ in range(num_envs)])

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """What was drawn for the episode in each world."""
        return self._held

    def record(self, reward: np.ndarray, ended: np.ndarray) -> None:
        """Draw again where an episode has ended."""
        for world in np.flatnonzero(ended):
            self._held[world] = self._draw()

    def state_dict(self) -> dict[str, Any]:
        """The hunger in each world."""
        return {"held": self._held.tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self._held = np.array(state["held"])

    def _draw(self) -> float:
        return self.hungers[int(torch.randint(len(self.hungers), ()))]


class BanditHunger(HungerController):
    r"""A bandit over a few hungers, judged by the reward that each has brought of late.

    An arm is held for a segment of steps. Its score is the mean reward per step of its segments
    within memory, brought to [0, 1] by the least and the largest of them all; the next arm is the
    one of the highest `score + boldness * sqrt(log N / n)`. Where no reward tells the arms apart
    they take turns, and where it does the dial goes where reward is.

    Args:
        hungers: The arms.
        segment: Environment steps, of all worlds together, for which an arm is held.
        memory: Number of segments that count.
        boldness: Weight of what is not known of an arm.

    Reference: Garivier & Moulines, "On Upper-Confidence Bound Policies for Switching BanditHunger
    Problems" (2011), for the sliding window; Badia et al., "Agent57" (2020), for the use.
    """

    def __init__(
        self,
        hungers: Sequence[float] = BANDIT_ARMS,
        *,
        segment: int = BANDIT_SEGMENT,
        memory: int = BANDIT_MEMORY,
        boldness: float = BANDIT_BOLDNESS,
    ) -> None:
        self.hungers = hungers
        self.segment = segment
        self.boldness = boldness
        self._past: deque[tuple[int, float]] = deque(maxlen=memory)
        self._num_steps, self._reward = 0, 0.0
        self._arm = self._choose()

    def hunger(self, step: int, observation: np.ndarray, info: Info) -> np.ndarray:
        """The arm that is held, in all worlds."""
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
        return mean + self.boldness * math.sqrt(math.log(len(everything)) / len(scores))


def make_hunger_controller(settings: Settings, observation_dim: int, sense: HungerFunction | None = None) -> HungerController:
    """Who says how hungry the agent of a run is.

    Args:
        settings: Of the run.
        observation_dim: Length of an observation.
        sense: The caller's own, where the settings leave the hunger where it is.

    Raises:
        ValueError: If the battery is to be read where the observation has no entry, or the caller
            and the settings both say how hungry the agent is.
    """
    highest = 1.0 if settings.has_dial else math.inf
    if sense is not None:
        if settings.hunger_control not in ("constant", "dial"):
            raise ValueError(
                "`hunger_control` must be 'constant' or 'dial' where `hunger` is given, "
                f"got {settings.hunger_control!r}."
            )
        return FunctionHunger(sense, highest)
    match settings.hunger_control:
        case "constant" | "dial":
            return ScheduledHunger(lambda step: settings.hunger)
        case "draws":
            return RandomHunger(settings.num_envs)
        case "bandit":
            return BanditHunger()
        case "battery":
            return FunctionHunger(battery_hunger(settings.battery, observation_dim), highest)
        case shape:
            return ScheduledHunger(
                Schedule(settings.hunger, settings.final_hunger, settings.total_steps, shape)
            )
