"""Markov chain of a policy: its state distribution (8) and its values (1, 2)."""

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import check_range, check_shape, checked
from deep_curiosity.tabular.environments import LARGEST_DISCOUNT

SMALLEST_CHANGE = 1e-15  # states that leak less than this a step count as closed
VALUE_ROUNDING = 1e-14  # of values, as a share of the largest


@checked
def state_chain(
    transition: Float[np.ndarray, "states actions next_states"],
    policy: Float[np.ndarray, "states actions"],
) -> Float[np.ndarray, "states next_states"]:
    """Markov chain of the states under a policy."""
    return np.einsum("xa,xay->xy", policy, transition)


@checked
def propagate(
    state_distribution: Float[np.ndarray, " states"],
    transition: Float[np.ndarray, "states actions next_states"],
    policy: Float[np.ndarray, "states actions"],
) -> Float[np.ndarray, " states"]:
    """State distribution one step later (8): the forward algorithm of section 4."""
    return state_distribution @ state_chain(transition, policy)


@checked
def limiting_matrix(
    chain: Float[np.ndarray, "states next_states"],
) -> Float[np.ndarray, "states next_states"]:
    """Long-run share of time in each state, for every initial state.

    Squares the lazy chain, which has the same limit and no period, so closed classes and cycles
    need no special case.
    """
    check_shape("chain", chain, (len(chain), len(chain)))
    power, change = (np.eye(len(chain)) + chain) / 2, np.inf
    while change > SMALLEST_CHANGE:
        squared = power @ power
        squared /= squared.sum(1, keepdims=True)
        power, change = squared, np.abs(squared - power).max()
    return power


@checked
def stationary_distribution(
    transition: Float[np.ndarray, "states actions next_states"],
    policy: Float[np.ndarray, "states actions"],
    start: Float[np.ndarray, " states"],
) -> Float[np.ndarray, " states"]:
    """Long-run state distribution of a policy; `start` matters only if it is not unique."""
    return start @ limiting_matrix(state_chain(transition, policy))


@checked
def action_values(
    transition: Float[np.ndarray, "states actions next_states"],
    reward: Float[np.ndarray, "states actions"],
    policy: Float[np.ndarray, "states actions"],
    discount: float,
) -> Float[np.ndarray, "states actions"]:
    """Action values Q of a policy (1), by one linear solve."""
    check_range("discount", discount, 0.0, LARGEST_DISCOUNT)
    check_shape("transition", transition, (*reward.shape, len(reward)))
    resolvent = np.eye(len(policy)) - discount * state_chain(transition, policy)
    value = np.linalg.solve(resolvent, np.einsum("xa,xa->x", policy, reward))
    return reward + discount * transition @ value


@checked
def expected_return(
    state_distribution: Float[np.ndarray, " states"],
    policy: Float[np.ndarray, "states actions"],
    action_value: Float[np.ndarray, "states actions"],
) -> float:
    """Expected return V (2) of states sampled from a distribution."""
    return float(np.einsum("x,xa,xa->", state_distribution, policy, action_value))


@checked
def optimal_action_values(
    transition: Float[np.ndarray, "states actions next_states"],
    reward: Float[np.ndarray, "states actions"],
    discount: float,
) -> Float[np.ndarray, "states actions"]:
    """Action values of the best policy, by policy iteration: exact up to rounding.

    An action gives way only to one that is better by more than rounding, and no policy is tried
    twice, so it ends at any discount and at any size of the reward.

    Reference: Howard, "Dynamic programming and Markov processes" (1960).
    """
    check_range("discount", discount, 0.0, LARGEST_DISCOUNT)
    check_shape("transition", transition, (*reward.shape, len(reward)))
    state, best, tried = np.arange(len(reward)), reward.argmax(-1), set[bytes]()
    while best.tobytes() not in tried:
        tried.add(best.tobytes())
        policy = np.eye(reward.shape[1])[best]
        action_value = action_values(transition, reward, policy, discount)
        gain = action_value.max(-1) - action_value[state, best]
        is_better = gain > VALUE_ROUNDING * np.abs(action_value).max()
        best = np.where(is_better, action_value.argmax(-1), best)
    return action_value
