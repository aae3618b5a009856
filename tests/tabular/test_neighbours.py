import numpy as np
import pytest

from deep_curiosity.tabular.agent import run
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
from deep_curiosity.tabular.worlds import (
    FLIP,
    LEFT,
    RIGHT,
    STAY,
    chain,
    clever_random,
    random_mdp,
    reliable_unreliable,
)


def live(learner, world, num_steps, seed=0):
    return run(learner, world, num_steps, np.random.default_rng(seed))


def assert_optimal(world, policy, rtol=1e-3):
    value = action_values(world.transition, world.reward, policy, world.discount)
    best = optimal_action_values(world.transition, world.reward, world.discount)
    np.testing.assert_allclose((policy * value).sum(1), best.max(1), rtol=rtol)


def test_epsilon_greedy_takes_the_bait_at_the_near_end():
    world = chain(8, bait=0.05)
    learner = EpsilonGreedy(8, 2, discount=world.discount)
    live(learner, world, 2_000)
    np.testing.assert_allclose(learner.policy[0], [0.95, 0.05])


def test_optimism_finds_the_far_end():
    world = chain(8, bait=0.05)
    learner = RMax(8, 2, discount=world.discount, largest_reward=1.0)
    assert learner.policy[0] == pytest.approx([0.5, 0.5])
    live(learner, world, 1_500)
    assert_optimal(world, learner.policy)
    assert learner.policy[0, RIGHT] == 1 and learner.policy[0, LEFT] == 0


def test_prediction_error_leaves_the_reliable_state_where_curiosity_keeps_to_it():
    world = reliable_unreliable()
    learner = PredictionErrorCuriosity(2, 2, discount=0.95)
    live(learner, world, 3_000)
    assert learner.policy[0, FLIP] == pytest.approx(0.95)
    curious = solve_stationary(world, temperature=0.5, curiosity_discount=0.95).policy
    assert curious[0, STAY] > 0.7


def test_surprise_wears_off_where_the_world_is_certain():
    world = reliable_unreliable()
    learner = PredictionErrorCuriosity(2, 2, discount=0.0)
    live(learner, world, 3_000)
    assert learner.values.action_value[0].max() < 0.1
    assert learner.values.action_value[1].max() == pytest.approx(np.log(2), abs=0.1)


def test_information_to_go_earns_the_most_when_reward_weighs_all():
    world = random_mdp(5, 3, np.random.default_rng(0))
    log_policy = information_to_go(world, world.start, reward_weight=1e4)
    assert_optimal(world, np.exp(log_policy))


def test_information_to_go_shuns_the_information_that_curiosity_seeks():
    world = random_mdp(5, 3, np.random.default_rng(1))
    shy = np.exp(information_to_go(world, world.start, reward_weight=0.0))
    curious = solve_stationary(world, temperature=0.5, tolerance=1e-6).policy
    bits = [
        predictive_information(
            world.transition,
            policy,
            stationary_distribution(world.transition, policy, world.start),
        )
        for policy in (shy, np.full((5, 3), 1 / 3), curious)
    ]
    assert bits[0] < bits[1] < bits[2]


@pytest.mark.parametrize("temperature", [0.1, 2.0])
def test_dynamic_policy_programming_is_optimal_at_any_temperature(temperature):
    world = random_mdp(5, 3, np.random.default_rng(2))
    log_policy = dynamic_policy_programming(world, temperature=temperature)
    assert_optimal(world, np.exp(log_policy))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_predictive_states_settle_on_one_action_where_clever_random_keeps_two(seed):
    world = clever_random(11)
    start = random_log_policy(2, 11, np.random.default_rng(seed))
    solution = predictive_states(world, start, curiosity_discount=0.9)
    assert solution.policy.max(1) == pytest.approx(1, abs=1e-6)
    assert to_bits(solution.objective[-1]) == pytest.approx(1, abs=1e-3)
    curious = solve_stationary(world, temperature=0.3, tolerance=1e-6).policy
    states = stationary_distribution(world.transition, curious, world.start)
    assert state_predictive_information(world.transition, curious, states) < 1e-4
    assert predictive_information(world.transition, curious, states) == pytest.approx(
        np.log(2), abs=1e-4
    )


def test_bad_parameters_are_turned_away():
    world = reliable_unreliable()
    with pytest.raises(ValueError, match="`epsilon` must lie in"):
        EpsilonGreedy(2, 2, discount=0.9, epsilon=-0.1)
    with pytest.raises(ValueError, match="`num_known` must be at least 1"):
        RMax(2, 2, discount=0.9, largest_reward=1.0, num_known=0)
    with pytest.raises(ValueError, match="`temperature` must be positive"):
        dynamic_policy_programming(world, temperature=0.0)
    with pytest.raises(ValueError, match=r"`state_distribution` must be positive.*got 0.0"):
        information_to_go(world, np.array([1.0, 0.0]), reward_weight=1.0)
