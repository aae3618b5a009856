"""Far-sighted curiosity: the divergence D accumulated through a value of its own."""

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import check_range, checked
from deep_curiosity.tabular.markov import limiting_matrix, state_chain

LARGEST_DIVERGENCE = -float(np.log(np.finfo(float).tiny))  # nats, where the marginal is zero


@checked
def curiosity_values(
    transition: Float[np.ndarray, "states actions next_states"],
    divergence: Float[np.ndarray, "states actions"],
    policy: Float[np.ndarray, "states actions"],
    curiosity_discount: float,
) -> Float[np.ndarray, "states actions"]:
    r"""Discounted sum of D from a state and action on, up to a constant, in nats.

    With 0 it is D itself, the literal (21). The sum is centred on the average of D in the long
    run, which no policy notices and which keeps it finite for a discount of 1: there it is the
    gradient of the average predictive information,

    .. math:: Q_D(x, a) = D(x, a) + \gamma_D \sum_{x'} p(x' | x, a) V_D(x'), \qquad
        V_D = \sum_{t \ge 0} \gamma_D^t \left( P_\pi^t - P_\pi^\infty \right) D_\pi.

    Args:
        transition: Transition probabilities.
        divergence: D(x, a) of (18) under the policy, cut at 708 nats where it is infinite.
        policy: The policy from the next step on.
        curiosity_discount: Discount of curiosity, 1 included.
    """
    check_range("curiosity_discount", curiosity_discount, 0.0, 1.0)
    if curiosity_discount == 0:
        return divergence.copy()
    chain = state_chain(transition, policy)
    limit = limiting_matrix(chain)
    finite = np.minimum(divergence, LARGEST_DIVERGENCE)
    expected = np.einsum("xa,xa->x", policy, finite)
    resolvent = np.eye(len(chain)) - curiosity_discount * chain + limit
    value = np.linalg.solve(resolvent, expected - limit @ expected)
    return finite + curiosity_discount * transition @ value
