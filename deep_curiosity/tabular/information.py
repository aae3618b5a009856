"""Entropies, informations and divergences of finite distributions, exact and in nats."""

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import check_fits, checked

NATS_PER_BIT = float(np.log(2))


@checked
def to_bits(nats: float) -> float:
    """Converts nats to bits."""
    return nats / NATS_PER_BIT


@checked
def to_nats(bits: float) -> float:
    """Converts bits to nats."""
    return bits * NATS_PER_BIT


@checked
def safe_log(weight: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Logarithm that is minus infinity at zero, without a warning."""
    return np.log(weight, where=weight > 0, out=np.full(weight.shape, -np.inf))


@checked
def weighted_sum(
    weight: Float[np.ndarray, "*batch outcomes"], value: Float[np.ndarray, "*rest outcomes"]
) -> Float[np.ndarray, "*batch"]:
    """Expectation over the last axis in which zero times infinity is zero."""
    check_fits("value", value, weight)
    product = np.zeros(np.broadcast_shapes(weight.shape, value.shape))
    np.multiply(weight, value, where=weight > 0, out=product)
    return np.asarray(product.sum(-1))


@checked
def entropy(probability: Float[np.ndarray, "*batch outcomes"]) -> Float[np.ndarray, "*batch"]:
    """Shannon entropy along the last axis, in nats.

    Example:
        >>> float(entropy(np.array([0.5, 0.5])).round(4))
        0.6931
    """
    return weighted_sum(probability, -safe_log(probability))


@checked
def kl_divergence(
    probability: Float[np.ndarray, "*batch outcomes"],
    log_reference: Float[np.ndarray, "*rest outcomes"],
) -> Float[np.ndarray, "*batch"]:
    r"""Kullback-Leibler divergence (19) along the last axis, in nats.

    Infinite where the reference excludes what happens.

    Args:
        probability: The distribution that is true.
        log_reference: Log of the distribution compared with, broadcast against the first.
    """
    check_fits("log_reference", log_reference, probability)
    log_ratio = np.zeros(np.broadcast_shapes(probability.shape, log_reference.shape))
    np.subtract(safe_log(probability), log_reference, where=probability > 0, out=log_ratio)
    return weighted_sum(probability, log_ratio)


@checked
def mutual_information(
    distribution: Float[np.ndarray, " inputs"], channel: Float[np.ndarray, "inputs outputs"]
) -> float:
    r"""Information between the input and the output of a channel (3), in nats.

    .. math:: I(Z; Y) = \sum_z p(z) D_{KL}\left( p(y | z) \,\|\, p(y) \right)
    """
    log_marginal = np.logaddexp.reduce(safe_log(distribution)[:, None] + safe_log(channel))
    return float(weighted_sum(distribution, kl_divergence(channel, log_marginal)))


@checked
def action_information(
    policy: Float[np.ndarray, "states actions"], state_distribution: Float[np.ndarray, " states"]
) -> float:
    """What the action tells about the state, I(A; X) of (5): the coding cost, in nats."""
    return mutual_information(state_distribution, policy)


@checked
def predictive_information(
    transition: Float[np.ndarray, "states actions next_states"],
    policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
) -> float:
    """What state and action tell about the next state, I({X, A}; X') of (17), in nats."""
    joint = state_distribution[:, None] * policy
    return mutual_information(joint.ravel(), transition.reshape(joint.size, -1))


@checked
def state_predictive_information(
    transition: Float[np.ndarray, "states actions next_states"],
    policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
) -> float:
    """What the state alone tells about the next state, I(X; X'), in nats."""
    return mutual_information(state_distribution, np.einsum("xa,xay->xy", policy, transition))


@checked
def log_action_marginal(
    log_policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
) -> Float[np.ndarray, " actions"]:
    """Log of the action marginal p(a) of (14) and (23)."""
    return np.logaddexp.reduce(safe_log(state_distribution)[:, None] + log_policy, axis=0)


@checked
def log_next_state_marginal(
    transition: Float[np.ndarray, "states actions next_states"],
    log_policy: Float[np.ndarray, "states actions"],
    state_distribution: Float[np.ndarray, " states"],
) -> Float[np.ndarray, " next_states"]:
    """Log of the next-state marginal p(x') of (20) and (24)."""
    log_joint = safe_log(state_distribution)[:, None] + log_policy
    log_joint = log_joint[:, :, None] + safe_log(transition)  # states actions next_states
    return np.logaddexp.reduce(log_joint, axis=(0, 1))


@checked
def curiosity(
    transition: Float[np.ndarray, "states actions next_states"],
    log_marginal: Float[np.ndarray, " next_states"],
) -> Float[np.ndarray, "states actions"]:
    """Divergence D(x, a) of the next state from its marginal (18), in nats."""
    return kl_divergence(transition, log_marginal)
