"""Rollout buffers that add a bonus before advantages are computed, for PPO and A2C."""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import DictRolloutBuffer, RolloutBuffer
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.stable_baselines3.attachment import BonusAttachment, check_known
from deep_curiosity.integrations.stable_baselines3.spaces import batch_of, mask_of, scaled
from deep_curiosity.transitions import Transition, check_counts


class CuriousRolloutBuffer(RolloutBuffer):
    """A rollout buffer whose advantages come from reward plus bonus.

    When a rollout is complete the networks of the bonus learn from it in minibatches, the bonus
    looks at it as one batch, and is then computed: centred and scaled over the rollout itself,
    beside where the rollouts before it led. One given by name looks at every rollout, by a
    `refresh_interval` of 1, which is counted in minibatches. Stored rewards stay those of the
    environment. What the library's rollout lacks is brought by `CuriosityCallback`, without which
    this buffer refuses to work: the next observation where an episode ended, how it ended, and raw
    observations under `VecNormalize`.

    Args:
        buffer_size: Given by the agent, as are the next six.
        observation_space: Of the environment.
        action_space: Of the environment; what the policy samples beyond its bounds is clipped.
        device: Of the samples and of the bonus.
        gae_lambda: Of the advantages.
        gamma: Discount of the agent.
        n_envs: Environments side by side.
        batch_size: Steps in a minibatch of the bonus.
        epochs: Times that the bonus goes through a rollout.
        **bonus_options: `bonus`, `bonus_kwargs`, `learning_rate`, `update_interval` (counted in
            minibatches) and `observation_key`, as for `CuriousReplayBuffer`.

    Raises:
        TypeError: If `bonus` is neither a name nor a bonus, or there is no such option or setting.
        ValueError: If the spaces hold no vectors, or an option is out of range or out of place.
    """

    steps: list[Transition]

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        device: torch.device | str = "auto",
        gae_lambda: float = 1,
        gamma: float = 0.99,
        n_envs: int = 1,
        *,
        batch_size: int = 256,
        epochs: int = 4,
        **bonus_options: Any,
    ) -> None:
        if isinstance(observation_space, spaces.Dict) and not isinstance(self, DictRolloutBuffer):
            raise ValueError(
                "`rollout_buffer_class` must be CuriousDictRolloutBuffer for dictionary "
                f"observations, got {type(self).__name__}."
            )
        check_counts(batch_size=batch_size, epochs=epochs)
        check_known(bonus_options, CuriousRolloutBuffer)
        self.batch_size = batch_size
        self.epochs = epochs
        self.attachment = BonusAttachment(
            observation_space,
            action_space,
            refresh_interval=1,
            **bonus_options,
        )
        super().__init__(
            buffer_size, observation_space, action_space, device, gae_lambda, gamma, n_envs
        )

    @property
    def bonus(self) -> Bonus:
        """The bonus in use."""
        return self.attachment.learner.bonus

    def reset(self) -> None:
        """Begin a new rollout."""
        super().reset()
        self.steps = []

    def record(
        self,
        observation: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        next_observation: np.ndarray,
        done: np.ndarray,
        timeout: np.ndarray,
    ) -> None:
        """Keep a step of all environments as they gave it; the callback calls this.

        Args:
            observation: Raw, the part of it that the bonus is about.
            action: Within the bounds of the action space.
            reward: Raw.
            next_observation: Raw, the true one also where an episode ended.
            done: Where an episode ended.
            timeout: Where it was a clock that ended it.
        """
        self.steps.append(
            Transition(
                observation=batch_of(observation),
                action=batch_of(scaled(action, self.attachment.action_space)),
                reward=batch_of(reward),
                next_observation=batch_of(next_observation),
                terminated=mask_of(done & ~timeout),
                truncated=mask_of(done & timeout),
            )
        )

    def transition(self) -> Transition:
        """All steps of the rollout as the environments gave them, oldest first.

        Raises:
            RuntimeError: If the callback has not recorded them, or two have.
        """
        if len(self.steps) != self.buffer_size:
            remedy = (
                "learn(..., callback=CuriosityCallback()) records them."
                if len(self.steps) < self.buffer_size
                else "give one CuriosityCallback only."
            )
            raise RuntimeError(
                f"a rollout of {self.buffer_size} steps has {len(self.steps)} on record: {remedy}"
            )
        fields = zip(*self.steps, strict=True)
        return Transition(*(torch.cat(field).to(self.device) for field in fields))

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
        """Let the bonus learn from the rollout, then compute advantages of reward plus bonus."""
        rollout = self.transition()
        self._learn(rollout)
        bonus = self.attachment.compute(rollout).reshape(self.rewards.shape)
        rewards = self.rewards
        self.rewards = rewards + bonus.cpu().numpy()
        super().compute_returns_and_advantage(last_values, dones)
        self.rewards = rewards

    def _learn(self, rollout: Transition) -> None:
        """Let the networks go through the rollout several times, then show it to the bonus.

        It is shown as one batch, and last: its statistics are then of the very rows that are about
        to be scored, by the networks that score them, and none of these is yet among the states
        that the bonus remembers, beside which each would be near itself. The first rollout's first
        minibatch is shown before, since networks learn in units that are measured.
        """
        self.attachment.to(self.device)
        order = torch.randperm(len(rollout.reward)).to(self.device)
        if not self.bonus.ready:
            self._show(rollout, order[: self.batch_size])
            order = order[self.batch_size :]
        for _ in range(self.epochs):
            shuffled = torch.randperm(len(rollout.reward)).to(self.device)
            for rows in shuffled.split(self.batch_size):
                self.attachment.learner.train_on(_rows_of(rollout, rows))
        if len(order):
            self._show(rollout, order)

    def _show(self, rollout: Transition, rows: Tensor) -> None:
        """Show the bonus some rows, if it is due after so many minibatches."""
        part = _rows_of(rollout, rows)
        for _ in range((len(rows) - 1) // self.batch_size):
            if self.bonus.should_skip:
                self.bonus.skip()
        # what was done is what the policy does now
        self.attachment.learner.show(part, lambda _: part.action)


def _rows_of(rollout: Transition, rows: Tensor) -> Transition:
    return Transition(*(field[rows] for field in rollout))


class CuriousDictRolloutBuffer(CuriousRolloutBuffer, DictRolloutBuffer):  # type: ignore[misc]
    """The same for dictionary observations, of which the bonus is about one entry.

    Args:
        *args: As for `CuriousRolloutBuffer`, of which `observation_key` must now be given.
        **options: As for `CuriousRolloutBuffer`.
    """
