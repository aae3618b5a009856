"""A replay buffer of goals in hindsight whose samples carry a fresh bonus."""

from typing import Any

import numpy as np
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.her.her_replay_buffer import HerReplayBuffer

from deep_curiosity.integrations.stable_baselines3.replay import CuriousReplayBuffer
from deep_curiosity.transitions import Transition


class CuriousHerReplayBuffer(CuriousReplayBuffer, HerReplayBuffer):  # type: ignore[misc]
    """`HerReplayBuffer` that adds a bonus to the rewards of every batch, when it is sampled.

    The bonus is about one entry of the relabelled batch, raw: most often `observation`, which
    relabelling leaves as it was, so that curiosity is about the world and not about goals. It is
    added to the rewards that hindsight computed anew.

    Args:
        *args: As for `CuriousReplayBuffer`, of which `observation_key` must be given.
        **options: As for `CuriousReplayBuffer` and `HerReplayBuffer`, such as `n_sampled_goal`.
    """

    def sample(  # type: ignore[override]  # as the library's own does
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Sample a batch, some of its goals relabelled, and add the bonus to its rewards.

        Args:
            batch_size: Number of transitions.
            env: Normalises what is sampled, if it is given.

        Raises:
            RuntimeError: If no episode has ended yet.
        """
        raw: DictReplayBufferSamples = HerReplayBuffer.sample(self, batch_size, None)
        samples = raw if env is None else self._normalized(raw, env)
        transition = self._relabelled(raw)
        self.attachment.to(self.device).learn(transition, samples.observations)
        bonus = self.attachment.compute(transition)
        return samples._replace(rewards=samples.rewards + bonus.unsqueeze(-1))

    def _get_real_samples(self, batch_indices: np.ndarray, env_indices: np.ndarray, env: Any = None):
        self._rows = batch_indices, env_indices
