"""Policies as formulas: the paper's solutions, their deterministic limits, and plain softmax."""

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import check_at_least, check_positive, check_range, checked

UNIFORM_SHARE = 1e-3  # probability divided over all actions
TIE_TOLERANCE = 1e-9  # of the range of the finite scores of a row
SCORE_ROUNDING = 1e-13  # of the best score: scores are sums of logs, exact to about as much
COLDEST = 1e-290  # what is colder is the limit (22) as well, and a score over it overflows


@checked
def normalize_log(
    log_weight: Float[np.ndarray, "*batch actions"],
) -> Float[np.ndarray, "*batch actions"]:
    """Normalises log weights along the last axis."""
    return log_weight - np.logaddexp.reduce(log_weight, axis=-1, keepdims=True)


@checked
def uniform_log_policy(num_states: int, num_actions: int) -> Float[np.ndarray, "states actions"]:
    """Log of the uniform policy."""
    check_at_least("num_states", num_states, 1)
    check_at_least("num_actions", num_actions, 1)
    return np.full((num_states, num_actions), -np.log(num_actions))


@checked
def random_log_policy(
    num_states: int, num_actions: int, rng: np.random.Generator
) -> Float[np.ndarray, "states actions"]:
    """Log of a policy sampled from a flat Dirichlet in every state."""
    check_at_least("num_states", num_states, 1)
    check_at_least("num_actions", num_actions, 1)
    return np.log(rng.dirichlet(np.ones(num_actions), size=num_states))


@checked
def mix_uniform(
    log_policy: Float[np.ndarray, "states actions"],
) -> Float[np.ndarray, "states actions"]:
    """Mixes a small uniform share into a policy, so that no action has probability zero."""
    share = np.log(UNIFORM_SHARE / log_policy.shape[-1])
    return normalize_log(np.logaddexp(log_policy, share))


@checked
def information_limited(
    log_prior: Float[np.ndarray, " actions"],
    score: Float[np.ndarray, "states actions"],
    temperature: float,
) -> Float[np.ndarray, "states actions"]:
    r"""Log of the policy that is optimal at a price per nat of I(A; X): (13), (21) and (25).

    .. math:: \pi(a | x) \propto p(a) \exp(s(x, a) / \lambda)

    Actions of infinite score take all probability, weighted among themselves by the prior. What
    the prior rules out stays ruled out, whatever its score.

    Args:
        log_prior: Log of the action marginal.
        score: Q for (13), D + alpha Q for (21) and (25).
        temperature: The price lambda.
    """
    check_positive("temperature", temperature)
    possible = np.where(np.isneginf(log_prior), -np.inf, score)
    return normalize_log(log_prior + tilt(possible, temperature))


@checked
def boltzmann(
    score: Float[np.ndarray, "states actions"], temperature: float
) -> Float[np.ndarray, "states actions"]:
    """Log of the policy that is optimal at a price per nat of missing entropy: plain softmax."""
    check_positive("temperature", temperature)
    return normalize_log(tilt(score, temperature))


@checked
def tilt(
    score: Float[np.ndarray, "*batch actions"], temperature: float
) -> Float[np.ndarray, "*batch actions"]:
    """Score over temperature, less that of the best action: zero there, and nowhere above.

    Taken from the best before the division, it stays a number however cold it is, and where the
    best score is infinite.
    """
    check_positive("temperature", temperature)
    best = score.max(-1, keepdims=True)
    shortfall = np.subtract(score, best, where=score != best, out=np.zeros(score.shape))
    return shortfall / max(temperature, COLDEST)


@checked
def greedy(score: Float[np.ndarray, "states actions"]) -> Float[np.ndarray, "states actions"]:
    """Deterministic limits (15) and (22): the best action, ties shared equally.

    What ties depends neither on the unit of the scores nor, but for rounding, on what they have in
    common.
    """
    best = score.max(-1, keepdims=True)
    least = np.where(np.isfinite(score), score, best).min(-1, keepdims=True)
    slack = np.zeros(best.shape)  # where the best is infinite
    np.subtract(best, least, where=np.isfinite(best), out=slack)
    slack = TIE_TOLERANCE * slack + SCORE_ROUNDING * np.nan_to_num(np.abs(best), posinf=0)
    chosen = score >= best - slack
    return chosen / chosen.sum(-1, keepdims=True)


@checked
def epsilon_greedy(
    score: Float[np.ndarray, "states actions"], epsilon: float
) -> Float[np.ndarray, "states actions"]:
    """The best action, or with probability `epsilon` any action."""
    check_range("epsilon", epsilon, 0.0, 1.0)
    return (1 - epsilon) * greedy(score) + epsilon / score.shape[-1]
