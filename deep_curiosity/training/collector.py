"""Collection: environments stepped with full knowledge of how to get back to any step."""

import math
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from deep_curiosity.training.interruption import cut_off_at_once
from deep_curiosity.training.single_environment import SingleEnvironment

Info = Mapping[str, Any]
"""Entries of the info of every environment, `(num_envs,)` each."""
Policy = Callable[[Tensor, Info], Tensor]
"""Observations `(batch, observation_dim)`, and the info that came with them, to actions
`(batch, action_dim)`."""

CHANGED_BY_STEP = (
    "_number",
    "_length",
    "_return",
    "_success",
    "num_episodes",
    "observation",
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


class Step(NamedTuple):
    """One step of each of several environments, their axis leading, as they gave it."""

    observation: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    next_observation: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


class Collector:
    """Steps one environment, or several side by side, each from episode to episode.

    Episodes are numbered in the order in which they begin, in whichever environment, and every one
    is reset with a seed of its own, so that the state of an environment at any step is a function
    of that seed and the actions since: enough to come back to it in any vector environment whose
    environments repeat themselves, native, one after another or in processes.

    Args:
        environment: Takes actions in [-1, 1]; autoreset of a vector environment is disabled, so
            that what a step returns is the true next observation also where an episode ends.
        seed: Together with the number of the episode it seeds every reset.

    Raises:
        ValueError: If the environment resets by itself.
    """

    def __init__(self, environment: gymnasium.Env | VectorEnv, seed: int) -> None:
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
        space = environment.observation_space
        self.observation = np.zeros(space.shape or (), dtype=space.dtype)
        self._start(np.ones(num_envs, dtype=bool))

    def step(self, action: np.ndarray) -> tuple[Step, list[Episode]]:
        """Step every environment once; return the step, and the episodes that it ended.

        Args:
            action: `(num_envs, action_dim)`.
        """
        with cut_off_at_once():
            outcome = self.environment.step(action)
        next_observation, reward, terminated, truncated, self.info = outcome
        step = Step(self.observation, action, reward, next_observation, terminated, truncated)
        self.actions.append(np.array(action))
        self._length += 1
        self._return += reward
        if "is_success" in self.info:
            self._success = np.fmax(self._success, self.info["is_success"])
        self.observation, self.present_info = next_observation, self.info
        done = terminated | truncated
        if not done.any():
            return step, []
        finished = [
            Episode(float(self._return[i]), int(self._length[i]), float(self._success[i]))
            for i in np.flatnonzero(done)
        ]
        self._start(done)
        return step, finished

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
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Come back to a step by acting again, each environment joining where its episode began.

        Raises:
            RuntimeError: If an environment does not come back to the same observation.
        """
        number, length = state["number"].numpy(), state["length"].numpy()
        oldest = len(state["actions"])
        for step, action in enumerate(state["actions"]):
            self._start(length == oldest - step, number)
            self.step(action.numpy())
        self._start(length == 0, number)
        self.num_episodes = state["num_episodes"]
        _check_repeated(self.observation, state["observation"].numpy(), oldest)

    def _start(self, mask: np.ndarray, number: np.ndarray | None = None) -> None:
        """Begin episodes where the mask is, the next ones unless their numbers are given."""
        if not mask.any():
            return
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
        self.observation = np.where(mask[:, None], start, self.observation)
        self.present_info = self.present_info | {
            name: np.where(mask, value, self.present_info.get(name, value))
            for name, value in info.items()
            if np.shape(value) == mask.shape  # one for each environment
        }
        self._length[mask], self._return[mask], self._success[mask] = 0, 0.0, math.nan
        self.actions = self.actions[len(self.actions) - self._length.max() :]


def _episode_seed(seed: int, number: int) -> int:
    return int(np.random.SeedSequence((seed, number)).generate_state(1)[0])


def _check_repeated(observation: np.ndarray, expected: np.ndarray, num_steps: int) -> None:
    if not np.array_equal(observation, expected):
        raise RuntimeError(
            "the environment must repeat an episode from its seed and actions to be resumed; "
            f"after {num_steps} steps it gave {observation.tolist()}, before {expected.tolist()}."
        )


def evaluate(
    act: Policy, environment: gymnasium.Env, *, episodes: int, seed: int
) -> list[Episode]:
    """Run whole episodes of a policy, the same ones at every call.

    Args:
        act: The policy.
        environment: Apart from the one that is trained on.
        episodes: How many.
        seed: Seed of their resets.
    """
    collector = Collector(environment, seed)
    finished: list[Episode] = []
    while len(finished) < episodes:
        action = act(as_batch(collector.observation), collector.present_info).numpy()
        finished += collector.step(action)[1]
    return finished


def as_batch(observation: np.ndarray) -> Tensor:
    """Observations as a float32 batch, a single one as a batch of one."""
    return torch.from_numpy(np.atleast_2d(np.asarray(observation, dtype=np.float32)))
