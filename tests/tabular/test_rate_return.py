import numpy as np
import pytest

from deep_curiosity.tabular.policies import greedy, random_log_policy
from deep_curiosity.tabular.rate_return import (
    largest_return,
    rate_return_curve,
    solve_rate_limited,
    zero_rate_point,
)


def sample_problem(seed=0, num_states=5, num_actions=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(num_states, num_actions)), rng.dirichlet(np.ones(num_states))


def blahut_arimoto(distortion, source, slope, num_iterations=20_000):
    """Cover & Thomas, section 10.8, written for a distortion and one row for each symbol."""
    output = np.full(distortion.shape[1], 1 / distortion.shape[1])
    for _ in range(num_iterations):
        test_channel = output * np.exp(-slope * distortion)
        test_channel /= test_channel.sum(axis=1, keepdims=True)
        output = source @ test_channel
    return test_channel, output


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("temperature", [0.2, 0.7])
def test_policy_is_that_of_blahut_and_arimoto(seed, temperature):
    action_value, states = sample_problem(seed)
    policy = solve_rate_limited(action_value, states, temperature).policy
    channel, output = blahut_arimoto(-action_value, states, 1 / temperature)
    np.testing.assert_allclose(policy, channel, atol=1e-8)
    np.testing.assert_allclose(states @ policy, output, atol=1e-8)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_other_action_marginal_is_better(seed):
    """Kuhn-Tucker: sum_x p(x) exp(Q / lambda) / Z(x) is one if an action is used, else less."""
    action_value, states = sample_problem(seed)
    policy = solve_rate_limited(action_value, states, 0.5).policy
    weight = np.exp(action_value / 0.5)
    worth = states @ (weight / (weight @ (states @ policy))[:, None])
    assert worth.max() <= 1 + 1e-7
    np.testing.assert_allclose(worth[states @ policy > 1e-6], 1, atol=1e-7)


def test_objective_only_rises_and_no_other_policy_beats_its_end():
    action_value, states = sample_problem(3)
    solution = solve_rate_limited(action_value, states, 0.4)
    assert solution.converged and (np.diff(solution.objective) > -1e-13).all()
    rng = np.random.default_rng(4)
    for _ in range(100):
        policy = 0.9 * solution.policy + 0.1 * np.exp(random_log_policy(5, 4, rng))
        rate = np.einsum("x,xa,xa->", states, policy, np.log(policy / (states @ policy)))
        value = np.einsum("x,xa,xa->", states, policy, action_value)
        assert value - 0.4 * rate < solution.objective[-1]


def test_curve_rises_is_concave_and_its_slope_is_the_temperature():
    action_value, states = sample_problem(5)
    temperatures = np.geomspace(0.3, 0.1, 41)
    curve = rate_return_curve(action_value, states, temperatures)
    rate, value = np.array([(point.rate, point.value) for point in curve]).T
    slope = np.diff(value) / np.diff(rate)
    assert (np.diff(rate) > 0).all() and (np.diff(value) > 0).all()
    assert (np.diff(slope) < 0).all()
    assert (slope < temperatures[:-1]).all() and (slope > temperatures[1:]).all()


def test_cold_policy_is_greedy():
    action_value, states = sample_problem(6)
    policy = solve_rate_limited(action_value, states, 1e-3).policy
    np.testing.assert_allclose(policy, greedy(action_value), atol=1e-9)


def test_cold_ties_go_to_the_action_that_other_states_use():
    action_value = np.array([[1.0, 0.0], [1.0, 1.0]])
    policy = solve_rate_limited(action_value, np.array([0.5, 0.5]), 0.01).policy
    np.testing.assert_allclose(policy, [[1, 0], [1, 0]], atol=1e-6)
    np.testing.assert_array_equal(greedy(action_value)[1], [0.5, 0.5])


@pytest.mark.parametrize("rate", [pytest.param(0.1, marks=pytest.mark.slow), 0.3])
def test_dual_meets_its_rate_and_no_policy_of_that_rate_returns_more(rate):
    action_value, states = sample_problem(4)
    point = largest_return(action_value, states, rate)
    assert point.rate <= rate and point.rate == pytest.approx(rate, abs=2e-6)
    for other in rate_return_curve(action_value, states, [0.05, 0.2, 1.0]):
        tangent = point.value + point.temperature * (other.rate - point.rate)
        assert other.value <= tangent + 1e-9


def test_dual_at_rate_zero_is_its_best_constant_action():
    action_value, states = sample_problem(8)
    point = largest_return(action_value, states, 0.0)
    assert point.rate == pytest.approx(0)
    assert point.value == pytest.approx((states @ action_value).max())


@pytest.mark.parametrize(("size", "offset"), [(1.0, 0.0), (1e-10, 0.0), (1.0, 1e9), (1e10, 0.0)])
def test_the_best_constant_action_is_so_in_any_unit_and_beside_any_constant(size, offset):
    action_value = size * np.array([[0.0, 1.0], [0.0, 1.0]]) + offset
    point = zero_rate_point(action_value, np.array([0.5, 0.5]))
    np.testing.assert_array_equal(point.policy, [[0, 1], [0, 1]])
    assert point.value == size + offset


def test_a_point_says_whether_it_converged():
    action_value, states = sample_problem(5)
    cold, hot = rate_return_curve(action_value, states, [0.2, 1e9 * np.ptp(action_value)])
    assert cold.converged and not hot.converged
    assert zero_rate_point(action_value, states).converged


@pytest.mark.slow
def test_dual_at_a_tiny_rate_returns_no_less_than_its_best_constant_action():
    action_value, states = sample_problem(8)
    point = largest_return(action_value, states, 1e-7)
    assert point.value >= (states @ action_value).max()


def test_dual_at_a_free_rate_is_greedy():
    action_value, states = sample_problem(9)
    point = largest_return(action_value, states, 10.0)
    assert point.value == pytest.approx(states @ action_value.max(1))


@pytest.mark.parametrize("offset", [1e4, 1e6])
@pytest.mark.parametrize("rate", [0.5, np.inf])
def test_dual_is_about_what_actions_differ_in_and_not_about_how_good_a_state_is(offset, rate):
    states = np.full(4, 0.25)
    values = offset * np.array([0.0, 0.0, 0.0, 1.0])
    plain = largest_return(np.eye(4), states, rate)
    point = largest_return(np.eye(4) + values[:, None], states, rate)
    assert point.rate == pytest.approx(plain.rate, abs=1e-5)
    assert point.value - values.mean() == pytest.approx(plain.value, abs=1e-5)


def test_dual_leaves_states_that_are_never_met_aside():
    action_value = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 1e7]])
    point = largest_return(action_value, np.array([0.5, 0.5, 0.0]), np.inf)
    assert point.value == 1 and point.rate == pytest.approx(np.log(2))


def test_dual_at_a_free_rate_is_greedy_however_little_the_best_action_is_ahead():
    action_value = np.array([[0.0, 1.0], [5e-4, 0.0], [1.0, 0.0]])
    point = largest_return(action_value, np.full(3, 1 / 3), np.inf)
    assert point.value == pytest.approx(2.0005 / 3, rel=1e-12)
    assert point.temperature == 0 and point.converged


def test_dual_at_a_free_rate_takes_the_best_actions_that_tell_least():
    action_value = np.array([[1.0, 0.0], [1.0, 1.0]])
    point = largest_return(action_value, np.array([0.5, 0.5]), np.inf)
    assert point.value == 1 and point.rate < 1e-3


def test_dual_of_equal_values_has_rate_zero():
    assert largest_return(np.ones((2, 3)), np.array([0.5, 0.5]), 1.0).rate == 0


def test_bad_arguments_are_rejected():
    action_value, states = sample_problem()
    with pytest.raises(ValueError, match="`rate` must lie in"):
        largest_return(action_value, states, -0.1)
    with pytest.raises(ValueError, match="`action_value` must be finite"):
        solve_rate_limited(action_value * np.inf, states, 0.1)
    with pytest.raises(ValueError, match="`state_distribution` must sum to 1"):
        solve_rate_limited(action_value, states * 2, 0.1)
