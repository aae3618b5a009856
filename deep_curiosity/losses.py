"""Losses of the agent, as pure functions whose signatures are the formulas."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def critic_target(
    reward: Float[Tensor, "*#batch"],
    terminated: Bool[Tensor, "*#batch"],
    next_value: Float[Tensor, "*batch"],
    discount: float | Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch"]:
    """One-step target `r + discount * V(x')`, without the value where the world ended.

    A truncated episode goes on: only `terminated` stops the bootstrap.
    """
    return torch.where(terminated, reward, reward + discount * next_value)


def multi_step_target(
    reward: Float[Tensor, "num_steps batch"],
    alive: Bool[Tensor, "num_steps batch"],
    terminated: Bool[Tensor, " batch"],
    next_value: Float[Tensor, " batch"],
    discount: Float[Tensor, " 1"],
) -> Float[Tensor, " batch"]:
    """Target `r_0 + ... + discount^(n-1) r_(n-1) + discount^n V(x_n)` of sequences.

    Args:
        reward: Of each step.
        alive: Which steps belong to their sequence: as many are counted.
        terminated: Whether the world ended with the last of them.
        next_value: Of the state after it.
        discount: Per step.

    Reference: Sutton & Barto, "Reinforcement Learning" (2018), (7.1); off-policy without
    correction, as in Hessel et al., "Rainbow" (2018).
    """
    number = torch.arange(len(reward), device=reward.device).unsqueeze(-1)
    total = torch.where(alive, discount**number * reward, 0.0).sum(0)
    return total + torch.where(terminated, 0.0, discount ** alive.sum(0) * next_value)


def critic_loss(
    value: Float[Tensor, "*critics batch"], target: Float[Tensor, "*#critics batch"]
) -> Float[Tensor, ""]:
    """Half the squared error, averaged over the batch and summed over critics."""
    return 0.5 * (value - target).square().mean(-1).sum()


def actor_loss(
    information_cost: Float[Tensor, "*modes batch"],
    value: Float[Tensor, "*modes batch"],
    curiosity_value: Float[Tensor, "*modes batch"] | float,
    *,
    temperature: float | Float[Tensor, ""],
    hunger: float | Float[Tensor, ""] | Float[Tensor, " batch"],
    weight: Float[Tensor, "*modes batch"] | float = 1.0,
) -> Float[Tensor, ""]:
    r"""Loss whose minimiser over policies is equation (21).

    .. math:: E[\lambda (\log \pi(a|x) - \log p(a)) - \alpha Q(x, a) - Q_D(x, a)]

    Args:
        information_cost: `log pi - log p` of each sampled action, in nats.
        value: Extrinsic value of each sampled action.
        curiosity_value: Curiosity value of each sampled action; 0 without curiosity.
        temperature: Price of a nat, lambda.
        hunger: Weight of the extrinsic value, alpha; one for all, or one for each.
        weight: Of each mode of the policy, where one action was drawn from every mode.
    """
    loss = temperature * information_cost - hunger * value - curiosity_value
    return (weight * loss).sum() / loss.shape[-1]


def prior_loss(
    log_prob: Float[Tensor, "*modes batch"], weight: Float[Tensor, "*modes batch"] | float = 1.0
) -> Float[Tensor, ""]:
    """Cross-entropy of the policy's own actions; its minimiser is the marginal (14), (23)."""
    return -(weight * log_prob).sum() / log_prob.shape[-1]


def temperature_loss(
    log_temperature: Float[Tensor, ""],
    information_cost: Float[Tensor, " batch"],
    target_rate: float,
) -> Float[Tensor, ""]:
    """Dual loss of the constraint (10): a nat's price rises while the rate is above target."""
    return -log_temperature * (information_cost.mean() - target_rate).detach()
