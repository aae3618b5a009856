"""Replay buffers whose samples carry a fresh bonus, for SAC, TD3, DDPG, TQC and CrossQ."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import DictReplayBuffer, NStepReplayBuffer, ReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples, ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.stable_baselines3.attachment import BonusAttachment, check_known
from deep_curiosity.integrations.stable_baselines3.normalization import (
    RAW_END,
    end_of,
    is_clipped,
)
from deep_curiosity.integrations.stable_baselines3.spaces import batch_of, mask_of
from deep_curiosity.transitions import Transition, check_counts, is_number


class CuriousReplayBuffer(ReplayBuffer):
    """A replay buffer that adds a bonus to the rewards of every batch, when it is sampled.

    The library saves and loads it with the bonus by `pickle`, which runs what it finds: load only
    files that you trust.

    Each call of `sample` shows the batch to the bonus, lets it learn at its own pace and then
    computes it, so that no bonus is ever older than the batch. Stored rewards stay those of the
    environment. The bonus is given raw observations, also under `VecNormalize`: it whitens
    them itself, and is added to the normalised reward.

    Args:
        buffer_size: Given by the agent, as are the next four.
        observation_space: Of the environment.
        action_space: Of the environment.
        device: Of the samples and of the bonus.
        n_envs: Environments side by side.
        bonus: A name from `BONUSES`, or a bonus, which is then used itself and not copied.
        bonus_kwargs: Settings of the bonus as `make_bonus` takes them, where it is given by name.
        learning_rate: Of the networks of the bonus.
        update_interval: Samples from one gradient step of the bonus to the next.
        observation_key: Entry of a dictionary observation that the bonus is about.
        **options: Of the buffer that this one extends.

    Raises:
        TypeError: If `bonus` is neither a name nor a bonus, or there is no such option or setting.
        ValueError: If the spaces hold no vectors, or an option is out of range or out of place.
    """

    # of the class, so that buffers which were saved without them load
    _largest_end = 0.0  # entry of those ends that are known only as `VecNormalize` leaves them
    _clip_obs: float | None = None  # at which an end was found clipped

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        device: torch.device | str = "auto",
        n_envs: int = 1,
        *,
        bonus: str | Bonus = "curiosity",
        bonus_kwargs: Mapping[str, Any] | None = None,
        learning_rate: float = 1e-3,
        update_interval: int = 1,
        observation_key: str | None = None,
        **options: Any,
    ) -> None:
        if isinstance(observation_space, spaces.Dict) and not isinstance(self, DictReplayBuffer):
            raise ValueError(
                "`replay_buffer_class` must be CuriousDictReplayBuffer for dictionary "
                f"observations, got {type(self).__name__}."
            )
        if options.get("optimize_memory_usage"):
            raise ValueError(
                "`optimize_memory_usage` must be False, got True: it overwrites the next "
                "observation of the last step of an episode, from which the bonus would learn."
            )
        if not options.get("handle_timeout_termination", True):
            raise ValueError(
                "`handle_timeout_termination` must be True, got False: what a clock cuts off "
                "would be stored as if it had terminated."
            )
        check_known(options, type(self))
        self.attachment = BonusAttachment(
            observation_space,
            action_space,
            bonus=bonus,
            bonus_kwargs=bonus_kwargs,
            learning_rate=learning_rate,
            update_interval=update_interval,
            observation_key=observation_key,
        )
        super().__init__(
            buffer_size,
            observation_space,
            action_space,
            device=device,  # by name: a buffer of goals has another argument in its place
            n_envs=n_envs,
            **options,
        )

    @property
    def bonus(self) -> Bonus:
        """The bonus in use."""
        return self.attachment.learner.bonus

    def add(
        self,
        obs: Any,
        next_obs: Any,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: Sequence[dict[str, Any]],
    ) -> None:
        """Store a step of all environments; the agent calls this.

        Where an environment was reset since the newest step, that one now ends its episode, as if
        a clock had cut it off.

        Raises:
            ValueError: If a wrapper above `VecNormalize` changes observations, or an episode ended
                and its last observation is not in `infos`.
        """
        self._check_shape(obs)
        for index in map(int, np.flatnonzero(done)):
            end = end_of(infos[index])
            if RAW_END in infos[index]:
                _write(next_obs, index, end)
            else:
                largest = np.abs(self.attachment.select_observation(end)).max()
                self._largest_end = max(self._largest_end, float(largest))
        if self.size() > 0:
            self._cut_off(self._interrupted(obs))
        super().add(obs, next_obs, action, reward, done, list(infos))

    def _check_shape(self, observation: Any) -> None:
        """Reject what `VecNormalize` has kept for an agent that observes something else."""
        select = self.attachment.select_observation
        expected, got = select(self.observations).shape[1:], np.shape(select(observation))
        if got != expected:
            raise ValueError(
                f"`env` must give raw observations of shape {expected}, got {got}: VecNormalize "
                "must be above all that changes observations, as in "
                "VecNormalize(VecFrameStack(...))."
            )

    def _check_ends(self, normalize: VecNormalize | None) -> None:
        """Reject ends of episodes that are known only as `VecNormalize` has clipped them."""
        if normalize is not None:
            if is_clipped(self._largest_end, normalize, self.attachment.observation_key):
                self._clip_obs = normalize.clip_obs
            self._largest_end = 0.0
        if self._clip_obs is not None:
            raise ValueError(
                "`callback` must be CuriosityCallback() where VecNormalize clips the end of "
                "an episode, from which the bonus would learn, got an end beyond "
                f"`clip_obs` {self._clip_obs}, which is now in this buffer: begin with a new one, "
                "such as that of a new agent."
            )

    def _interrupted(self, observation: Any) -> np.ndarray:
        """Environments that are not where the newest step led, though it ended no episode."""
        newest = self.pos - 1
        goes_on = _equal(_row(self.next_observations, newest), observation)
        return np.flatnonzero(~goes_on & (self.dones[newest] == 0))

    def _cut_off(self, columns: np.ndarray) -> None:
        """Let the newest step of some environments end its episode, as by a clock."""
        self.dones[self.pos - 1, columns] = self.timeouts[self.pos - 1, columns] = 1

    def transition(self, rows: np.ndarray, columns: np.ndarray) -> Transition:
        """Stored steps as the environment gave them, with actions in [-1, 1].

        Args:
            rows: Their places in the buffer.
            columns: Their environments.
        """
        done = mask_of(self.dones[rows, columns], self.device)
        timeout = mask_of(self.timeouts[rows, columns], self.device)
        select = self.attachment.select_observation
        return Transition(
            observation=batch_of(select(self.observations)[rows, columns], self.device),
            action=batch_of(self.actions[rows, columns], self.device),
            reward=batch_of(self.rewards[rows, columns], self.device),
            next_observation=batch_of(select(self.next_observations)[rows, columns], self.device),
            terminated=done & ~timeout,
            truncated=done & timeout,
        )

    def _get_samples(  # type: ignore[override]  # of a dictionary buffer, whose samples differ
        self, batch_inds: np.ndarray, env: VecNormalize | None = None
    ) -> ReplayBufferSamples | DictReplayBufferSamples:
        self._check_ends(env)
        # the library samples from numpy's global stream, and nowhere else
        state = np.random.get_state()  # noqa: NPY002
        samples = super()._get_samples(batch_inds, env)
        np.random.set_state(state)  # noqa: NPY002
        # the first sample inside, which says from which environment each row comes, once more
        columns = np.random.randint(0, self.n_envs, size=len(batch_inds))  # noqa: NPY002
        transition = self.transition(batch_inds, columns)
        self.attachment.to(self.device).learn(transition, samples.observations)
        bonus = self._compute_bonus(transition, batch_inds, columns)
        return samples._replace(rewards=samples.rewards + bonus.unsqueeze(-1))

    def _compute_bonus(
        self, transition: Transition, rows: np.ndarray, columns: np.ndarray
    ) -> Tensor:
        """What is added to the rewards of a batch, which the bonus has just learned from."""
        return self.attachment.compute(transition)


class CuriousNStepReplayBuffer(CuriousReplayBuffer, NStepReplayBuffer):  # type: ignore[misc]
    """The same with returns of several steps: the bonus of each step is discounted and summed.

    Args:
        *args: As for `CuriousReplayBuffer`.
        n_steps: Steps of which rewards and bonuses are summed.
        gamma: Discount of the agent, to be repeated here.
        **options: As for `CuriousReplayBuffer`.

    Raises:
        TypeError: As `CuriousReplayBuffer`, or if `n_steps` is no whole number.
        ValueError: As `CuriousReplayBuffer`, or if `n_steps` is below 1 or `gamma` no discount.
    """

    def __init__(
        self, *args: Any, n_steps: int = 3, gamma: float | int = 0.99, **options: Any
    ) -> None:
        check_counts(n_steps=n_steps)
        if not (is_number(gamma) and 0 <= gamma <= 1):
            raise ValueError(f"`gamma` must be a number from 0 to 1, got {gamma!r}.")
        super().__init__(*args, n_steps=n_steps, gamma=gamma, **options)

    def _compute_bonus(
        self, transition: Transition, rows: np.ndarray, columns: np.ndarray
    ) -> Tensor:
        steps = (rows[:, None] + np.arange(self.n_steps)) % self.buffer_size  # batch n_steps
        columns = np.broadcast_to(columns[:, None], steps.shape)
        summed = self._before_the_end(steps, columns)
        bonus = torch.zeros(steps.shape, device=self.device)
        transition = self.transition(steps[summed], columns[summed])
        bonus[mask_of(summed, self.device)] = self.attachment.compute(transition)
        discounts = self.gamma ** np.arange(self.n_steps, dtype=np.float32)
        return bonus @ batch_of(discounts, self.device)

    def _before_the_end(self, steps: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Which steps the return sums: none after the end of an episode or of what is stored."""
        newest = (self.pos - 1) % self.buffer_size
        last = (self.dones[steps, columns] + self.timeouts[steps, columns] > 0) | (steps == newest)
        return np.cumsum(last, axis=1) - last == 0


class CuriousDictReplayBuffer(CuriousReplayBuffer, DictReplayBuffer):  # type: ignore[misc]
    """The same for dictionary observations, of which the bonus is about one entry.

    Args:
        *args: As for `CuriousReplayBuffer`, of which `observation_key` must now be given.
        **options: As for `CuriousReplayBuffer`.
    """


def _row(observations: Any, index: int) -> Any:
    """One of all stored observations, of dictionaries of arrays too."""
    if isinstance(observations, dict):
        return {name: column[index] for name, column in observations.items()}
    return observations[index]


def _equal(stored: Any, observation: Any) -> np.ndarray:
    """In which environments an observation is the one that is stored."""
    if isinstance(stored, dict):
        return np.all([_equal(stored[name], observation[name]) for name in stored], axis=0)
    other = np.asarray(observation, stored.dtype).reshape(stored.shape)
    same = (stored == other) | (stored != stored)  # what is no number equals nothing
    return np.asarray(same.reshape(len(stored), -1).all(1))


def _write(observations: Any, index: int, observation: Any) -> None:
    """Put the observation of one environment in its place, in a dictionary of arrays too."""
    if isinstance(observations, dict):
        for name, column in observations.items():
            column[index] = observation[name]
    else:
        observations[index] = observation
