import numpy as np
import pytest

from deep_curiosity.tabular.agent import run
from deep_curiosity.tabular.environments import (
    FLIP,
    LEFT,
    RIGHT,
    STAY,
    chain,
    clever_random,
    random_mdp,
    reliable_unreliable,
)
from deep_curiosity.tabular.estimators import Experience
from deep_curiosity.tabular.information import (
    predictive_information,
    state_predictive_information,
    to_bits,
)
from deep_curiosity.tabular.markov import (
    action_values,
    optimal_action_values,
    stationary_distribution,
)
from deep_curiosity.tabular.neighbours import (
    EpsilonGreedy,
    PredictionErrorCuriosity,
    RMax,
    dynamic_policy_programming,
    information_to_go,
    predictive_states,
)
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import solve_stationary


def run_learner(learner, mdp, num_steps, seed=0):
    return run(learner, mdp, num_steps, np.random.default_rng(seed))


def assert_optimal(mdp, policy, rtol=1e-3):
    value = action_values(mdp.transition, mdp.reward, policy, mdp.discount)
    best = optimal_action_values(mdp.transition, mdp.reward, mdp.discount)
    np.testing.assert_allclose((policy * value).sum(1), best.max(1), rtol=rtol)


def test_epsilon_greedy_takes_the_bait_at_the_near_end():
    mdp = chain(8, bait=0.05)
    learner = EpsilonGreedy(8, 2, discount=mdp.discount)
    run_learner(learner, mdp, 2_000)
    np.testing.assert_allclose(learner.policy[0], [0.95, 0.05])


def test_optimism_finds_the_far_end():
    mdp = chain(8, bait=0.05)
    learner = RMax(8, 2, discount=mdp.discount, largest_reward=1.0)
    assert learner.policy[0] == pytest.approx([0.5, 0.5])
    run_learner(learner, mdp, 1_500)
    assert_optimal(mdp, learner.policy)
    assert learner.policy[0, RIGHT] == 1 and learner.policy[0, LEFT] == 0


def test_prediction_error_leaves_the_reliable_state_where_curiosity_keeps_to_it():
    mdp = reliable_unreliable()
    learner = PredictionErrorCuriosity(2, 2, discount=0.95)
    run_learner(learner, mdp, 3_000)
    assert learner.policy[0, FLIP] == pytest.approx(0.95)
    curious = solve_stationary(mdp, temperature=0.5, curiosity_discount=0.95).policy
    assert curious[0, STAY] > 0.7


def test_surprise_wears_off_where_transitions_are_certain():
    mdp = reliable_unreliable()
    learner = PredictionErrorCuriosity(2, 2, discount=0.0)
    run_learner(learner, mdp, 3_000)
    assert learner.values.action_value[0].max() < 0.1
    assert learner.values.action_value[1].max() == pytest.approx(np.log(2), abs=0.1)


def test_information_to_go_earns_the_most_when_reward_weighs_all():
    mdp = random_mdp(5, 3, np.random.default_rng(0))
    solution = information_to_go(mdp, mdp.start, reward_weight=1e4)
    assert solution.converged
    assert_optimal(mdp, solution.policy)


def test_information_to_go_shuns_the_information_that_curiosity_seeks():
    mdp = random_mdp(5, 3, np.random.default_rng(1))
    averse = information_to_go(mdp, mdp.start, reward_weight=0.0).policy
    curious = solve_stationary(mdp, temperature=0.5, tolerance=1e-6).policy
    bits = [
        predictive_information(
            mdp.transition,
            policy,
            stationary_distribution(mdp.transition, policy, mdp.start),
        )
        for policy in (averse, np.full((5, 3), 1 / 3), curious)
    ]
    assert bits[0] < bits[1] < bits[2]


@pytest.mark.parametrize("temperature", [0.1, 2.0])
def test_dynamic_policy_programming_is_optimal_at_any_temperature(temperature):
    mdp = random_mdp(5, 3, np.random.default_rng(2))
    solution = dynamic_policy_programming(mdp, temperature=temperature)
    assert solution.converged
    assert_optimal(mdp, solution.policy)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_predictive_states_settle_on_one_action_where_clever_random_keeps_two(seed):
    mdp = clever_random(11)
    start = random_log_policy(2, 11, np.random.default_rng(seed))
    solution = predictive_states(mdp, start, curiosity_discount=0.9)
    assert solution.policy.max(1) == pytest.approx(1, abs=1e-6)
    assert to_bits(solution.objective[-1]) == pytest.approx(1, abs=1e-3)
    curious = solve_stationary(mdp, temperature=0.3, tolerance=1e-6).policy
    states = stationary_distribution(mdp.transition, curious, mdp.start)
    assert state_predictive_information(mdp.transition, curious, states) < 1e-4
    assert predictive_information(mdp.transition, curious, states) == pytest.approx(
        np.log(2), abs=1e-4
    )


def test_bad_parameters_are_rejected():
    mdp = reliable_unreliable()
    with pytest.raises(ValueError, match="`epsilon` must lie in"):
        EpsilonGreedy(2, 2, discount=0.9, epsilon=-0.1)
    with pytest.raises(ValueError, match="`num_known` must be at least 1"):
        RMax(2, 2, discount=0.9, largest_reward=1.0, num_known=0)
    with pytest.raises(ValueError, match="`temperature` must be positive"):
        dynamic_policy_programming(mdp, temperature=0.0)
    with pytest.raises(ValueError, match=r"`state_distribution` must be positive.*got 0.0"):
        information_to_go(mdp, np.array([1.0, 0.0]), reward_weight=1.0)


def test_too_few_updates_are_told_from_enough():
    mdp = random_mdp(5, 3, np.random.default_rng(2))
    for num_iterations, enough in ((1, False), (10, False), (1_000, True)):
        solution = information_to_go(
            mdp, mdp.start, reward_weight=1.0, num_iterations=num_iterations
        )
        other = dynamic_policy_programming(mdp, temperature=0.1, num_iterations=num_iterations)
        assert solution.converged is other.converged is enough
        assert len(solution.objective) == len(other.objective) == num_iterations + 1


def test_objective_of_dynamic_policy_programming_ends_at_the_best_return():
    mdp = random_mdp(5, 3, np.random.default_rng(2))
    solution = dynamic_policy_programming(mdp, temperature=0.1)
    best = optimal_action_values(mdp.transition, mdp.reward, mdp.discount)
    assert solution.objective[-1] == pytest.approx(mdp.start @ best.max(1))


@pytest.mark.parametrize("experience", [Experience(7, 0, 0.0, 0), Experience(0, 0, 0.0, 7)])
def test_no_learner_learns_from_states_that_there_are_not(experience):
    for learner in (
        PredictionErrorCuriosity(3, 2, discount=0.9),
        EpsilonGreedy(3, 2, discount=0.9),
        RMax(3, 2, discount=0.9, largest_reward=1.0),
    ):
        with pytest.raises(ValueError, match=r"state` must lie in \[0, 2\], got 7"):
            learner.observe(experience)
        with pytest.raises(TypeError, match="`experience` must be an Experience"):
            learner.observe((0, 0, 0.0, 0))
