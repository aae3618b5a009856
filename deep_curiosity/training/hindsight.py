"""Goals in hindsight: what was achieved later in an episode, learned from as if it was desired."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training.environments import task_spaces
from deep_curiosity.training.spaces import ACHIEVED_GOAL, DESIRED_GOAL, Entry, TaskSpaces
from deep_curiosity.transitions import Sequences, Transition

GoalFunction = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]
"""Of achieved and desired goals, a batch each, to one number for each."""
TOLERANCE = 1e-3  # of a reward that is computed once more, from goals that may be float32


class GoalFunctionError(ValueError):
    """A function of goals, which the environment has, failed or gave what is no number."""


class Hindsight:
    """Puts other goals into a share of every batch: what was achieved later in the same episode.

    A sequence of several steps has one goal, and the reward of each is that for this goal. Where
    the environment says so, the episode, and with it the sequence, ends with the step that
    achieves it.

    Args:
        num_goals: Goals in hindsight for each real one.
        spaces: Of the task, with entries `achieved_goal` and `desired_goal` of one shape.
        compute_reward: Reward of a step that achieves a goal while another is desired.
        compute_terminated: Whether that ends the episode; what was stored stays when `None`.

    Reference: Andrychowicz et al., "Hindsight Experience Replay" (2017), strategy "future",
    https://arxiv.org/abs/1707.01495.
    """

    def __init__(
        self,
        num_goals: int,
        spaces: TaskSpaces,
        compute_reward: GoalFunction,
        compute_terminated: GoalFunction | None = None,
    ) -> None:
        self.share = num_goals / (num_goals + 1)
        self.spaces = spaces
        self.compute_reward = compute_reward
        self.compute_terminated = compute_terminated
        self._goal_shape = _goal_entry(spaces, ACHIEVED_GOAL).shape
        self._achieved = list(spaces.places(ACHIEVED_GOAL))
        self._desired = list(spaces.places(DESIRED_GOAL))

    def relabel(
        self,
        replay: ReplayBuffer,
        rows: Float[Tensor, "steps row"],
        alive: Bool[Tensor, "num_steps batch"],
        slot: Int[Tensor, " steps"],
    ) -> Sequences:
        """Sequences of which the first have another goal, so many as are to be relabelled.

        Args:
            replay: Where they are from.
            rows: As `replay.sample_rows` gave them, as are the others; they stay as they are.
            alive: Which of them belong to their sequence.
            slot: Of each row.

        Raises:
            GoalFunctionError: If a function of goals raises, or does not give finite numbers.
        """
        number = round(self.share * alive.shape[1])
        goal = replay.sample_later(slot[:number]).next_observation[:, self._achieved]
        sequences = replay.sequences(rows.clone(), alive)
        steps = Transition(  # views, of which what is written stands in the sequences
            *(field.unflatten(0, alive.shape)[:, :number] for field in sequences.steps)
        )
        steps.observation[..., self._desired] = goal
        steps.next_observation[..., self._desired] = goal
        goals = [self._in_task(steps.next_observation, self._achieved)]
        goals += [self._in_task(steps.next_observation, self._desired)]
        steps.reward[:] = _numbers("compute_reward", self.compute_reward, goals, steps.reward)
        if self.compute_terminated is None:
            return sequences
        steps.terminated[:] = _numbers(
            "compute_terminated", self.compute_terminated, goals, steps.terminated
        )
        ends = sequences.steps.terminated.unflatten(0, alive.shape)[:-1]
        goes_on = torch.cat([torch.ones_like(alive[:1]), ~ends]).cumprod(0).bool()
        return Sequences(sequences.steps, alive & goes_on)

    def _in_task(
        self, observation: Float[Tensor, "num_steps batch observation_dim"], places: list[int]
    ) -> NDArray[np.float64]:
        """Goals as the task has them, `(num_steps * batch, *goal_shape)`."""
        goal = observation[..., places].cpu().numpy().astype(np.float64)
        return goal.reshape(-1, *self._goal_shape)


def make_hindsight(num_goals: int | None, environment: gymnasium.Env) -> Hindsight | None:
    """Goals in hindsight for a task, which makes one step to find out whether it can have them.

    Args:
        num_goals: Goals in hindsight for each real one; `None` for none at all.
        environment: Made by `make_environment`. It, or a wrapper of it, has `compute_reward`, and
            perhaps `compute_terminated`, of an achieved goal, a desired one and an empty info;
            what takes no batches is called for one goal after another.

    Raises:
        ValueError: If the observations have no goals, the functions are missing or fail, or the
            reward of the step is another than is computed.
    """
    if num_goals is None:
        return None
    spaces = task_spaces(environment)
    shapes = [_goal_entry(spaces, key).shape for key in (ACHIEVED_GOAL, DESIRED_GOAL)]
    if shapes[0] != shapes[1]:
        raise ValueError(f"`hindsight` must be about goals of one shape, got {shapes}.")
    if not environment.has_wrapper_attr("compute_reward"):
        raise ValueError(
            "`hindsight` must be left out where the environment has no `compute_reward` of "
            f"achieved goal, desired goal and info, got {num_goals} for {environment.unwrapped}."
        )
    reward, achieved, desired = _first_step(environment, spaces, shapes[0])
    goals = np.stack([achieved, achieved, desired]), np.stack([desired, achieved, achieved])
    compute_reward = _goal_function(environment, "compute_reward", *goals)
    _check_reward(reward, float(compute_reward(*goals)[0]))
    compute_terminated = None
    if environment.has_wrapper_attr("compute_terminated"):
        compute_terminated = _goal_function(environment, "compute_terminated", *goals)
    return Hindsight(num_goals, spaces, compute_reward, compute_terminated)


def _first_step(
    environment: gymnasium.Env, spaces: TaskSpaces, goal_shape: tuple[int, ...]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Reward of the first step of an episode, the goal that it achieves and the desired one."""
    environment.reset(seed=0)
    space = environment.action_space
    action = np.ones(space.shape or (), space.dtype)  # at the price of an action, where it has one
    observation, reward, *_ = environment.step(action)
    achieved, desired = (
        observation[list(spaces.places(key))].astype(np.float64).reshape(goal_shape)
        for key in (ACHIEVED_GOAL, DESIRED_GOAL)
    )
    return float(reward), achieved, desired


def _check_reward(given: float, computed: float) -> None:
    if not np.isclose(computed, given, rtol=TOLERANCE, atol=TOLERANCE):
        raise ValueError(
            "`hindsight` must be left out where the reward of a step is not `compute_reward` of "
            f"its goals, got {given} from a step and {computed} from `compute_reward`."
        )


def _goal_entry(spaces: TaskSpaces, key: str) -> Entry:
    """The one entry of a goal.

    Raises:
        ValueError: If there is none.
    """
    for entry in spaces.entries:
        if entry.path == (key,) and not entry.choices:
            return entry
    there = [".".join(map(str, entry.path)) for entry in spaces.entries]
    raise ValueError(
        "`hindsight` must be left out where observations are no dictionary of boxes with "
        f"{ACHIEVED_GOAL} and {DESIRED_GOAL}, among `observation_keys` if these are set, got "
        f"{there or 'vectors'}."
    )


def _goal_function(
    environment: gymnasium.Env, name: str, achieved: NDArray[Any], desired: NDArray[Any]
) -> GoalFunction:
    """A function of the environment, at once for a batch where that gives the same.

    Raises:
        ValueError: If it gives no number for single goals.
    """
    function = environment.get_wrapper_attr(name)

    def at_once(achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(function(achieved, desired, {}), dtype=np.float64)

    def one_by_one(achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[Any]:
        pairs = zip(achieved, desired, strict=True)
        return np.array([float(function(*pair, {})) for pair in pairs])

    try:
        expected = one_by_one(achieved, desired)
    except Exception as error:
        raise ValueError(
            f"`{name}` must give a number for an achieved goal, a desired goal and an empty info, "
            f"got {type(error).__name__}: {error}"
        ) from error
    try:
        found = at_once(achieved, desired)
    except Exception:
        return one_by_one
    is_same = found.shape == expected.shape and np.allclose(found, expected)
    return at_once if is_same else one_by_one


def _numbers(name: str, function: GoalFunction, goals: list[NDArray[Any]], like: Tensor) -> Tensor:
    """What a function gives for goals, in the shape and on the device of a tensor.

    Raises:
        GoalFunctionError: If it raises, or does not give a finite number for each pair.
    """
    try:
        with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused
            value = np.asarray(function(*goals)).astype(np.float32)
        numbers = torch.from_numpy(value).reshape(like.shape)
    except Exception as error:
        raise GoalFunctionError(
            f"`{name}` must give a number for each pair of goals, got "
            f"{type(error).__name__}: {error}"
        ) from error
    if not numbers.isfinite().all():
        broken = numbers[~numbers.isfinite()][0].item()
        raise GoalFunctionError(f"`{name}` must be finite, got {broken}.")
    return numbers.to(like)
