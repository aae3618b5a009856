"""Curiosity inside torchrl: a transform for replay buffers and environments, and two losses.

Example:
    >>> from deep_curiosity.integrations.torchrl import CuriosityTransform
    >>> from deep_curiosity.bonuses.learner import BonusLearner
    >>> from deep_curiosity.bonuses.registry import make_bonus
    >>> learner = BonusLearner(make_bonus("curiosity", observation_dim=3, action_dim=1))
    >>> replay_buffer.append_transform(CuriosityTransform(learner, add_to_reward=True))
"""

# ruff: noqa: E402  # a missing torchrl is reported before anything needs it
from deep_curiosity.requirements import require, warn_if_untested

require("torchrl", extra="torchrl")
warn_if_untested("torchrl", lowest="0.14", below="0.15")

from deep_curiosity.integrations.torchrl.actor_critic_loss import CuriousActorCriticLoss
from deep_curiosity.integrations.torchrl.bonus_loss import BonusLoss
from deep_curiosity.integrations.torchrl.integration import TorchRLAgent, TorchRLIntegration
from deep_curiosity.integrations.torchrl.transform import CuriosityTransform

__all__ = [
    "BonusLoss",
    "CuriosityTransform",
    "CuriousActorCriticLoss",
    "TorchRLAgent",
    "TorchRLIntegration",
]
