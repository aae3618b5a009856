"""The trainer's own agent, as the check handles it."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.base import Integration
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training.checkpoint import load_checkpoint, save_checkpoint
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import action_dim, make_environment, observation_dim
from deep_curiosity.training.learner import Learner
from deep_curiosity.transitions import Transition


class LearnerIntegration(Integration):
    """A learner in an environment of its own, eager.

    Args:
        config: Settings of the run.

    Raises:
        ValueError: If the run has no bonus.
    """

    def __init__(self, config: Config) -> None:
        self.config = config.override(num_envs=1, vectorization="auto", compile="off")
        self.environment = make_environment(self.config.environment)
        self._sizes = observation_dim(self.environment), action_dim(self.environment)
        torch.manual_seed(config.run.seed)
        self.learner = Learner(self.config, *self._sizes)
        if self.learner.bonus is None:
            raise ValueError("`bonus` must not be 'none' to be checked, got 'none'.")

    @property
    def bonus(self) -> Bonus:
        """Of the learner."""
        assert self.learner.bonus is not None
        return self.learner.bonus

    def collect(self, num_steps: int, *, seed: int) -> Transition:
        """Act, and store every step."""
        torch.manual_seed(seed)
        collector = Collector(self.environment, seed)
        steps = []
        for _ in range(num_steps):
            step, _ = collector.step(self.learner.act(collector.observation))
            self.learner.store(step)
            steps.append(step)
        recorded = ReplayBuffer(num_steps, *self._sizes)
        recorded.extend(*map(np.concatenate, zip(*steps, strict=True)))
        return recorded.all()

    def stored(self) -> Transition:
        """All of replay."""
        return self.learner.replay.all()

    def learn(self, *, seed: int) -> None:
        """One update of everything."""
        torch.manual_seed(seed)
        self.learner.update()

    def critic(self) -> list[Tensor]:
        """All critics."""
        return list(self.learner.agent.critics.parameters())

    def actor(self) -> list[Tensor]:
        """The policy."""
        return list(self.learner.agent.policy.parameters())

    def save(self, folder: Path) -> None:
        """A checkpoint of the learner."""
        save_checkpoint(folder, self.learner.state_dict())

    def load(self, folder: Path) -> "LearnerIntegration":
        """A learner from the checkpoint."""
        other = LearnerIntegration(self.config)
        other.learner.load_state_dict(load_checkpoint(folder))
        return other
