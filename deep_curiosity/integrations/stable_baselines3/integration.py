"""Agents of Stable-Baselines3 as the check of an integration handles them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_pkl, save_to_pkl
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.base import Integration
from deep_curiosity.integrations.stable_baselines3.attachment import BonusAttachment
from deep_curiosity.integrations.stable_baselines3.callback import CuriosityCallback
from deep_curiosity.integrations.stable_baselines3.normalization import raw_part
from deep_curiosity.integrations.stable_baselines3.recording import postponed, recorded
from deep_curiosity.integrations.stable_baselines3.replay import CuriousReplayBuffer
from deep_curiosity.integrations.stable_baselines3.rollout import CuriousRolloutBuffer
from deep_curiosity.transitions import Transition

Agent = TypeVar("Agent", bound=BaseAlgorithm)
MODEL, BUFFER = "model.zip", "buffer.pkl"
LOGGING = ("_logger", "_custom_logger")
"""Attributes of an agent that are others while it is checked."""


class _Integration(Integration, Generic[Agent]):
    """What agents with replay and agents with rollouts have in common.

    Args:
        model: An agent with a curious buffer.
        make_env: Makes an environment like that of the agent, for a loaded one.

    Raises:
        TypeError: If the agent has no such buffer, or nothing makes an environment.
        ValueError: If the agent has no environment.
    """

    buffer_name: str
    """Attribute of the agent."""
    buffer_class: type
    elsewhere: str
    """Which agents have another buffer, and where they are checked."""

    def __init__(self, model: Agent, make_env: Callable[[], Any]) -> None:
        self._check_buffer(model)
        if model.get_env() is None:
            raise ValueError("`model` must have an environment, as set_env gives it, got None.")
        if not callable(make_env):
            raise TypeError(
                f"`make_env` must be a function that makes an environment, got {make_env!r}."
            )
        self.model = model
        self.make_env = make_env
        self._of_the_user: tuple[Any, ...] | None = None  # known while the check has changed it

    @property
    def bonus(self) -> Bonus:
        """The bonus in use, not a copy."""
        return self._attachment.learner.bonus

    def collect(self, num_steps: int, *, seed: int) -> Transition:
        """Reset the environments, and let the agent act for some steps of all of them."""
        env = self.model.get_env()
        assert env is not None
        self._remember()
        with self._quiet(), recorded(raw_part(env), self._attachment) as steps:
            self.model.set_random_seed(seed)
            _, callback = self.model._setup_learn(num_steps, CuriosityCallback())
            callback.on_training_start({}, {})
            self._act(env, callback, num_steps)
        return Transition(*(torch.cat(field) for field in zip(*steps, strict=True)))

    def release(self) -> None:
        """Give the agent its count of steps, its random actions and the bonus its actor back."""
        if self._of_the_user is not None:
            self.model.num_timesteps, random, self._attachment.actor = self._of_the_user
            self.model.action_space._np_random = random
            self._of_the_user = None

    def _remember(self) -> None:
        """Keep what collecting changes of the agent, as it was before the first time."""
        if self._of_the_user is None:
            random = self.model.action_space._np_random  # which seeding replaces
            self._of_the_user = self.model.num_timesteps, random, self._attachment.actor

    @classmethod
    def _check_buffer(cls, model: Agent) -> None:
        """Reject an agent whose buffer has no bonus, or that is for the other class."""
        buffer = getattr(model, cls.buffer_name, None)
        if not isinstance(buffer, cls.buffer_class):
            found = f"with {type(buffer).__name__}"
            if buffer is None:
                found = f"without `{cls.buffer_name}`"
            raise TypeError(
                f"`model` must have `{cls.buffer_name}_class={cls.buffer_class.__name__}` or one "
                f"like it ({cls.elsewhere}), got {type(model).__name__} {found}."
            )

    @contextmanager
    def _quiet(self) -> Iterator[None]:
        """Let the agent log nothing meanwhile."""
        own = vars(self.model)
        before = {name: own[name] for name in LOGGING if name in own}
        self.model.set_logger(configure(format_strings=[]))
        try:
            yield
        finally:
            for name in LOGGING:
                del own[name]
            own.update(before)

    def save(self, folder: Path) -> None:
        """Save agent and buffer, and with the buffer the bonus."""
        self.model.save(folder / MODEL)
        save_to_pkl(folder / BUFFER, self._buffer)

    @property
    def _buffer(self) -> Any:
        raise NotImplementedError

    @property
    def _attachment(self) -> BonusAttachment:
        attachment: BonusAttachment = self._buffer.attachment
        return attachment

    def _act(self, env: VecEnv, callback: Any, num_steps: int) -> None:
        raise NotImplementedError


class StableBaselinesIntegration(_Integration[OffPolicyAlgorithm]):
    """SAC, TD3, DDPG, TQC or CrossQ with a curious replay buffer.

    Args:
        model: An agent with a curious buffer, best made for the check, which changes it.
        make_env: Makes an environment like that of the agent, for a loaded one; in the same
            vector wrappers, if there are any.

    Raises:
        TypeError: If the agent has no such buffer, or nothing makes an environment.
        ValueError: If the agent has no environment.
    """

    buffer_name = "replay_buffer"
    buffer_class = CuriousReplayBuffer
    elsewhere = "PPO and A2C are for StableBaselinesOnPolicyIntegration"

    def stored(self) -> Transition:
        """All that is stored, oldest first, the environments of a step in their order."""
        buffer = self._buffer
        rows = np.arange(buffer.size()) + (buffer.pos if buffer.full else 0)
        rows = np.repeat(rows % buffer.buffer_size, buffer.n_envs)
        return buffer.transition(rows, np.tile(np.arange(buffer.n_envs), buffer.size()))

    def learn(self, *, seed: int) -> None:
        """Update the critic until the actor, which may wait for it, was updated once."""
        set_random_seed(seed)
        num_updates = getattr(self.model, "policy_delay", 1)
        with self._quiet():
            self.model.train(gradient_steps=num_updates, batch_size=self.model.batch_size)

    def critic(self) -> list[Tensor]:
        """Parameters of the critics, not of their slow copies."""
        return list(self.model.critic.parameters())  # type: ignore[attr-defined]

    def actor(self) -> list[Tensor]:
        """Parameters of the actor."""
        return list(self.model.actor.parameters())

    def load(self, folder: Path) -> "StableBaselinesIntegration":
        """Another agent, as `save` left it."""
        model = type(self.model).load(folder / MODEL, env=self.make_env())
        model.load_replay_buffer(folder / BUFFER)
        callback = CuriosityCallback()  # gives the bonus the loaded actor, as collecting does
        callback.init_callback(model)
        callback.on_training_start({}, {})
        return StableBaselinesIntegration(model, self.make_env)

    @property
    def _buffer(self) -> CuriousReplayBuffer:
        assert isinstance(self.model.replay_buffer, CuriousReplayBuffer)
        return self.model.replay_buffer

    def _act(self, env: VecEnv, callback: Any, num_steps: int) -> None:
        train_freq = TrainFreq(num_steps, TrainFrequencyUnit.STEP)
        noise = self.model.action_noise
        self.model.collect_rollouts(env, callback, train_freq, self._buffer, action_noise=noise)


class StableBaselinesOnPolicyIntegration(_Integration[OnPolicyAlgorithm]):
    """PPO or A2C with a curious rollout buffer; a rollout is as long as what is collected.

    Args:
        model: As for `StableBaselinesIntegration`.
        make_env: As for `StableBaselinesIntegration`.

    Raises:
        TypeError: If the agent has no such buffer, or nothing makes an environment.
        ValueError: If the agent has no environment.
    """

    buffer_name = "rollout_buffer"
    buffer_class = CuriousRolloutBuffer
    elsewhere = "agents with replay are for StableBaselinesIntegration"

    def __init__(self, model: OnPolicyAlgorithm, make_env: Callable[[], Any]) -> None:
        super().__init__(model, make_env)
        self._num_steps = model.n_steps, self._buffer.buffer_size

    def release(self) -> None:
        """Give the agent its length of rollouts back too."""
        super().release()
        self.model.n_steps, self._buffer.buffer_size = self._num_steps
        self._buffer.reset()

    def stored(self) -> Transition:
        """All that is stored, oldest first, the environments of a step in their order."""
        return self._buffer.transition()

    def learn(self, *, seed: int) -> None:
        """Let bonus and agent learn from the rollout, as after its collection."""
        set_random_seed(seed)
        buffer = self._buffer
        rollout = vars(buffer).copy()
        last_values = self.model.policy.predict_values(self._last_observation).detach()
        dones = self.model._last_episode_starts
        assert dones is not None
        buffer.compute_returns_and_advantage(last_values, dones)
        with self._quiet():
            self.model.train()
        vars(buffer).update(rollout)  # training has reordered it

    def critic(self) -> list[Tensor]:
        """Parameters of the value network."""
        policy = self.model.policy
        parts = (policy.mlp_extractor.value_net, policy.value_net)
        return [parameter for part in parts for parameter in part.parameters()]

    def actor(self) -> list[Tensor]:
        """Parameters of the policy network, without its state-independent width."""
        policy = self.model.policy
        parts = (policy.mlp_extractor.policy_net, policy.action_net)
        return [parameter for part in parts for parameter in part.parameters()]

    def load(self, folder: Path) -> "StableBaselinesOnPolicyIntegration":
        """Another agent, as `save` left it."""
        env = self.make_env()
        # without a reset, since the last observation of the rollout is still needed
        model = type(self.model).load(folder / MODEL, env=env, force_reset=False)
        model.rollout_buffer = load_from_pkl(folder / BUFFER)
        model.rollout_buffer.device = model.device
        return StableBaselinesOnPolicyIntegration(model, self.make_env)

    @property
    def _buffer(self) -> CuriousRolloutBuffer:
        assert isinstance(self.model.rollout_buffer, CuriousRolloutBuffer)
        return self.model.rollout_buffer

    @property
    def _last_observation(self) -> Any:
        observation, _ = self.model.policy.obs_to_tensor(self.model._last_obs)  # type: ignore[arg-type]
        return observation

    def _act(self, env: VecEnv, callback: Any, num_steps: int) -> None:
        buffer = self._buffer
        self.model.n_steps = buffer.buffer_size = num_steps
        with postponed(buffer, "compute_returns_and_advantage"):  # the bonus learns there
            self.model.collect_rollouts(env, callback, buffer, num_steps)
