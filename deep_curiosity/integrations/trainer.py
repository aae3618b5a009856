"""The trainer's own agent, as the check handles it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.base import Integration
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training.checkpoint import load_checkpoint, save_checkpoint
from deep_curiosity.training.collector import Collector, EnvironmentSteps
from deep_curiosity.training.environments import action_dim, make_environment, observation_dim
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.config import Settings
from deep_curiosity.transitions import Transition


class LearnerIntegration(Integration):
    """A learner in an environment of its own, one world, eager.

    Args:
        settings: Of the run.

    Raises:
        ValueError: If the run has no bonus.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = replace(settings, num_envs=1, compile="off")
        self.environment = make_environment(
            settings.env_id, settings.env_kwargs, history=settings.history
        )
        self._sizes = observation_dim(self.environment), action_dim(self.environment)
        torch.manual_seed(settings.seed)
        self.learner = Learner(self.settings, *self._sizes)
        if self.learner.bonus is None:
            raise ValueError(f"`bonus` must not be 'none' to be checked, got {settings.bonus!r}.")

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
        given = ReplayBuffer(num_steps, *self._sizes)
        given.extend(*EnvironmentSteps(*map(np.array, zip(*steps, strict=True))))
        return given.all()

    def stored(self) -> Transition:
        """All of replay."""
        return self.learner.replay.all()

    def learn(self, *, seed: int) -> None:
        """One update of everything."""
        torch.manual_seed(seed)
        self.learner.update()

    def critic(self) -> list[Tensor]:
        """Both pairs of critics."""
        return list(self.learner.agent.critics.parameters())

    def actor(self) -> list[Tensor]:
        """The policy."""
        return list(self.learner.agent.policy.parameters())

    def save(self, folder: Path) -> None:
        """A checkpoint of the learner."""
        save_checkpoint(folder, self.learner.state_dict())

    def load(self, folder: Path) -> "LearnerIntegration":
        """A learner from the checkpoint."""
        other = LearnerIntegration(self.settings)
        other.learner.load_state_dict(load_checkpoint(folder))
        return other
