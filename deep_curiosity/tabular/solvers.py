"""The policy that solves (21) with (20): at one time step, and for its own stationary states."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from deep_curiosity.tabular.checks import check_distribution, check_shape, checked
from deep_curiosity.tabular.environments import FiniteMDP
from deep_curiosity.tabular.far_sighted import curiosity_values
from deep_curiosity.tabular.information import (
    action_information,
    curiosity,
    kl_divergence,
    log_action_marginal,
    log_next_state_marginal,
    predictive_information,
    weighted_sum,
)
from deep_curiosity.tabular.iteration import Solution, iterate, safe_damping
from deep_curiosity.tabular.markov import (
    action_values,
    expected_return,
    stationary_distribution,
)
from deep_curiosity.tabular.policies import information_limited, mix_uniform, uniform_log_policy


@checked
def curious_objective(
    transition: Float[np.ndarray, "states actions next_states"],
    policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    weighted_value: Float[np.ndarray, "states actions"],
    temperature: float,
) -> float:
    """The objective (16, 17) at one time step: I({X, A}; X') + alpha V - lambda I(A; X), in nats.

    Args:
        transition: Transition probabilities.
        policy: The policy of this time step, q.
        state_distribution: Distribution of the state at this time step.
        weighted_value: Action values times alpha, in nats. Their mean is V of (6) without the
            reward earned before; the factor discount^t of (6) is included in alpha.
        temperature: The price lambda.
    """
    return (
        predictive_information(transition, policy, state_distribution)
        + expected_return(state_distribution, policy, weighted_value)
        - temperature * action_information(policy, state_distribution)
    )


@checked
def curious_score(
    transition: Float[np.ndarray, "states actions next_states"],
    log_policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    curiosity_discount: float = 0.0,
) -> Float[np.ndarray, "states actions"]:
    """The curiosity term in the exponent of (21): D, or its far-sighted sum, in nats."""
    log_marginal = log_next_state_marginal(transition, log_policy, state_distribution)
    divergence = curiosity(transition, log_marginal)
    return curiosity_values(transition, divergence, np.exp(log_policy), curiosity_discount)


@checked
def curious_step(
    transition: Float[np.ndarray, "states actions next_states"],
    log_policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    weighted_value: Float[np.ndarray, "states actions"],
    temperature: float,
    curiosity_discount: float = 0.0,
) -> tuple[Float[np.ndarray, "states actions"], float]:
    """One update (23)-(25) as the paper writes it, in logs.

    Returns:
        The updated log policy, and the objective (16) of the policy before.
    """
    policy = np.exp(log_policy)
    log_prior = log_action_marginal(log_policy, state_distribution)
    log_marginal = log_next_state_marginal(transition, log_policy, state_distribution)
    divergence = curiosity(transition, log_marginal)
    score = curiosity_values(transition, divergence, policy, curiosity_discount)
    gain = weighted_sum(policy, divergence + weighted_value)
    cost = kl_divergence(policy, log_prior)
    objective = float(weighted_sum(state_distribution, gain - temperature * cost))
    return information_limited(log_prior, score + weighted_value, temperature), objective


@checked
def maximize(
    states_and_values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    transition: Float[np.ndarray, "states actions next_states"],
    log_policy: Float[np.ndarray, "states actions"],
    *,
    temperature: float,
    curiosity_discount: float,
    damping: float | None,
    recomputed: Bool[np.ndarray, " states"],
    tolerance: float,
    max_iterations: int,
) -> Solution:
    """Iterates (23)-(25), with the states and weighted values that `states_and_values` returns."""

    def step(log_policy: np.ndarray) -> tuple[np.ndarray, float]:
        states, value = states_and_values(log_policy)
        updated, objective = curious_step(
            transition, log_policy, states, value, temperature, curiosity_discount
        )
        return np.where(recomputed[:, None], updated, log_policy), objective

    solution = iterate(
        step,
        log_policy,
        damping=safe_damping(temperature) if damping is None else damping,
        halving=damping is None,
        tolerance=tolerance / max(1.0, temperature),
        max_iterations=max_iterations,
    )
    kept = np.where(recomputed[:, None], solution.log_policy, log_policy)  # not even rounded
    return replace(solution, log_policy=kept)


@checked
def solve_time_step(
    transition: Float[np.ndarray, "states actions next_states"],
    log_policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
    weighted_value: Float[np.ndarray, "states actions"] | None = None,
    *,
    temperature: float,
    curiosity_discount: float = 0.0,
    damping: float | None = None,
    recomputed: Bool[np.ndarray, " states"] | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 20_000,
) -> Solution:
    """Step 2(c) of the algorithm: the policy of one time step, p_t(x) and Q held fixed.

    With a `curiosity_discount` of 0 the objective is concave in the policy, so the damped
    iteration maximises it from any policy that gives every action a positive probability.

    Args:
        transition: Transition probabilities.
        log_policy: Initial log policy, q^(0).
        state_distribution: Distribution of the state at this time step.
        weighted_value: Action values times alpha, by default zero.
        temperature: The price lambda.
        curiosity_discount: Discount of curiosity, 0 for the paper as written.
        damping: Fraction of the step to (25) in log space, 1 for the update as written;
            `safe_damping(temperature)`, halved at each overshoot, by default.
        recomputed: The states in which the policy changes, by default all.
        tolerance: Largest change of a probability that counts as convergence; at a temperature
            above 1 it is divided by it, as the steps are.
        max_iterations: Largest number of updates.
    """
    check_start(log_policy, state_distribution, transition.shape[:2])
    value = np.zeros(log_policy.shape) if weighted_value is None else weighted_value
    return maximize(
        lambda log_policy: (state_distribution, value),
        transition,
        log_policy,
        temperature=temperature,
        curiosity_discount=curiosity_discount,
        damping=damping,
        recomputed=np.ones(len(log_policy), bool) if recomputed is None else recomputed,
        tolerance=tolerance,
        max_iterations=max_iterations,
    )


@checked
def solve_stationary(
    mdp: FiniteMDP,
    log_policy: Float[np.ndarray, "states actions"] | None = None,
    *,
    temperature: float,
    hunger: float = 0.0,
    curiosity_discount: float = 0.0,
    damping: float | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 20_000,
) -> Solution:
    """The policy that solves (21) with (20) for its own stationary states and its own Q.

    Args:
        mdp: The environment.
        log_policy: Initial log policy, by default uniform.
        temperature: The price lambda.
        hunger: Weight alpha of the reward.
        curiosity_discount: Discount of curiosity, 0 for the paper as written.
        damping: Fraction of the step to (25) in log space, 1 for the update as written;
            `safe_damping(temperature)`, halved at each overshoot, by default.
        tolerance: Largest change of a probability that counts as convergence; at a temperature
            above 1 it is divided by it, as the steps are.
        max_iterations: Largest number of updates.
    """
    first = uniform_log_policy(*mdp.reward.shape) if log_policy is None else log_policy
    check_start(first, mdp.start, mdp.reward.shape)

    def states_and_values(log_policy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        policy = np.exp(log_policy)
        value = action_values(mdp.transition, mdp.reward, policy, mdp.discount)
        return stationary_distribution(mdp.transition, policy, mdp.start), hunger * value

    return maximize(
        states_and_values,
        mdp.transition,
        first,
        temperature=temperature,
        curiosity_discount=curiosity_discount,
        damping=damping,
        recomputed=np.ones(mdp.num_states, bool),
        tolerance=tolerance,
        max_iterations=max_iterations,
    )


@checked
def anneal(
    solve: Callable[[Float[np.ndarray, "states actions"], float], Solution],
    log_policy: Float[np.ndarray, "states actions"],
    temperatures: Iterable[float],
    *,
    recomputed: Bool[np.ndarray, " states"] | None = None,
) -> Solution:
    """Deterministic annealing: solves at each temperature from the previous solution.

    A uniform share is mixed into every initial policy, since an action whose probability
    vanished at a high temperature may be optimal at a low one; where the policy does not change,
    nothing is mixed in.

    Args:
        solve: Maps a log policy and a temperature to a solution.
        log_policy: Initial log policy.
        temperatures: Temperatures, falling.
        recomputed: The states in which `solve` changes the policy, by default all.

    Returns:
        The solution at the last temperature.
    """
    changes = np.ones(len(log_policy), bool) if recomputed is None else recomputed
    solution = None
    for temperature in temperatures:
        mixed = np.where(changes[:, None], mix_uniform(log_policy), log_policy)
        solution = solve(mixed, temperature)
        log_policy = solution.log_policy
    if solution is None:
        raise ValueError("`temperatures` must name at least one temperature, got none.")
    return solution


def check_start(
    log_policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " some_states"],
    shape: tuple[int, ...],
) -> None:
    """Raises unless policy and state distribution are valid and match the shape."""
    check_shape("log_policy", log_policy, shape)
    check_shape("state_distribution", state_distribution, shape[:1])
    check_distribution("policy", np.exp(log_policy))
    check_distribution("state_distribution", state_distribution)
