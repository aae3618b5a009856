import itertools

import numpy as np
import pytest

from deep_curiosity.tabular.environments import STAY, grid_world, random_mdp, reliable_unreliable
from deep_curiosity.tabular.markov import (
    action_values,
    expected_return,
    limiting_matrix,
    optimal_action_values,
    propagate,
    state_chain,
    stationary_distribution,
)
from deep_curiosity.tabular.policies import random_log_policy


def sample_mdp_and_policy(seed=0):
    rng = np.random.default_rng(seed)
    return random_mdp(4, 3, rng), np.exp(random_log_policy(4, 3, rng))


def test_stationary_distribution_by_hand():
    mdp = reliable_unreliable()
    policy = np.array([[0.75, 0.25], [0.5, 0.5]])
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    np.testing.assert_allclose(states, [2 / 3, 1 / 3])


def test_stationary_distribution_is_the_leading_eigenvector():
    mdp, policy = sample_mdp_and_policy()
    values, vectors = np.linalg.eig(state_chain(mdp.transition, policy).T)
    leading = vectors[:, np.argmax(values.real)].real
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    np.testing.assert_allclose(states, leading / leading.sum(), atol=1e-14)


def test_stationary_distribution_is_where_propagation_leads():
    mdp, policy = sample_mdp_and_policy()
    states = mdp.start
    for _ in range(200):
        states = propagate(states, mdp.transition, policy)
    limit = stationary_distribution(mdp.transition, policy, mdp.start)
    np.testing.assert_allclose(states, limit, atol=1e-14)


def test_period_and_closed_classes_need_no_special_case():
    flip_pair_and_trap = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    limit = limiting_matrix(flip_pair_and_trap)
    np.testing.assert_allclose(limit, [[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0, 1]], atol=1e-14)


def test_start_decides_between_closed_classes():
    mdp = reliable_unreliable()
    stays = np.tile(np.eye(2)[STAY], (2, 1))
    holds = np.stack([np.eye(2)] * 2, axis=1)
    start = np.array([0.3, 0.7])
    np.testing.assert_allclose(stationary_distribution(holds, stays, start), start)
    limit = stationary_distribution(mdp.transition, stays, start)
    np.testing.assert_allclose(limit, [1, 0], atol=1e-12)


def test_slow_chain_reaches_its_own_limit():
    leak = 1e-9
    slow = np.array([[1 - leak, leak], [3 * leak, 1 - 3 * leak]])
    np.testing.assert_allclose(limiting_matrix(slow)[0], [0.75, 0.25], atol=1e-6)


def test_action_values_are_the_discounted_sum_of_rewards():
    mdp, policy = sample_mdp_and_policy()
    chain, summed = state_chain(mdp.transition, policy), np.zeros(4)
    mean_reward = np.einsum("xa,xa->x", policy, mdp.reward)
    for step in range(400):
        summed += 0.9**step * np.linalg.matrix_power(chain, step) @ mean_reward
    by_sum = mdp.reward + 0.9 * mdp.transition @ summed
    solved = action_values(mdp.transition, mdp.reward, policy, 0.9)
    np.testing.assert_allclose(solved, by_sum, atol=1e-12)


def test_without_discount_values_are_rewards():
    mdp, policy = sample_mdp_and_policy()
    solved = action_values(mdp.transition, mdp.reward, policy, 0.0)
    np.testing.assert_array_equal(solved, mdp.reward)


def test_expected_return_weighs_states_and_actions():
    value = expected_return(np.array([0.25, 0.75]), np.eye(2), np.array([[4.0, 9.0], [9.0, 8.0]]))
    assert value == pytest.approx(0.25 * 4 + 0.75 * 8)


def test_policy_iteration_finds_the_best_deterministic_policy():
    mdp = random_mdp(3, 2, np.random.default_rng(5))
    policies = (np.eye(2)[list(choice)] for choice in itertools.product((0, 1), repeat=3))
    best = np.max(
        [action_values(mdp.transition, mdp.reward, policy, 0.9) for policy in policies], axis=0
    )
    optimal = optimal_action_values(mdp.transition, mdp.reward, 0.9)
    np.testing.assert_allclose(optimal, best, atol=1e-9)


@pytest.mark.parametrize("discount", [0.0, 0.9, 0.99999, 1 - 1e-9])
@pytest.mark.parametrize("size", [1.0, 1e6, 1e-6])
def test_best_values_are_those_of_the_best_next_action_to_rounding(discount, size):
    mdp = grid_world()
    values = optimal_action_values(mdp.transition, size * mdp.reward, discount)
    backup = size * mdp.reward + discount * mdp.transition @ values.max(-1)
    np.testing.assert_allclose(values, backup, rtol=1e-14 / (1 - discount), atol=1e-300)


def test_equal_actions_do_not_keep_the_best_values_from_being_found():
    noise = np.random.default_rng(0).dirichlet(np.ones(6), size=6)
    transition = np.repeat(noise[:, None], 4, axis=1)
    reward = np.repeat(np.random.default_rng(1).normal(size=(6, 1)), 4, axis=1)
    values = optimal_action_values(transition, reward, 1 - 1e-7)
    assert np.ptp(values, axis=1).max() <= 1e-13 * np.abs(values).max()


def test_discount_of_one_is_rejected():
    mdp, policy = sample_mdp_and_policy()
    with pytest.raises(ValueError, match="`discount` must lie in"):
        action_values(mdp.transition, mdp.reward, policy, 1.0)
