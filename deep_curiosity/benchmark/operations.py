"""Counted operations of an update, from the sizes of its layers: the floor below its time.

Matrix products only, where a multiplication and an addition are two operations. What is done
element by element (activations, densities, Adam) takes time too: it is what lies above the floor.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from deep_curiosity.bonuses.config import CuriosityConfig
from deep_curiosity.training.config import Config
from deep_curiosity.training.learner import compiles


def count_forward(rows: int, widths: Sequence[int]) -> int:
    """Operations of a perceptron of these widths, input and output included.

    Example:
        >>> count_forward(10, [3, 4, 2])
        400
    """
    return 2 * rows * sum(left * right for left, right in pairwise(widths))


def count_training(rows: int, widths: Sequence[int]) -> int:
    """Operations of a pass and of its gradient in all weights; the input needs none.

    The gradient in the weights is as many products as the pass; the gradient in what enters a
    layer is as many again, but for the first layer.
    """
    return 2 * count_forward(rows, widths) + count_forward(rows, widths[1:])


def count_input_gradient(rows: int, widths: Sequence[int], inputs: int) -> int:
    """Operations of a pass and of its gradient in some of the inputs; the weights need none."""
    return count_forward(rows, widths) + count_forward(rows, [inputs, *widths[1:]])


def count_update(config: Config, observation_dim: int, action_dim: int) -> dict[str, float]:
    """Operations of one update, as a mean over updates where something is not done at each.

    Returns:
        Those of the agent and, with curiosity, of the training of its models and of the
        statistics of its bonus.

    Raises:
        ValueError: If `curiosity_discount` is 0, where the policy maximises the bonus itself.
    """
    if config.agent.curiosity.discount == 0:
        raise ValueError("`curiosity_discount` must be above 0 to be counted, got 0.")
    agent = _count_agent(config, observation_dim, action_dim)
    if not isinstance(config.bonus, CuriosityConfig):
        return {"agent": float(agent)}
    bonus = _count_curiosity(config, config.bonus, observation_dim, action_dim)
    return {
        "agent": float(agent + bonus["bonus"]),
        "models": float(bonus["models"]),
        "statistics": bonus["refresh"] / config.bonus.refresh_interval,
    }


def _count_agent(config: Config, observation_dim: int, action_dim: int) -> int:
    """Operations of targets, critics and policies."""
    agent, batch = config.agent, config.run.batch_size
    policy = _policy_widths(config, observation_dim, action_dim)
    critic = [observation_dim + action_dim, *_hidden_dims(config), 1]
    has_curiosity_critic = config.bonus.kind != "none" and agent.curiosity.discount > 0
    num_critics = 2 + has_curiosity_critic
    policies = _num_policies(config)

    target = policies * count_forward(batch, policy) + num_critics * count_forward(batch, critic)
    evaluation = num_critics * count_training(batch, critic)
    actor_rows = math.ceil(batch / agent.actor_stride)
    shared = 2 if agent.actor_q == "alternate" else 1
    actions = agent.mixture_components * actor_rows  # of each policy
    reward_rows = math.ceil(policies * actions / shared)  # of each of its critics
    action_gradient = 2 * count_input_gradient(reward_rows, critic, action_dim)
    if has_curiosity_critic:
        action_gradient += count_input_gradient(actions, critic, action_dim)
    return target + evaluation + policies * count_training(actor_rows, policy) + action_gradient


def _count_curiosity(
    config: Config, bonus: CuriosityConfig, observation_dim: int, action_dim: int
) -> dict[str, int]:
    """Operations of the bonus of a batch, of its models' training, and of a refresh."""
    dynamics, batch = bonus.dynamics, config.run.batch_size
    num_members, mixture = dynamics.num_members, dynamics.mixture_components
    outputs = mixture * (2 * observation_dim + 1) - 1
    model = [observation_dim + action_dim, *_hidden_dims(config), outputs]
    round_robin_rows = math.ceil(batch / num_members)  # of each member, where a row has one
    rows = round_robin_rows if dynamics.members == "round_robin" else batch
    prediction = num_members * count_forward(rows, model)
    components = bonus.marginal.components
    densities = num_members * count_forward(rows * mixture, [2 * observation_dim, components])
    next_states = num_members * count_forward(round_robin_rows, model)
    policy = _policy_widths(config, observation_dim, action_dim)
    actions = _num_policies(config) * count_forward(batch, policy)
    refresh = actions + next_states + prediction + densities
    is_shared = compiles(config)  # a graph has the predictions from the pass that teaches models
    return {
        "bonus": densities if is_shared else prediction + densities,
        "models": num_members * count_training(rows, model),
        "refresh": refresh,
    }


def _num_policies(config: Config) -> int:
    return 2 if config.bonus.kind != "none" and config.agent.greedy_share else 1


def _policy_widths(config: Config, observation_dim: int, action_dim: int) -> list[int]:
    outputs = config.agent.mixture_components * (2 * action_dim + 1) - 1
    return [observation_dim, *_hidden_dims(config), outputs]


def _hidden_dims(config: Config) -> list[int]:
    return [config.agent.hidden_dim] * 2
