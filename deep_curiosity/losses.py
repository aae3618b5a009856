"""Losses and targets of the agent, as pure functions whose signatures are the formulas."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

LEAST_WEIGHT = 1e-2  # of a value that later nats are charged to: less is hardly heard


def n_step_target(
    reward: Float[Tensor, "*values num_steps batch"],
    alive: Bool[Tensor, "num_steps batch"],
    terminated: Bool[Tensor, "*#values batch"],
    next_value: Float[Tensor, "*values batch"],
    discount: Float[Tensor, "*values 1"],
) -> Float[Tensor, "*values batch"]:
    """Target `r_0 + ... + discount^(n-1) r_(n-1) + discount^n V(x_n)` of sequences.

    A truncated episode goes on: only `terminated` stops the bootstrap.

    Args:
        reward: Reward of each step.
        alive: Which steps belong to their sequence: as many are counted.
        terminated: Whether the episode terminated with the last of them.
        next_value: Value of the state after it.
        discount: Discount per step.

    Reference: Sutton & Barto, "Reinforcement Learning" (2018), (7.1); off-policy without
    correction, as in Hessel et al., "Rainbow" (2018).
    """
    if len(alive) == 1:  # the first step always belongs to its sequence
        reward = reward.squeeze(-2)
        return torch.where(terminated, reward, reward + discount * next_value)
    step = torch.arange(len(alive), device=reward.device).unsqueeze(-1)
    total = torch.where(alive, discount.unsqueeze(-1) ** step * reward, 0.0).sum(-2)
    return total + torch.where(terminated, 0.0, discount ** alive.sum(0) * next_value)


def price_shares(
    hunger: Float[Tensor, "*batch"], coefficient: Float[Tensor, "*batch"] | None
) -> Float[Tensor, "pairs *batch"]:
    """By how much of lambda each value is charged for a later nat, so that it costs lambda in all.

    The policy maximises `hunger * Q + coefficient * Q_D`. Reward's value bears the price as far as
    it is heard, the curiosity value what is left of it.

    Args:
        hunger: Weight of the reward's value, alpha.
        coefficient: Weight of the curiosity value; `None` without one: reward's value then bears
            all of the price.
    """
    if coefficient is None:
        return (1 / hunger.clamp(min=LEAST_WEIGHT)).unsqueeze(0)
    of_curiosity = (1 - hunger).clamp(min=0.0) / coefficient.clamp(min=LEAST_WEIGHT)
    return torch.stack([1 / hunger.clamp(min=1.0), of_curiosity])


def critic_loss(
    value: Float[Tensor, "*critics batch"], target: Float[Tensor, "*#critics batch"]
) -> Float[Tensor, ""]:
    """Half the squared error, averaged over the batch and summed over critics."""
    return 0.5 * (value - target).square().mean(-1).sum()


def actor_loss(
    information_cost: Float[Tensor, "*components batch"],
    value: Float[Tensor, "*components batch"],
    curiosity_value: Float[Tensor, "*components batch"] | float,
    *,
    temperature: float | Float[Tensor, "*#rows"],
    hunger: float | Float[Tensor, "*#rows"],
    weight: Float[Tensor, "*components batch"] | float = 1.0,
) -> Float[Tensor, ""]:
    r"""Loss whose minimiser over policies is equation (21).

    .. math:: E[\lambda (\log \pi(a|x) - \log p(a)) - \alpha Q(x, a) - Q_D(x, a)]

    Args:
        information_cost: `log pi - log p` of each sampled action, in nats.
        value: Value of the reward, for each sampled action.
        curiosity_value: Value of the bonus, for each sampled action; 0 without curiosity.
        temperature: Price of a nat, lambda; one for all, or one for each.
        hunger: Weight of the reward's value, alpha; one for all, or one for each.
        weight: Weight of each of the policy's components, where one action was sampled from each.
    """
    loss = temperature * information_cost - hunger * value - curiosity_value
    return (weight * loss).sum() / loss.shape[-1]


def prior_loss(
    log_prob: Float[Tensor, "*components batch"],
    weight: Float[Tensor, "*components batch"] | float = 1.0,
) -> Float[Tensor, ""]:
    """Cross-entropy of the policy's own actions; its minimiser is the marginal (14), (23)."""
    return -(weight * log_prob).sum() / log_prob.shape[-1]


def temperature_loss(
    log_temperature: Float[Tensor, "*policies"],
    information_cost: Float[Tensor, "*policies batch"],
    target_rate: float,
) -> Float[Tensor, ""]:
    """Dual loss of the constraint (10): a nat's price rises while the rate is above target."""
    return -(log_temperature * (information_cost.mean(-1) - target_rate).detach()).sum()
