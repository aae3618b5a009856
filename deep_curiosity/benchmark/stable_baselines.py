"""Stable-Baselines3's soft actor-critic as a runner, or one built on it: a pattern of adapters."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("stable_baselines3", extra="sb3")

from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from deep_curiosity.benchmark.own_agent import NUM_RANDOM_STEPS
from deep_curiosity.speed.machine import MatmulPrecision


class StableBaselines:
    """Its defaults are those of the benchmark: two layers of 256, batch 256, an update a step.

    Args:
        env_id: Task.
        precision: Of matrix products; torch's own default is `"highest"`.
        device: Of networks and updates.
        hidden_dim: Width of both layers.
        agent_class: Stable-Baselines3's agent, or one that is built as it is.
        **options: Further arguments of the agent.
    """

    def __init__(
        self,
        env_id: str,
        precision: MatmulPrecision = "highest",
        device: str = "cpu",
        hidden_dim: int = 256,
        *,
        agent_class: type[OffPolicyAlgorithm] = SAC,
        **options: Any,
    ) -> None:
        torch.set_float32_matmul_precision(precision)
        self._environment = gymnasium.make(env_id)
        self._agent = agent_class(
            policy="MlpPolicy",
            env=self._environment,
            learning_starts=0,
            seed=0,
            device=device,
            policy_kwargs={"net_arch": [hidden_dim, hidden_dim]},
            **options,
        )

    def fill(self, num_transitions: int) -> None:
        """Take some random steps, and repeat them in replay."""
        transitions: list[tuple[Any, ...]] = []
        observation, _ = self._environment.reset(seed=0)
        for _ in range(min(num_transitions, NUM_RANDOM_STEPS)):
            action = self._environment.action_space.sample()
            next_observation, reward, terminated, truncated, _ = self._environment.step(action)
            outcome = np.array([reward]), np.array([terminated])
            transitions.append((observation, next_observation, action, *outcome, [{}]))
            observation = next_observation
            if terminated or truncated:
                observation, _ = self._environment.reset()
        buffer = self._agent.replay_buffer
        assert buffer is not None
        for number in range(num_transitions):
            buffer.add(*transitions[number % len(transitions)])

    def step(self, num_steps: int) -> None:
        """Take environment steps, each followed by one update."""
        self._agent.learn(num_steps, reset_num_timesteps=False)
