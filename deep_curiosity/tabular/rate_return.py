"""The dual problem (10): the largest return at a rate of information, and their whole curve."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import (
    check_distribution,
    check_finite,
    check_positive,
    check_range,
    check_shape,
    checked,
)
from deep_curiosity.tabular.information import (
    action_information,
    kl_divergence,
    log_action_marginal,
)
from deep_curiosity.tabular.iteration import Solution, iterate
from deep_curiosity.tabular.markov import expected_return
from deep_curiosity.tabular.policies import information_limited, uniform_log_policy

NUM_BISECTIONS = 40  # each halves the bracket of log lambda
RATE_TOLERANCE = 1e-6  # nats below the given rate that end the bisection
BRACKET = (1e-3, 1e3)  # in ranges of a state's values: nearly deterministic, nearly zero rate


class RatePoint(NamedTuple):
    """One point of the curve.

    Args:
        temperature: The price lambda, which is the slope of the curve here; 0 where it ends.
        rate: I(A; X), in nats.
        value: Expected return V.
        policy: The policy that attains it.
        converged: Whether the iteration that found it converged.
    """

    temperature: float
    rate: float
    value: float
    policy: Float[np.ndarray, "states actions"]
    converged: bool


@checked
def solve_rate_limited(
    action_value: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    temperature: float,
    *,
    tolerance: float = 1e-12,
    max_iterations: int = 20_000,
) -> Solution:
    """Solves (13) with (14): the best trade of return for information, Q and p_t held fixed.

    The undamped iteration is the algorithm of Blahut and Arimoto with distortion -Q at slope
    1 / lambda, which maximises V - lambda I(A; X).

    Args:
        action_value: Q(x, a) of the policy on all other time steps.
        state_distribution: Distribution of the state at this time step.
        temperature: The price lambda.
        tolerance: Largest change of a probability that counts as convergence; at a temperature
            above the range of the values it is divided by their ratio, as the steps are.
        max_iterations: Largest number of updates.
    """
    check_finite("action_value", action_value)
    check_shape("state_distribution", state_distribution, action_value.shape[:1])
    check_distribution("state_distribution", state_distribution)
    value_range = _value_range(action_value, state_distribution) or np.inf  # equals: nothing moves

    def step(log_policy: np.ndarray) -> tuple[np.ndarray, float]:
        policy = np.exp(log_policy)
        log_prior = log_action_marginal(log_policy, state_distribution)
        value = expected_return(state_distribution, policy, action_value)
        rate = state_distribution @ kl_divergence(policy, log_prior)
        target = information_limited(log_prior, action_value, temperature)
        return target, float(value - temperature * rate)

    return iterate(
        step,
        uniform_log_policy(*action_value.shape),
        damping=1.0,
        tolerance=tolerance / max(1.0, temperature / value_range),
        max_iterations=max_iterations,
    )


@checked
def rate_point(
    action_value: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    temperature: float,
) -> RatePoint:
    """The point of the curve whose slope is `temperature`."""
    solution = solve_rate_limited(action_value, state_distribution, temperature)
    rate = action_information(solution.policy, state_distribution)
    value = expected_return(state_distribution, solution.policy, action_value)
    return RatePoint(temperature, rate, value, solution.policy, solution.converged)


@checked
def rate_return_curve(
    action_value: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    temperatures: Iterable[float],
) -> list[RatePoint]:
    """The rate-return curve, one point for each slope: concave, rising to the best return."""
    temperatures = [*temperatures]
    for temperature in temperatures:
        check_positive("temperatures", temperature)
    return [rate_point(action_value, state_distribution, float(t)) for t in temperatures]


@checked
def largest_return(
    action_value: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    rate: float,
) -> RatePoint:
    """The dual (10): the policy of largest return whose I(A; X) does not exceed `rate` nats.

    Args:
        action_value: Q(x, a) of the policy on all other time steps.
        state_distribution: Distribution of the state at this time step.
        rate: Largest I(A; X), in nats.
    """
    check_range("rate", rate, 0.0, np.inf)
    check_finite("action_value", action_value)
    value_range = _value_range(action_value, state_distribution)
    best = zero_rate_point(action_value, state_distribution)
    if rate == 0 or value_range == 0:
        return best
    low, high = (float(np.log(value_range * end)) for end in BRACKET)
    freest = rate_point(action_value, state_distribution, float(np.exp(low)))
    if freest.rate <= rate:
        greedy = _greedy_point(action_value, state_distribution, freest)
        return greedy if greedy.rate <= rate else freest
    for _ in range(NUM_BISECTIONS):
        point = rate_point(action_value, state_distribution, float(np.exp((low + high) / 2)))
        if point.rate <= rate:
            best = max(best, point, key=lambda point: point.value)  # the hot may not converge
            high = (low + high) / 2
        else:
            low = (low + high) / 2
        if rate - RATE_TOLERANCE <= best.rate:
            break
    return best


@checked
def zero_rate_point(
    action_value: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
) -> RatePoint:
    """The start of the curve: the best constant policy, at rate zero."""
    num_states, num_actions = action_value.shape
    best = (state_distribution @ action_value).argmax()
    policy = np.tile(np.eye(num_actions)[best], (num_states, 1))
    value = expected_return(state_distribution, policy, action_value)
    return RatePoint(float(np.inf), 0.0, value, policy, converged=True)


def _value_range(action_value: np.ndarray, state_distribution: np.ndarray) -> float:
    """Largest difference between the actions of a state that is met, the unit of every price."""
    return float(np.ptp(action_value[state_distribution > 0], axis=1).max())


def _greedy_point(
    action_value: np.ndarray, state_distribution: np.ndarray, freest: RatePoint
) -> RatePoint:
    """The end of the curve, the largest return there is; equal actions as `freest` takes them."""
    is_best = action_value == action_value.max(axis=1, keepdims=True)
    weight = is_best * (state_distribution @ freest.policy)
    weight = np.where(weight.any(axis=1, keepdims=True), weight, is_best)  # in states never met
    policy = weight / weight.sum(axis=1, keepdims=True)
    rate = action_information(policy, state_distribution)
    value = expected_return(state_distribution, policy, action_value)
    return RatePoint(0.0, rate, value, policy, freest.converged)
