"""Counted operations of an update, from the sizes of its layers: the floor below its time.

Matrix products only, where a multiplication and an addition are two operations. What is done
element by element (activations, densities, Adam) takes time too: it is what lies above the floor.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from deep_curiosity.speed.machine import should_compile
from deep_curiosity.training.config import Settings


def forward(rows: int, widths: Sequence[int]) -> int:
    """Operations of a perceptron of these widths, input and output included.

    Example:
        >>> forward(10, [3, 4, 2])
        400
    """
    return 2 * rows * sum(left * right for left, right in pairwise(widths))


def fit(rows: int, widths: Sequence[int]) -> int:
    """Operations of a pass and of its gradient in all weights; the input needs none.

    The gradient in the weights is as many products as the pass; the gradient in what enters a
    layer is as many again, but for the first layer.
    """
    return 2 * forward(rows, widths) + forward(rows, widths[1:])


def climb(rows: int, widths: Sequence[int], inputs: int) -> int:
    """Operations of a pass and of its gradient in some of the inputs; the weights need none."""
    return forward(rows, widths) + forward(rows, [inputs, *widths[1:]])


def update_operations(
    settings: Settings, observation_dim: int, action_dim: int
) -> dict[str, float]:
    """Operations of one update, by part, as a mean over updates where it is not done at each.

    Raises:
        ValueError: If `curiosity_discount` is 0, where the actor climbs the bonus itself.
    """
    if settings.curiosity_discount == 0:
        raise ValueError("`curiosity_discount` must be above 0 to be counted, got 0.")
    batch, modes, outcomes = settings.batch_size, settings.policy_modes, settings.outcomes
    hidden = [settings.hidden_dim] * 2
    policy = [observation_dim, *hidden, modes * (2 * action_dim + 1) - 1]
    critic = [observation_dim + action_dim, *hidden, 1]
    critics = 2 if settings.bonus == "none" else 4

    target = forward(batch, policy) + critics * forward(batch, critic)
    evaluation = critics * fit(batch, critic)
    thinned = math.ceil(batch / settings.actor_stride)
    climbed = math.ceil(modes * thinned / (2 if settings.critic_per_row else 1))  # by each critic
    improvement = fit(thinned, policy) + critics * climb(climbed, critic, action_dim)
    agent = float(target + evaluation + improvement)
    if settings.bonus != "curiosity":
        return {"agent": agent}

    model = [observation_dim + action_dim, *hidden, outcomes * (2 * observation_dim + 1) - 1]
    members, components = settings.members, settings.components
    in_turn = math.ceil(batch / members)  # rows of each member, where a row has one
    rows = in_turn if settings.member_per_row else batch

    prediction = members * forward(rows, model)
    densities = members * forward(rows * outcomes, [2 * observation_dim, components])
    bonus = prediction + densities
    refresh = forward(batch, policy) + members * forward(in_turn, model) + bonus
    # a graph has the predictions from the pass by which the models learn
    asked = densities if should_compile(settings) else bonus
    return {
        "agent": agent + asked,
        "models": float(members * fit(rows, model)),
        "statistics": refresh / settings.refresh_interval,
    }
