import numpy as np
import pytest

from deep_curiosity.tabular.far_sighted import curiosity_values
from deep_curiosity.tabular.information import predictive_information
from deep_curiosity.tabular.markov import action_values, stationary_distribution
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import curious_score
from deep_curiosity.tabular.worlds import random_mdp


def draw(seed=0):
    rng = np.random.default_rng(seed)
    return random_mdp(4, 3, rng), random_log_policy(4, 3, rng), rng


def test_without_discount_it_is_the_divergence_itself():
    world, log_policy, _ = draw()
    divergence = np.abs(world.reward)
    values = curiosity_values(world.transition, divergence, np.exp(log_policy), 0.0)
    np.testing.assert_allclose(values, divergence)


@pytest.mark.parametrize("curiosity_discount", [0.3, 0.9, 0.999])
def test_below_one_it_is_the_discounted_sum_up_to_a_constant(curiosity_discount):
    world, log_policy, _ = draw()
    divergence, policy = np.abs(world.reward), np.exp(log_policy)
    values = curiosity_values(world.transition, divergence, policy, curiosity_discount)
    summed = action_values(world.transition, divergence, policy, curiosity_discount)
    difference = summed - values
    np.testing.assert_allclose(difference, difference[0, 0], rtol=1e-9)


def test_at_one_it_is_the_gradient_of_the_average_predictive_information():
    world, log_policy, rng = draw(1)
    policy = np.exp(log_policy)
    other = np.exp(random_log_policy(4, 3, rng))

    def information(size):
        moved = (1 - size) * policy + size * other
        states = stationary_distribution(world.transition, moved, world.start)
        return predictive_information(world.transition, moved, states)

    states = stationary_distribution(world.transition, policy, world.start)
    score = curious_score(world.transition, log_policy, states, 1.0)
    slope = np.einsum("x,xa,xa->", states, other - policy, score)
    by_difference = (information(1e-5) - information(-1e-5)) / 2e-5
    assert slope == pytest.approx(by_difference, rel=1e-6)


def test_discount_above_one_is_turned_away():
    world, log_policy, _ = draw()
    with pytest.raises(ValueError, match=r"`curiosity_discount` must lie in .*, got 1.1"):
        curiosity_values(world.transition, world.reward, np.exp(log_policy), 1.1)
