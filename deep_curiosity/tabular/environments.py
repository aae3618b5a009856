"""Finite environments: transitions `P[x, a, x']`, rewards `R[x, a]` and the initial states."""

from dataclasses import dataclass
from inspect import signature

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import (
    check_arguments,
    check_at_least,
    check_distribution,
    check_finite,
    check_range,
    check_shape,
    checked,
    fixed_copy,
)

STAY, FLIP = 0, 1  # the two actions of the reliable and the unreliable state
LEFT, RIGHT = 0, 1  # the two actions of the chain
MOVES = ((-1, 0), (1, 0), (0, -1), (0, 1))  # the actions of the grid: up, down, left, right
LARGEST_DISCOUNT = float(np.nextafter(1, 0))  # at one, the return without an end diverges


@dataclass(frozen=True)
class FiniteMDP:
    """A finite Markov decision process that never ends, and never changes: its arrays are copies.

    Args:
        transition: Probability of the next state for every state and action.
        reward: Expected reward of every state and action.
        start: Distribution of the first state.
        discount: Discount of the return, below one.
    """

    transition: Float[np.ndarray, "states actions next_states"]
    reward: Float[np.ndarray, "states actions"]
    start: Float[np.ndarray, " states"]
    discount: float = 0.95

    def __post_init__(self) -> None:
        check_arguments(signature(FiniteMDP), vars(self))
        num_states, num_actions = self.transition.shape[:2]
        check_shape("transition", self.transition, (num_states, num_actions, num_states))
        check_shape("reward", self.reward, (num_states, num_actions))
        check_shape("start", self.start, (num_states,))
        check_distribution("transition", self.transition)
        check_distribution("start", self.start)
        check_finite("reward", self.reward)
        check_range("discount", self.discount, 0.0, LARGEST_DISCOUNT)
        for name in ("transition", "reward", "start"):
            object.__setattr__(self, name, fixed_copy(getattr(self, name)))

    @property
    def num_states(self) -> int:
        """Number of states."""
        return self.transition.shape[0]

    @property
    def num_actions(self) -> int:
        """Number of actions."""
        return self.transition.shape[1]


@checked
def clever_random(num_actions: int = 101) -> FiniteMDP:
    """Two states and actions on a grid in [0, 1]: action a flips the state with probability a.

    The first illustration of the paper; action 0 stays, the last action flips.
    """
    check_at_least("num_actions", num_actions, 2)
    flip = np.linspace(0, 1, num_actions)
    transition = np.stack([np.stack([1 - flip, flip], -1), np.stack([flip, 1 - flip], -1)])
    return FiniteMDP(transition, np.zeros((2, num_actions)), np.full(2, 0.5))


@checked
def reliable_unreliable() -> FiniteMDP:
    """State 0 obeys STAY and FLIP; state 1 leads anywhere with one half, whatever the action.

    The second illustration of the paper.
    """
    transition = np.array([[[1.0, 0.0], [0.0, 1.0]], [[0.5, 0.5], [0.5, 0.5]]])
    return FiniteMDP(transition, np.zeros((2, 2)), np.full(2, 0.5))


@checked
def chain(num_states: int = 6, *, slip: float = 0.1, bait: float = 0.05) -> FiniteMDP:
    """A row of states: a small sure reward at the left end, a reward of 1 at the right end.

    A step goes the other way with probability `slip`; the ends hold whoever runs into them.

    Args:
        num_states: Length of the row.
        slip: Probability of a step in the other direction.
        bait: Reward of going left at the left end.
    """
    check_at_least("num_states", num_states, 2)
    check_range("slip", slip, 0.0, 1.0)
    state = np.arange(num_states)
    transition = np.zeros((num_states, 2, num_states))
    for action, chance in ((LEFT, 1 - slip), (RIGHT, slip)):
        transition[state, action, np.maximum(state - 1, 0)] += chance
        transition[state, action, np.minimum(state + 1, num_states - 1)] += 1 - chance
    reward = np.zeros((num_states, 2))
    reward[0, LEFT], reward[-1, RIGHT] = bait, 1.0
    return FiniteMDP(transition, reward, np.eye(num_states)[0])


@checked
def grid_world(num_rows: int = 4, num_columns: int = 4, *, slip: float = 0.1) -> FiniteMDP:
    """A grid from the first corner to the last, where every action pays 1 and leads to the first.

    With probability `slip` the step goes in one of the four directions at random; whoever
    walks into a wall stays.
    """
    check_at_least("num_rows", num_rows, 1)
    check_at_least("num_columns", num_columns, 1)
    check_at_least("number of cells", num_rows * num_columns, 2)
    check_range("slip", slip, 0.0, 1.0)
    row, column = np.divmod(np.arange(num_rows * num_columns), num_columns)
    step = np.zeros((row.size, len(MOVES), row.size))
    for action, (down, right) in enumerate(MOVES):
        next_row = np.clip(row + down, 0, num_rows - 1)
        next_column = np.clip(column + right, 0, num_columns - 1)
        step[np.arange(row.size), action, next_row * num_columns + next_column] = 1
    transition = (1 - slip) * step + slip * step.mean(1, keepdims=True)
    start = np.eye(row.size)[0]
    transition[-1] = start
    reward = np.zeros((row.size, len(MOVES)))
    reward[-1] = 1
    return FiniteMDP(transition, reward, start)


@checked
def random_mdp(
    num_states: int, num_actions: int, rng: np.random.Generator, *, discount: float = 0.9
) -> FiniteMDP:
    """Draws every transition from a flat Dirichlet and every reward from a normal."""
    check_at_least("num_states", num_states, 1)
    check_at_least("num_actions", num_actions, 1)
    transition = rng.dirichlet(np.ones(num_states), size=(num_states, num_actions))
    reward = rng.normal(size=(num_states, num_actions))
    return FiniteMDP(transition, reward, rng.dirichlet(np.ones(num_states)), discount)
