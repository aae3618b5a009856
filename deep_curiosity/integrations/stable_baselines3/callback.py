"""The callback that connects a curious buffer with its agent and with the logger."""

from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import PyTorchObs
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.stable_baselines3.normalization import (
    check_order,
    end_of,
    keep_raw_ends,
)
from deep_curiosity.integrations.stable_baselines3.replay import (
    CuriousNStepReplayBuffer,
    CuriousReplayBuffer,
)
from deep_curiosity.integrations.stable_baselines3.rollout import CuriousRolloutBuffer
from deep_curiosity.nn.networks import evaluating
from deep_curiosity.transitions import check_counts


class CuriosityCallback(BaseCallback):
    """Gives the bonus fresh actions of the agent, and logs the bonus under `curiosity/`.

    For SAC and its kin it may be left out: the bonus then takes a batch's own actions for what the
    agent would do now, and nothing is logged. It must be there where `VecNormalize` clips the end
    of an episode, which only it keeps; and for PPO and A2C, since only it is given the true next
    observation where an episode ended.

    Args:
        log_interval: Least number of environment steps from one record to the next. What is
            recorded is written with the library's own logs.

    Raises:
        TypeError: When learning starts, if the agent has no curious buffer.
        ValueError: If the interval is below 1, or, when learning starts, if a buffer of several
            steps has another discount than its agent, or something above `VecNormalize` changes
            observations.
    """

    def __init__(self, log_interval: int = 1_000) -> None:
        super().__init__()
        check_counts(log_interval=log_interval)
        self.log_interval = log_interval
        self._next_record = 0
        self._observation: Any = None

    def _on_training_start(self) -> None:
        self._next_record = self.num_timesteps
        buffer = self._buffer
        check_order(self.training_env, buffer.attachment.observation_key)
        keep_raw_ends(self.training_env)
        self._save_bonus_in_use(buffer.bonus)
        if isinstance(buffer, CuriousRolloutBuffer):
            self._observation = deepcopy(self._raw(self.model._last_obs))
        else:
            self._check_discount(buffer)
            buffer.attachment.actor = partial(_act, self.model)

    def _on_step(self) -> bool:
        buffer = self._buffer
        if isinstance(buffer, CuriousRolloutBuffer):
            self._record_step(buffer)
        return True

    def _on_rollout_end(self) -> None:
        attachment = self._buffer.attachment
        if self.num_timesteps >= self._next_record and attachment.has_learned:
            self._next_record = self.num_timesteps + self.log_interval
            for name, value in attachment.metrics().items():
                self.logger.record(f"curiosity/{name}", value)

    def _on_training_end(self) -> None:
        """Let the agent go on from where the environment stands.

        Where a callback stops a rollout, the library does not tell the agent of the last step.
        """
        if "new_obs" in self.locals:
            self.model._last_obs = self.locals["new_obs"]
            self.model._last_episode_starts = self.locals["dones"]
            self.model._last_original_obs = self._raw(self.model._last_obs)

    @property
    def _buffer(self) -> CuriousReplayBuffer | CuriousRolloutBuffer:
        for name in ("replay_buffer", "rollout_buffer"):
            buffer = getattr(self.model, name, None)
            if isinstance(buffer, CuriousReplayBuffer | CuriousRolloutBuffer):
                return buffer
        raise TypeError(
            "CuriosityCallback needs a curious buffer: give the agent "
            "`replay_buffer_class=CuriousReplayBuffer` or "
            "`rollout_buffer_class=CuriousRolloutBuffer`."
        )

    def _save_bonus_in_use(self, bonus: Bonus) -> None:
        """Put the bonus among the options that are saved; a loaded buffer has brought its own."""
        for name in ("replay_buffer_kwargs", "rollout_buffer_kwargs"):
            options = getattr(self.model, name, {})
            if isinstance(options.get("bonus"), Bonus):
                setattr(self.model, name, {**options, "bonus": bonus})

    def _check_discount(self, buffer: CuriousReplayBuffer) -> None:
        discount = self.model.gamma  # type: ignore[attr-defined]
        if isinstance(buffer, CuriousNStepReplayBuffer) and buffer.gamma != discount:
            raise ValueError(
                f"`gamma` of the replay buffer must be that of the agent, {discount}, "
                f"got {buffer.gamma}."
            )

    def _record_step(self, buffer: CuriousRolloutBuffer) -> None:
        next_observation = self._raw(self.locals["new_obs"])
        infos, done = self.locals["infos"], self.locals["dones"]
        select = buffer.attachment.select_observation
        final = np.array(select(next_observation))
        for index in np.flatnonzero(done):  # the environment has been reset since
            final[index] = select(end_of(infos[index]))
        timeout = np.array([info.get("TimeLimit.truncated", False) for info in infos])
        actions = self.locals["clipped_actions"]
        buffer.record(select(self._observation), actions, self._raw_reward(), final, done, timeout)
        self._observation = deepcopy(next_observation)  # some environments go on to change it

    def _raw(self, observation: Any) -> Any:
        """The newest observation, in the units of the environment."""
        normalize = self.model.get_vec_normalize_env()
        return observation if normalize is None else normalize.get_original_obs()

    def _raw_reward(self) -> np.ndarray:
        normalize = self.model.get_vec_normalize_env()
        reward: np.ndarray = self.locals["rewards"]
        return reward if normalize is None else normalize.get_original_reward()


@torch.no_grad()
def _act(model: BaseAlgorithm, observation: PyTorchObs) -> Tensor:
    """What the agent would do now, as it is stored: within [-1, 1]."""
    actor = model.actor  # type: ignore[attr-defined]
    with evaluating(actor):
        action: Tensor = actor(observation)
    return action
