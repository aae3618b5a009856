import numpy as np
import pytest

from deep_curiosity.tabular.environments import random_mdp
from deep_curiosity.tabular.far_sighted import curiosity_values
from deep_curiosity.tabular.information import predictive_information
from deep_curiosity.tabular.markov import action_values, stationary_distribution
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import curious_score


def make_problem(seed=0):
    rng = np.random.default_rng(seed)
    return random_mdp(4, 3, rng), random_log_policy(4, 3, rng), rng


def test_without_discount_it_is_the_divergence_itself():
    mdp, log_policy, _ = make_problem()
    divergence = np.abs(mdp.reward)
    values = curiosity_values(mdp.transition, divergence, np.exp(log_policy), 0.0)
    np.testing.assert_allclose(values, divergence)


@pytest.mark.parametrize("curiosity_discount", [0.3, 0.9, 0.999])
def test_below_one_it_is_the_discounted_sum_up_to_a_constant(curiosity_discount):
    mdp, log_policy, _ = make_problem()
    divergence, policy = np.abs(mdp.reward), np.exp(log_policy)
    values = curiosity_values(mdp.transition, divergence, policy, curiosity_discount)
    summed = action_values(mdp.transition, divergence, policy, curiosity_discount)
    difference = summed - values
    np.testing.assert_allclose(difference, difference[0, 0], rtol=1e-9)


def test_at_one_it_is_the_gradient_of_the_average_predictive_information():
    mdp, log_policy, rng = make_problem(1)
    policy = np.exp(log_policy)
    other = np.exp(random_log_policy(4, 3, rng))

    def information(size):
        moved = (1 - size) * policy + size * other
        states = stationary_distribution(mdp.transition, moved, mdp.start)
        return predictive_information(mdp.transition, moved, states)

    states = stationary_distribution(mdp.transition, policy, mdp.start)
    score = curious_score(mdp.transition, log_policy, states, 1.0)
    slope = np.einsum("x,xa,xa->", states, other - policy, score)
    by_difference = (information(1e-5) - information(-1e-5)) / 2e-5
    assert slope == pytest.approx(by_difference, rel=1e-6)


def test_discount_above_one_is_rejected():
    mdp, log_policy, _ = make_problem()
    with pytest.raises(ValueError, match=r"`curiosity_discount` must lie in .*, got 1.1"):
        curiosity_values(mdp.transition, mdp.reward, np.exp(log_policy), 1.1)


def test_values_are_an_array_of_their_own_at_any_discount():
    mdp, log_policy, _ = make_problem()
    divergence = np.abs(mdp.reward)
    for curiosity_discount in (0.0, 0.9):
        values = curiosity_values(
            mdp.transition, divergence, np.exp(log_policy), curiosity_discount
        )
        assert not np.shares_memory(values, divergence)
