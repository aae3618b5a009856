import numpy as np
import pytest

from deep_curiosity.tabular.environments import FLIP, STAY, random_mdp, reliable_unreliable
from deep_curiosity.tabular.information import (
    action_information,
    curiosity,
    entropy,
    kl_divergence,
    log_action_marginal,
    log_next_state_marginal,
    mutual_information,
    predictive_information,
    safe_log,
    state_predictive_information,
    to_bits,
    to_nats,
    weighted_sum,
)
from deep_curiosity.tabular.policies import random_log_policy


def test_bits_and_nats_are_inverse():
    assert to_bits(np.log(8)) == pytest.approx(3)
    assert to_nats(to_bits(0.7)) == pytest.approx(0.7)


def test_entropy_of_known_distributions():
    probability = np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1 / 3, 1 / 3, 1 / 3]])
    np.testing.assert_allclose(entropy(probability), np.log([1, 2, 3]), atol=1e-15)


def test_divergence_by_hand_zero_and_infinite():
    probability = np.array([0.5, 0.5, 0.0])
    by_hand = 0.5 * np.log(0.5 / 0.25) + 0.5 * np.log(0.5 / 0.75)
    reference = safe_log(np.array([0.25, 0.75, 0.0]))
    assert kl_divergence(probability, reference) == pytest.approx(by_hand)
    assert kl_divergence(probability, safe_log(probability)) == pytest.approx(0)
    assert kl_divergence(probability, safe_log(np.array([1.0, 0.0, 0.0]))) == np.inf


def test_binary_symmetric_channel_carries_one_bit_less_the_noise():
    channel = np.array([[0.9, 0.1], [0.1, 0.9]])
    noise = -0.9 * np.log2(0.9) - 0.1 * np.log2(0.1)
    information = mutual_information(np.array([0.5, 0.5]), channel)
    assert to_bits(information) == pytest.approx(1 - noise)


def test_mutual_information_is_symmetric():
    rng = np.random.default_rng(0)
    joint = rng.dirichlet(np.ones(12)).reshape(3, 4)
    row, column = joint.sum(1), joint.sum(0)
    forward = mutual_information(row, joint / row[:, None])
    assert mutual_information(column, (joint / row.sum() / column).T) == pytest.approx(forward)


def test_mutual_information_is_the_sum_of_entropies_less_the_joint():
    joint = np.random.default_rng(1).dirichlet(np.ones(12)).reshape(3, 4)
    by_entropies = entropy(joint.sum(1)) + entropy(joint.sum(0)) - entropy(joint.ravel())
    channel = joint / joint.sum(1, keepdims=True)
    assert mutual_information(joint.sum(1), channel) == pytest.approx(by_entropies)


def test_constant_policy_tells_nothing_about_the_state():
    states = np.array([0.3, 0.7])
    assert action_information(np.tile([0.2, 0.8], (2, 1)), states) == pytest.approx(0)
    assert to_bits(action_information(np.eye(2), np.full(2, 0.5))) == pytest.approx(1)


def test_predictive_information_is_the_mean_divergence():
    rng = np.random.default_rng(2)
    mdp, log_policy = random_mdp(4, 3, rng), random_log_policy(4, 3, rng)
    states = rng.dirichlet(np.ones(4))
    log_marginal = log_next_state_marginal(mdp.transition, log_policy, states)
    divergence = curiosity(mdp.transition, log_marginal)
    mean = np.einsum("x,xa,xa->", states, np.exp(log_policy), divergence)
    whole = predictive_information(mdp.transition, np.exp(log_policy), states)
    assert whole == pytest.approx(mean, abs=1e-14)


def test_state_alone_predicts_less_than_state_and_action():
    rng = np.random.default_rng(3)
    mdp, policy = random_mdp(4, 3, rng), np.exp(random_log_policy(4, 3, rng))
    states = rng.dirichlet(np.ones(4))
    alone = state_predictive_information(mdp.transition, policy, states)
    assert 0 < alone < predictive_information(mdp.transition, policy, states)


def test_marginals_are_the_sums_of_the_paper():
    rng = np.random.default_rng(4)
    mdp, log_policy = random_mdp(3, 2, rng), random_log_policy(3, 2, rng)
    states, policy = rng.dirichlet(np.ones(3)), np.exp(log_policy)
    by_hand = sum(
        states[x] * policy[x, a] * mdp.transition[x, a] for x in range(3) for a in range(2)
    )
    log_marginal = log_next_state_marginal(mdp.transition, log_policy, states)
    np.testing.assert_allclose(np.exp(log_marginal), by_hand)
    np.testing.assert_allclose(np.exp(log_action_marginal(log_policy, states)), states @ policy)


def test_divergence_in_the_second_illustration_by_hand():
    marginal = np.array([0.75, 0.25])
    divergence = curiosity(reliable_unreliable().transition, np.log(marginal))
    assert divergence[0, STAY] == pytest.approx(np.log(4 / 3))
    assert divergence[0, FLIP] == pytest.approx(np.log(4))
    np.testing.assert_allclose(divergence[1], 0.5 * np.log(4 / 3))


def test_divergence_stays_finite_where_probabilities_underflow():
    log_policy = np.array([[0.0, -2000.0], [0.0, -2000.0]])
    transition = np.stack([np.eye(2), np.eye(2)[::-1]], axis=1)  # stay, flip
    log_marginal = log_next_state_marginal(transition, log_policy, np.array([1.0, 0.0]))
    divergence = curiosity(transition, log_marginal)
    np.testing.assert_allclose(divergence, [[0, 2000], [2000, 0]])


HALVES, WRONG, NEGATIVE = np.full((2, 2), 0.5), np.array([0.2, 0.2]), np.array([2.0, -1.0])


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (entropy, (NEGATIVE,), "`probability` must not be negative, got -1.0"),
        (kl_divergence, (WRONG, np.log([0.5, 0.5])), "`probability` must sum to 1.*got 0.4"),
        (mutual_information, (NEGATIVE, HALVES), "`distribution` must not be negative"),
        (mutual_information, (HALVES[0], 2 * HALVES), "`channel` must sum to 1.*got 2.0"),
        (safe_log, (NEGATIVE,), "`weight` must not be negative, got -1.0"),
        (weighted_sum, (NEGATIVE, np.ones(2)), "`weight` must not be negative, got -1.0"),
    ],
)
def test_what_is_no_distribution_is_refused(function, arguments, message):
    with pytest.raises(ValueError, match=message):
        function(*arguments)


def test_weights_need_not_sum_to_one():
    assert safe_log(np.array([0.0, np.e])).tolist() == [-np.inf, 1]
    assert weighted_sum(np.array([2.0, 0.0]), np.array([3.0, -np.inf])) == 6
