import numpy as np
import pytest

from deep_curiosity.tabular.policies import (
    boltzmann,
    epsilon_greedy,
    greedy,
    information_limited,
    random_log_policy,
    uniform_log_policy,
)

SCORE = np.array([[1.0, 2.0, 2.0], [3.0, 0.0, -1.0]])


def test_prior_times_exponential_by_hand():
    prior = np.array([0.2, 0.3, 0.5])
    weight = prior * np.exp(SCORE / 0.7)
    policy = np.exp(information_limited(np.log(prior), SCORE, 0.7))
    np.testing.assert_allclose(policy, weight / weight.sum(1, keepdims=True))


def test_uniform_prior_makes_it_boltzmann():
    uniform = uniform_log_policy(1, 3)[0]
    limited = information_limited(uniform, SCORE, 0.7)
    np.testing.assert_allclose(limited, boltzmann(SCORE, 0.7))


def test_boltzmann_maximises_return_and_entropy():
    best = np.exp(boltzmann(SCORE, 0.7))
    rng = np.random.default_rng(0)

    def objective(policy):
        return (policy * SCORE).sum() - 0.7 * (policy * np.log(policy)).sum()

    for _ in range(100):
        other = 0.9 * best + 0.1 * np.exp(random_log_policy(2, 3, rng))
        assert objective(other) < objective(best)


def test_hot_policy_is_the_prior_and_cold_policy_is_greedy():
    prior = np.array([0.2, 0.3, 0.5])
    np.testing.assert_allclose(
        np.exp(information_limited(np.log(prior), SCORE, 1e9)), np.tile(prior, (2, 1)), rtol=1e-8
    )
    uniform = uniform_log_policy(1, 3)[0]
    np.testing.assert_allclose(
        np.exp(information_limited(uniform, SCORE, 1e-3)), greedy(SCORE), atol=1e-12
    )


@pytest.mark.parametrize("temperature", [1e-300, 1e-308, 5e-324])
def test_however_cold_a_policy_is_the_limit_with_ties_by_the_prior(temperature):
    prior = np.array([0.2, 0.2, 0.6])
    policy = np.exp(information_limited(np.log(prior), SCORE, temperature))
    np.testing.assert_allclose(policy, [[0, 0.25, 0.75], [1, 0, 0]])
    np.testing.assert_array_equal(np.exp(boltzmann(SCORE, temperature)), greedy(SCORE))


@pytest.mark.parametrize("score", [SCORE, np.array([[1.0, 2.0, np.inf]])])
def test_what_the_prior_rules_out_stays_ruled_out(score):
    log_prior = np.array([np.log(0.5), np.log(0.5), -np.inf])
    policy = np.exp(information_limited(log_prior, score, 1e-3))
    np.testing.assert_allclose(policy[0], [0, 1, 0], atol=1e-12)


def test_ties_go_by_the_prior_at_any_temperature_but_equally_in_the_limit():
    prior = np.array([0.2, 0.2, 0.6])
    cold = np.exp(information_limited(np.log(prior), SCORE, 1e-3))
    np.testing.assert_allclose(cold[0], [0, 0.25, 0.75], atol=1e-12)
    np.testing.assert_array_equal(greedy(SCORE), [[0, 0.5, 0.5], [1, 0, 0]])


def test_infinite_score_takes_all_probability():
    score = np.array([[np.inf, 1.0, np.inf], [0.0, 0.0, 0.0]])
    prior = np.array([0.1, 0.6, 0.3])
    policy = np.exp(information_limited(np.log(prior), score, 0.5))
    np.testing.assert_allclose(policy, [[0.25, 0, 0.75], prior])
    np.testing.assert_array_equal(greedy(score)[0], [0.5, 0, 0.5])


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("common", [0.0, -1e3, 1e3])
def test_what_ties_depends_neither_on_the_unit_nor_on_what_scores_have_in_common(unit, common):
    scores = unit * (common + np.array([[1.0, 2.0, 2.0 + 1e-11], [0.0, 1.0, 1.0 - 1e-6]]))
    np.testing.assert_array_equal(greedy(scores), [[0, 0.5, 0.5], [0, 1, 0]])


def test_a_little_more_than_a_large_number_is_no_tie():
    np.testing.assert_array_equal(greedy(1e9 + np.array([[0.0, 1.0]])), [[0, 1]])


def test_scores_that_are_all_minus_infinity_tie():
    np.testing.assert_array_equal(greedy(np.full((1, 2), -np.inf)), [[0.5, 0.5]])
    np.testing.assert_array_equal(greedy(np.array([[-np.inf, 1.0, 2.0]])), [[0, 0, 1]])


def test_logs_survive_where_exponentials_do_not():
    log_policy = information_limited(np.log([0.5, 0.5]), np.array([[0.0, 1e6]]), 1e-3)
    np.testing.assert_allclose(log_policy, [[-1e9, 0]])


def test_epsilon_is_shared_by_all_actions():
    np.testing.assert_allclose(epsilon_greedy(SCORE, 0.3)[1], [0.8, 0.1, 0.1])


def test_bad_parameters_are_rejected():
    with pytest.raises(ValueError, match="`temperature` must be positive"):
        boltzmann(SCORE, 0.0)
    with pytest.raises(ValueError, match="`temperature` must be positive"):
        information_limited(np.zeros(3), SCORE, -1.0)
    with pytest.raises(ValueError, match="`epsilon` must lie in"):
        epsilon_greedy(SCORE, 1.1)
