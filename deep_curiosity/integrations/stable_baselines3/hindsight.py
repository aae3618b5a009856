"""A replay buffer of goals in hindsight whose samples carry a fresh bonus."""

from typing import Any

import numpy as np
from stable_baselines3.common.type_aliases import DictReplayBufferSamples, TensorDict
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.her.her_replay_buffer import HerReplayBuffer

from deep_curiosity.integrations.stable_baselines3.replay import CuriousReplayBuffer
from deep_curiosity.integrations.stable_baselines3.spaces import mask_of
from deep_curiosity.transitions import Transition


class CuriousHerReplayBuffer(CuriousReplayBuffer, HerReplayBuffer):  # type: ignore[misc]
    """`HerReplayBuffer` that adds a bonus to the rewards of every batch, when it is sampled.

    The bonus is about one entry of the relabelled batch, raw: most often `observation`, which
    relabelling leaves as it was, so that curiosity is about the world and not about goals. It is
    added to the rewards that hindsight computed anew; those of several steps are not supported, as
    in the library's own.

    Args:
        *args: As for `CuriousReplayBuffer`, of which `observation_key` must be given.
        **options: As for `CuriousReplayBuffer` and `HerReplayBuffer`, such as `n_sampled_goal`.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._timeouts: list[np.ndarray] = []  # of the batch that is being sampled

    def sample(  # type: ignore[override]  # as the library's own does
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Sample a batch, some of its goals relabelled, and add the bonus to its rewards.

        Args:
            batch_size: Number of transitions.
            env: Normalises what is sampled, if it is given.

        Raises:
            RuntimeError: If no episode has ended yet.
            ValueError: If an end of an episode is known only as `env` has clipped it.
        """
        self._check_ends(env)
        self._timeouts = []
        raw = HerReplayBuffer.sample(self, batch_size)
        transition = self._relabelled(raw)
        samples = raw if env is None else self._normalized(raw, env)
        self.attachment.to(self.device).learn(transition, samples.observations)
        bonus = self.attachment.compute(transition)
        return samples._replace(rewards=samples.rewards + bonus.unsqueeze(-1))

    def _cut_off(self, columns: np.ndarray) -> None:
        """Let the newest step of some environments end its episode, from which goals are taken."""
        super()._cut_off(columns)
        for column in map(int, columns):
            self._compute_episode_length(column)

    def _relabelled(self, samples: DictReplayBufferSamples) -> Transition:
        """What the bonus is given of a batch whose goals are relabelled."""
        select = self.attachment.select_observation
        return Transition(
            observation=select(samples.observations).float(),
            action=samples.actions.float(),
            reward=samples.rewards.flatten().float(),
            next_observation=select(samples.next_observations).float(),
            terminated=samples.dones.flatten().bool(),
            truncated=mask_of(np.concatenate(self._timeouts), self.device),
        )

    def _normalized(
        self, samples: DictReplayBufferSamples, env: VecNormalize
    ) -> DictReplayBufferSamples:
        """The batch as the agent's networks take it."""
        rewards = self._normalize_reward(samples.rewards.cpu().numpy(), env)
        return samples._replace(
            observations=self._normalized_entries(samples.observations, env),
            next_observations=self._normalized_entries(samples.next_observations, env),
            rewards=self.to_torch(rewards),
        )

    def _normalized_entries(self, observations: TensorDict, env: VecNormalize) -> TensorDict:
        arrays = {key: value.cpu().numpy() for key, value in observations.items()}
        normalized = self._normalize_obs(arrays, env)
        assert isinstance(normalized, dict)
        return {key: self.to_torch(value) for key, value in normalized.items()}

    def _get_real_samples(
        self, batch_indices: np.ndarray, env_indices: np.ndarray, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        self._timeouts.append(self._are_timeouts(batch_indices, env_indices))
        return super()._get_real_samples(batch_indices, env_indices, env)

    def _get_virtual_samples(
        self, batch_indices: np.ndarray, env_indices: np.ndarray, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        self._timeouts.append(self._are_timeouts(batch_indices, env_indices))
        return super()._get_virtual_samples(batch_indices, env_indices, env)

    def _are_timeouts(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Which of some steps ended their episode by the clock."""
        ends: np.ndarray = self.dones[rows, columns] * self.timeouts[rows, columns]
        return ends
