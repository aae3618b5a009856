"""Collection: environments stepped with full knowledge of how to get back to any step."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import math
import warnings
from copy import copy
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from deep_curiosity.training.infos import after_reset, is_told
from deep_curiosity.training.interfaces import Info, Policy
from deep_curiosity.training.interruption import cut_off_at_once
from deep_curiosity.training.outliers import (
    FACTOR,
    USUAL_REWARD,
    UsualSize,
    cut_absurd,
    usual_size,
)
from deep_curiosity.training.single_environment import SingleEnvironment

MAX_BROKEN_IN_ROW = 20  # episodes: more than that is no accident

CHANGED_BY_STEP = (
    "_number",
    "_length",
    "_return",
    "_success",
    "num_episodes",
    "observation",
    "_raw_observation",
    "_usual_observation",
    "_usual_reward",
    "_num_broken_in_row",
    "info",
    "present_info",
)
"""Attributes of a collector."""


class Episode(NamedTuple):
    """What is left of an episode once it is over, or how it stands so far."""

    episode_return: float = 0.0
    length: int = 0
    success: float = math.nan
    """1 once `info["is_success"]` was true, else 0; NaN where there is no such entry."""
    broken: bool = False
    """Whether the episode was cut off since the environment gave NaN or infinity."""


class Step(NamedTuple):
    """One step of each of several environments, their axis leading, as they gave it.

    Numbers that are absurdly large are cut at a hundred times their usual size.
    """

    observation: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    next_observation: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    sound: np.ndarray | None = None
    """False where observation or reward were not finite: that is no step to learn from. Its
    episode is cut off before it."""


class Collector:
    """Steps one environment, or several side by side, each from episode to episode.

    Episodes are numbered in the order in which they begin, in whichever environment, and every one
    is reset with a seed of its own, so that the state of an environment at any step is a function
    of that seed and the actions since: enough to come back to it in any vector environment whose
    environments repeat themselves, native, one after another or in processes.

    An episode is cut off where the environment gives NaN or infinity, as simulators do once in a
    while, and the next one begins; a warning says so, and an error where it goes on like that.

    Args:
        environment: Takes actions in [-1, 1]; autoreset of a vector environment is disabled, so
            that what a step returns is the true next observation also where an episode ends.
        seed: Together with the number of the episode it seeds every reset.
        usual_observation: `(observation_dim,)`, sizes that another collector of the task has found
            usual, which stay as they are; by default those of the first observation, which follow.

    Raises:
        ValueError: If the environment resets by itself.
    """

    def __init__(
        self,
        environment: gymnasium.Env | VectorEnv,
        seed: int,
        *,
        usual_observation: np.ndarray | None = None,
    ) -> None:
        if not isinstance(environment, VectorEnv):
            environment = SingleEnvironment(environment)
        mode = environment.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.DISABLED:
            raise ValueError(f"`environment` must have its autoreset disabled, got {mode}.")
        self.environment = environment
        self.seed = seed
        self.num_episodes = 0
        """Begun so far, in all environments."""
        self.info: dict[str, Any] = {}
        """Info of the newest step."""
        self.present_info: dict[str, Any] = {}
        """Info that came with `observation`: the same, or that of the reset after the step."""
        self.actions: list[np.ndarray] = []
        """Of all environments, `(num_envs, action_dim)` each, since the oldest episode began."""
        num_envs = environment.num_envs
        self._number = np.zeros(num_envs, dtype=int)  # of the episode in each environment
        self._length = np.zeros(num_envs, dtype=int)
        self._return = np.zeros(num_envs)
        self._success = np.zeros(num_envs)
        self._num_broken_in_row = 0
        self._is_restoring = False
        self._is_first = self._learns_usual = usual_observation is None  # of all observations
        space = environment.single_observation_space
        assert isinstance(space, spaces.Box)
        self._usual_observation = UsualSize(usual_size(space.low, space.high))
        if usual_observation is not None:
            self.begin_from(usual_observation)
        self._usual_reward = UsualSize(np.array([USUAL_REWARD]), kept=FACTOR)
        self._cut_names: set[str] = set()  # of what was cut so far, each told once
        self._raw_observation = np.zeros((num_envs, *space.shape), dtype=space.dtype)
        self.observation = self._raw_observation
        self._start(np.ones(num_envs, dtype=bool))

    @property
    def usual_observation(self) -> np.ndarray:
        """Size of each entry of an observation, `(observation_dim,)`, that is usual by now."""
        return self._usual_observation.size

    def begin_from(self, usual_observation: np.ndarray) -> None:
        """Take sizes as usual that another collector has found, in a task of the same sizes."""
        self._usual_observation.begin(usual_observation[None])

    def step(self, action: np.ndarray) -> tuple[Step, list[Episode]]:
        """Step every environment once; return the step, and the episodes that it ended.

        Args:
            action: `(num_envs, action_dim)`.
        """
        with cut_off_at_once():
            outcome = self.environment.step(action)
        next_observation, reward, terminated, truncated, self.info = outcome
        sound = np.isfinite(next_observation).all(1) & np.isfinite(reward)
        if not sound.all():
            reward = np.where(sound, reward, 0.0)
            next_observation = np.where(sound[:, None], next_observation, self._raw_observation)
            terminated, truncated = terminated & sound, truncated | ~sound
        self.actions.append(np.array(action))
        self._length += 1
        self._return += reward
        if "is_success" in self.info:
            self._success = np.fmax(self._success, _entry_of(self.info, "is_success"))
        observation = self.observation
        self._raw_observation, self.present_info = next_observation, self.info
        self.observation = self._cut("observation", self._usual_observation, next_observation)
        reward = self._cut("reward", self._usual_reward, reward[:, None])[:, 0]
        step = Step(observation, action, reward, self.observation, terminated, truncated, sound)
        return step, self._finish(terminated | truncated, sound)

    def _finish(self, done: np.ndarray, sound: np.ndarray) -> list[Episode]:
        """Begin anew where episodes are done, and return them."""
        if not done.any():
            return []
        finished = [
            Episode(
                float(self._return[i]),
                int(self._length[i]),
                float(self._success[i]),
                not sound[i],
            )
            for i in np.flatnonzero(done)
        ]
        self._count_broken([episode.broken for episode in finished])
        self._start(done)
        return finished

    def _cut(self, name: str, usual: UsualSize, value: np.ndarray) -> np.ndarray:
        """A value within its usual bounds; the first one beyond is told of."""
        follows = self._learns_usual or usual is not self._usual_observation
        cut = usual.cut(value) if follows else cut_absurd(value, usual.size, usual.kept)
        if cut is not value and name not in self._cut_names and not self._is_restoring:
            self._cut_names.add(name)
            _, entry = np.argwhere(cut != value)[0]
            warnings.warn(
                f"`{name}` should stay within {FACTOR:g} times its usual size; entry {entry} was "
                "beyond, and such values are cut, unless they come to be usual.",
                stacklevel=3,
            )
        return cut

    def _count_broken(self, broken: list[bool]) -> None:
        """Tell of episodes that broke off, and stop where nothing else comes any more.

        Raises:
            ValueError: If so many broke off one after another.
        """
        if self._is_restoring:
            return
        for is_broken in broken:
            self._num_broken_in_row = self._num_broken_in_row + 1 if is_broken else 0
        if any(broken):
            warnings.warn(
                "`observation` and `reward` must be finite, got NaN or infinity from the "
                "environment: its episode is cut off before that step, and the next one begins.",
                stacklevel=4,
            )
        if self._num_broken_in_row >= MAX_BROKEN_IN_ROW:
            raise ValueError(
                "`observation` and `reward` must be finite, got NaN or infinity in "
                f"{self._num_broken_in_row} episodes one after another."
            )

    def position(self) -> dict[str, Any]:
        """All that a step changes, for `step_back`."""
        changed = {name: copy(getattr(self, name)) for name in CHANGED_BY_STEP}
        return changed | {"actions": self.actions, "num_actions": len(self.actions)}

    def step_back(self, position: dict[str, Any]) -> None:
        """Stand where the newest step began, be it whole or cut off, so that it can be saved.

        The environments are then not where they are said to be: only what is saved can go on.
        """
        for name in CHANGED_BY_STEP:
            setattr(self, name, position[name])
        self.actions = position["actions"][: position["num_actions"]]

    def state_dict(self) -> dict[str, Any]:
        """Number and length of the episode in every environment, and the actions taken in them."""
        return {
            "num_episodes": self.num_episodes,
            "number": torch.tensor(self._number),
            "length": torch.tensor(self._length),
            "actions": torch.from_numpy(np.array(self.actions)),
            "observation": torch.tensor(self.observation),
            "raw_observation": torch.tensor(self._raw_observation),
            "usual_observation": torch.tensor(self._usual_observation.size),
            "usual_reward": torch.tensor(self._usual_reward.size),
            "num_broken_in_row": self._num_broken_in_row,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Come back to a step by acting again, each environment joining where its episode began.

        Raises:
            RuntimeError: If an environment does not come back to the same observation.
        """
        state = self._without_cuts(state["observation"]) | state
        number, length = state["number"].numpy(), state["length"].numpy()
        oldest = len(state["actions"])
        self._is_restoring = True
        for step, action in enumerate(state["actions"]):
            self._start(length == oldest - step, number)
            self.step(action.numpy())
        self._start(length == 0, number)
        self._is_restoring = False
        self.num_episodes = state["num_episodes"]
        self._num_broken_in_row = state["num_broken_in_row"]
        _check_repeated(self._raw_observation, state["raw_observation"].numpy(), oldest)
        self.observation = state["observation"].numpy()
        self._load_usual_sizes(state)

    def begin_after(self, state: dict[str, Any]) -> None:
        """Begin the next episodes, for a task that cannot be brought back into those in progress.

        Args:
            state: Of the collector that went before, as `state_dict` gave it.
        """
        state = self._without_cuts(state["observation"]) | state
        self.num_episodes = state["num_episodes"]
        self._num_broken_in_row = state["num_broken_in_row"]
        self._load_usual_sizes(state)
        self.actions = []
        self._start(np.ones(self.environment.num_envs, dtype=bool))

    def _load_usual_sizes(self, state: dict[str, Any]) -> None:
        self._usual_observation.size = state["usual_observation"].numpy()
        self._usual_reward.size = state["usual_reward"].numpy()

    def _without_cuts(self, observation: Tensor) -> dict[str, Any]:
        """What a checkpoint does not say that is older than the cuts."""
        return {
            "raw_observation": observation,
            "usual_observation": torch.tensor(self._usual_observation.floor),
            "usual_reward": torch.tensor(self._usual_reward.floor),
            "num_broken_in_row": 0,
        }

    def _start(self, mask: np.ndarray, number: np.ndarray | None = None) -> None:
        """Begin episodes where the mask is, the next ones unless their numbers are given."""
        broken: np.ndarray = mask
        while broken.any():
            start = self._begin(broken, number)
            self._raw_observation = np.where(broken[:, None], start, self._raw_observation)
            broken, number = np.logical_not(np.isfinite(self._raw_observation).all(1)), None
            self._count_broken([True] * int(broken.sum()))
        if mask.any():
            start = self._raw_observation[mask]
            if self._is_first:
                self._usual_observation.begin(start)
                self._is_first = False
            self.observation = self.observation.copy()
            self.observation[mask] = self._cut("observation", self._usual_observation, start)

    def _begin(self, mask: np.ndarray, number: np.ndarray | None) -> np.ndarray:
        """Reset where the mask is; return what the environments show."""
        if number is None:
            number = self.num_episodes + np.cumsum(mask) - 1
            self.num_episodes += int(mask.sum())
        self._number[mask] = number[mask]
        with cut_off_at_once():
            start, info = self.environment.reset(
                seed=[  # type: ignore[arg-type]  # every vector environment takes a list
                    _episode_seed(self.seed, int(number[index])) if chosen else None
                    for index, chosen in enumerate(mask)
                ],
                options={"reset_mask": mask},
            )
        self.present_info = after_reset(mask, info, self.present_info)
        self._length[mask], self._return[mask], self._success[mask] = 0, 0.0, math.nan
        self.actions = self.actions[len(self.actions) - self._length.max() :]
        return start


def _episode_seed(seed: int, number: int) -> int:
    return int(np.random.SeedSequence((seed, number)).generate_state(1)[0])


def _entry_of(info: Info, name: str) -> np.ndarray:
    """An entry of the infos of all environments; NaN in those that did not give it."""
    return np.where(is_told(info, name), np.asarray(info[name], dtype=float), math.nan)


def _check_repeated(observation: np.ndarray, expected: np.ndarray, num_steps: int) -> None:
    if not np.array_equal(observation, expected):
        raise RuntimeError(
            "`env_id` must name a task that repeats an episode from its seed and actions, to be "
            f"resumed; after {num_steps} steps it gave {observation.tolist()}, before "
            f"{expected.tolist()}; with `new_episode` a run goes on in the next one."
        )


def evaluate(
    act: Policy,
    environment: gymnasium.Env,
    *,
    episodes: int,
    seed: int,
    usual_observation: np.ndarray | None = None,
) -> list[Episode]:
    """Run whole episodes of a policy, the same ones at every call.

    Args:
        act: The policy.
        environment: Apart from the one that is trained on.
        episodes: How many.
        seed: Seed of their resets.
        usual_observation: That of the collector which the policy has learned from, so that it is
            shown what it was shown there.
    """
    collector = Collector(environment, seed, usual_observation=usual_observation)
    finished: list[Episode] = []
    while len(finished) < episodes:
        action = act(as_batch(collector.observation), collector.present_info).numpy()
        finished += collector.step(action)[1]
    return finished


def as_batch(observation: np.ndarray) -> Tensor:
    """Observations as a float32 batch, a single one as a batch of one."""
    return torch.from_numpy(np.atleast_2d(np.asarray(observation, dtype=np.float32)))
