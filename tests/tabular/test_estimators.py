import numpy as np
import pytest

from deep_curiosity.tabular.agent import FixedPolicy, run
from deep_curiosity.tabular.environments import random_mdp
from deep_curiosity.tabular.estimators import (
    CountedModel,
    ExactModel,
    ExactValues,
    Experience,
    PropagatedStates,
    QLearning,
    Sarsa,
    VisitedStates,
)
from deep_curiosity.tabular.information import kl_divergence, safe_log
from deep_curiosity.tabular.markov import (
    action_values,
    optimal_action_values,
    stationary_distribution,
)

MDP = random_mdp(4, 2, np.random.default_rng(0), discount=0.5)
POLICY = np.full((4, 2), 0.5)
STEP = Experience(state=1, action=0, reward=2.0, next_state=3)


def run_policy(num_steps, seed=0):
    return run(FixedPolicy(POLICY), MDP, num_steps, np.random.default_rng(seed))


def test_exact_model_is_the_mdp():
    model = ExactModel(MDP)
    model.observe(STEP)
    assert model.transition is MDP.transition and model.reward is MDP.reward


def test_counted_model_by_hand():
    model = CountedModel(4, 2, pseudo_count=0.5)
    np.testing.assert_allclose(model.transition, 0.25)
    model.observe(STEP)
    model.observe(STEP)
    np.testing.assert_allclose(model.transition[1, 0], [0.125, 0.125, 0.125, 0.625])
    assert model.reward[1, 0] == pytest.approx(2 * 2.0 / 4)
    np.testing.assert_allclose(model.transition[0], 0.25)


def test_visited_states_by_hand():
    states = VisitedStates(4)
    np.testing.assert_allclose(states.distribution, 0.25)
    states.observe(STEP, MDP.transition, POLICY)
    np.testing.assert_allclose(states.distribution, [0.125, 0.625, 0.125, 0.125])


def test_propagated_states_follow_the_policy_and_not_the_experience():
    states = PropagatedStates(MDP.start)
    for _ in range(100):
        states.observe(STEP, MDP.transition, POLICY)
    limit = stationary_distribution(MDP.transition, POLICY, MDP.start)
    np.testing.assert_allclose(states.distribution, limit, atol=1e-12)


def test_exact_values_solve_the_model():
    values = ExactValues(0.5)
    values.observe(STEP)
    exact = action_values(MDP.transition, MDP.reward, POLICY, 0.5)
    np.testing.assert_array_equal(values.estimate(ExactModel(MDP), POLICY), exact)


def test_sarsa_learns_a_step_when_the_next_action_is_known():
    values = Sarsa(4, 2, 0.5)
    values.action_value[3, 1] = 8.0
    values.observe(STEP)
    assert values.action_value[1, 0] == 0
    values.observe(Experience(state=3, action=1, reward=0.0, next_state=0))
    assert values.action_value[1, 0] == 2 + 0.5 * 8


def test_q_learning_learns_at_once_from_the_best_next_action():
    values = QLearning(4, 2, 0.5)
    values.action_value[3] = [8.0, 4.0]
    values.observe(STEP)
    assert values.action_value[1, 0] == 2 + 0.5 * 8


def test_second_visit_counts_less_than_the_first():
    values = QLearning(4, 2, 0.0)
    values.observe(STEP)
    values.observe(STEP._replace(reward=0.0))
    assert values.action_value[1, 0] == pytest.approx(2 * (1 - 2**-0.7))


def test_sarsa_approaches_the_policy_and_q_learning_the_best():
    sarsa, q_learning = Sarsa(4, 2, 0.5), QLearning(4, 2, 0.5)
    for experience in run_policy(10_000):
        sarsa.observe(experience)
        q_learning.observe(experience)
    of_policy = action_values(MDP.transition, MDP.reward, POLICY, 0.5)
    of_best = optimal_action_values(MDP.transition, MDP.reward, 0.5)
    difference = np.abs(of_best - of_policy).max()
    assert np.abs(sarsa.action_value - of_policy).max() < 0.15 * difference
    assert np.abs(q_learning.action_value - of_best).max() < 0.15 * difference


def test_errors_of_model_and_visits_fall_with_the_root_of_the_samples():
    """Two decades of samples: a slope of -1/2 in the root of the divergence, within a quarter."""
    sizes = [100, 1_000, 10_000]
    exact = stationary_distribution(MDP.transition, POLICY, MDP.start)
    model_error, state_error = np.zeros((2, 3, 3))
    for seed in range(3):
        model, states, history = CountedModel(4, 2), VisitedStates(4), run_policy(sizes[-1], seed)
        for step, experience in enumerate(history, start=1):
            model.observe(experience)
            states.visits[experience.state] += 1
            if step in sizes:
                divergence = kl_divergence(MDP.transition, safe_log(model.transition))
                model_error[seed, sizes.index(step)] = divergence.mean()
                distance = kl_divergence(exact, safe_log(states.distribution))
                state_error[seed, sizes.index(step)] = distance
    for error in (model_error, state_error):
        slope = np.polyfit(np.log(sizes), 0.5 * np.log(error.mean(0)), 1)[0]
        assert slope == pytest.approx(-0.5, abs=0.125)


def test_bad_parameters_are_rejected():
    with pytest.raises(ValueError, match="`pseudo_count` must be positive"):
        CountedModel(2, 2, pseudo_count=0.0)
    with pytest.raises(ValueError, match="`num_states` must be at least 1"):
        VisitedStates(0)
    with pytest.raises(ValueError, match="`start` must sum to 1"):
        PropagatedStates(np.array([0.5, 0.6]))
    with pytest.raises(ValueError, match="`discount` must lie in"):
        Sarsa(2, 2, 1.0)


def test_estimates_do_not_change_with_what_was_given_or_what_is_done_with_them():
    start = np.array([0.25, 0.75])
    states, values = PropagatedStates(start), QLearning(4, 2, 0.5)
    start[:] = 7
    np.testing.assert_array_equal(states.distribution, [0.25, 0.75])
    values.estimate(ExactModel(MDP), POLICY)[:] = 7
    assert not values.action_value.any()
    before = values.estimate(ExactModel(MDP), POLICY)
    values.observe(STEP)
    assert not before.any()
