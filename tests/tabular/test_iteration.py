import numpy as np
import pytest

from deep_curiosity.tabular.iteration import damp, iterate, safe_damping
from deep_curiosity.tabular.policies import normalize_log

HALF = np.log([[0.5, 0.5]])
LEFT, RIGHT, MIDDLE = np.log([[0.8, 0.2]]), np.log([[0.1, 0.9]]), np.log([[0.3, 0.7]])


def towards(target):
    return lambda log_policy: (target, float(np.exp(log_policy[0, 0])))


def rotate(*policies):
    """Sends each policy to the next, and the last to the first."""

    def step(log_policy):
        distance = [np.abs(policy - log_policy).max() for policy in policies]
        return policies[(int(np.argmin(distance)) + 1) % len(policies)], 0.0

    return step


def test_damping_is_a_geometric_mean():
    mean = np.exp(damp(LEFT, RIGHT, 0.25))
    weight = np.exp(LEFT) ** 0.75 * np.exp(RIGHT) ** 0.25
    np.testing.assert_allclose(mean, weight / weight.sum())


def test_whole_step_reaches_a_target_that_rules_actions_out():
    certain = np.array([[0.0, -np.inf]])
    np.testing.assert_array_equal(damp(certain, certain, 1.0), certain)


def test_safe_damping_is_small_when_information_is_cheap():
    assert safe_damping(1.0) == 0.5
    assert safe_damping(0.01) == pytest.approx(0.01 / 1.01)


def test_iteration_converges_and_traces_every_policy():
    solution = iterate(towards(LEFT), HALF, damping=0.5)
    assert solution.converged and solution.cycle_length is None
    np.testing.assert_allclose(solution.policy, [[0.8, 0.2]], atol=1e-9)
    assert solution.objective[0] == 0.5 and solution.objective[-1] == pytest.approx(0.8)
    assert (np.diff(solution.objective) > 0).all()


@pytest.mark.parametrize("cycle", [(LEFT, RIGHT), (LEFT, RIGHT, MIDDLE)])
def test_cycle_is_detected_with_its_length(cycle):
    solution = iterate(rotate(*cycle), HALF, damping=1.0)
    assert not solution.converged
    assert solution.cycle_length == len(cycle)
    assert len(solution.objective) < 10


def test_iteration_that_runs_out_has_neither_converged_nor_cycled():
    solution = iterate(towards(LEFT), HALF, damping=0.01, max_iterations=3)
    assert not solution.converged and solution.cycle_length is None
    assert solution.objective.shape == (4,)


def test_iteration_ends_at_the_first_policy_that_is_no_number():
    seen = []

    def step(log_policy):
        seen.append(log_policy)
        return np.full((1, 2), np.nan), 0.0

    with pytest.raises(ValueError, match="finite answer"):
        iterate(step, HALF, damping=1.0)
    assert len(seen) == 2  # one update, and the objective where it led


def test_halving_stops_an_overshoot():
    def overshoot(log_policy):
        return normalize_log(log_policy + 2.2 * (MIDDLE - log_policy)), 0.0

    assert not iterate(overshoot, HALF, damping=1.0, max_iterations=200).converged
    halved = iterate(overshoot, HALF, damping=1.0, halving=True, max_iterations=200)
    assert halved.converged
    np.testing.assert_allclose(halved.policy, np.exp(MIDDLE), atol=1e-9)


def test_bad_parameters_are_rejected():
    with pytest.raises(ValueError, match="`damping` must lie in"):
        iterate(towards(LEFT), HALF, damping=0.0)
    with pytest.raises(ValueError, match="`tolerance` must be positive"):
        iterate(towards(LEFT), HALF, damping=1.0, tolerance=0.0)
    with pytest.raises(ValueError, match="`max_iterations` must be at least 1, got 0"):
        iterate(towards(LEFT), HALF, damping=1.0, max_iterations=0)
    with pytest.raises(ValueError, match="`temperature` must be positive"):
        safe_damping(0.0)


@pytest.mark.parametrize("damping", [0.5, 1.0])
def test_what_is_damped_is_an_array_of_its_own(damping):
    damped = damp(LEFT, RIGHT, damping)
    assert not np.shares_memory(damped, LEFT) and not np.shares_memory(damped, RIGHT)
