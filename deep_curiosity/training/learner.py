"""The learner: agent, bonus, its optimiser and replay, assembled from settings."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from deep_curiosity.actor_critic import Reflex
from deep_curiosity.agent import CuriousActorCritic
from deep_curiosity.bonus import Bonus
from deep_curiosity.compilation import compiled
from deep_curiosity.curiosity import CuriosityBonus
from deep_curiosity.optimization import Adam
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.rivals import ConstantBonus
from deep_curiosity.training.collection import EnvironmentStep, EnvironmentSteps, as_batch
from deep_curiosity.training.machine import should_compile
from deep_curiosity.training.settings import Settings
from deep_curiosity.transitions import Transition


class Learner:
    """Everything that learns, and the replay it learns from.

    Args:
        settings: Of the run.
        observation_dim: Length of an observation.
        action_dim: Length of an action.
    """

    def __init__(self, settings: Settings, observation_dim: int, action_dim: int) -> None:
        self.settings = settings
        self.agent = make_agent(settings, observation_dim, action_dim)
        self.bonus = make_bonus(settings, observation_dim, action_dim)
        self.agent.to(settings.device)
        if self.bonus is not None:
            self.bonus.to(settings.device)
        parameters = [] if self.bonus is None else list(self.bonus.parameters())
        self.bonus_optimizer = (
            Adam(parameters, settings.model_learning_rate) if parameters else None
        )
        self.replay = ReplayBuffer(
            settings.replay_capacity,
            observation_dim,
            action_dim,
            seed=settings.seed,
            device=settings.device,
        )
        quick = settings.policy_modes == 1 and self.agent.log_temperature.device.type == "cpu"
        self._reflex = Reflex(self.agent.policy) if quick else None
        self._learn = self._learn_eagerly
        if should_compile(settings):
            self._learn = compiled(self._learn_eagerly, fall_back=settings.compile == "auto")

    def act(self, observation: np.ndarray, *, explore_uniformly: bool = False) -> np.ndarray:
        """Draw actions in [-1, 1] from the policy, or from the whole action box.

        Args:
            observation: `(observation_dim,)`, or `(num_envs, observation_dim)` for an action each.
            explore_uniformly: Leave the policy aside.
        """
        shape = (*observation.shape[:-1], self.agent.action_dim)
        if explore_uniformly:
            return (2 * torch.rand(shape) - 1).numpy()
        if self._reflex is not None and observation.ndim == 1:
            noise = torch.randn(self.agent.action_dim).numpy()
            return self._reflex.act(observation.astype(np.float32), noise)
        batch = as_batch(observation).to(self.settings.device)
        return self.agent.act(batch).reshape(shape).cpu().numpy()

    def act_deterministically(self, observation: Tensor) -> Tensor:
        """Centre of the policy at each observation."""
        return self.agent.act(observation.to(self.settings.device), deterministic=True).cpu()

    def store(self, step: EnvironmentStep | EnvironmentSteps) -> None:
        """Keep the step of one world, or of several, in replay."""
        if isinstance(step, EnvironmentSteps):
            self.replay.extend(*step)
        else:
            self.replay.add(*step)

    def update(self) -> dict[str, Tensor]:
        """One gradient step on the bonus's models and on every part of the agent."""
        transition = self.replay.sample(self.settings.batch_size)
        if self.bonus is not None:
            self.bonus.observe(transition, self.agent.act)
        return self._learn(transition)

    def _learn_eagerly(self, transition: Transition) -> dict[str, Tensor]:
        """The part of an update that can be one graph; returns what to log."""
        metrics = {}
        if self.bonus is not None:
            loss = self.bonus.loss(transition)
            if self.bonus_optimizer is not None:
                self.bonus_optimizer.step(loss)
            metrics["curiosity/model_loss"] = loss.detach()
        agent_metrics = self.agent.update(transition, self.bonus)
        return metrics | {f"agent/{name}": value for name, value in agent_metrics.items()}

    def diagnostics(self) -> dict[str, Tensor]:
        """What agent and bonus say of themselves; costs a few milliseconds."""
        metrics = {f"agent/{name}": value for name, value in self.agent.metrics().items()}
        if self.bonus is not None:
            metrics |= {f"curiosity/{name}": value for name, value in self.bonus.metrics().items()}
        return metrics

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimisers, statistics, replay and the state of the random generators."""
        return {
            "agent": self.agent.state_dict(),
            "bonus": self.bonus.state_dict() if self.bonus is not None else {},
            "bonus_optimizer": self.bonus_optimizer.state_dict() if self.bonus_optimizer else {},
            "replay": self.replay.state_dict(),
            "random": torch.get_rng_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self.agent.load_state_dict(state["agent"])
        if self.bonus is not None:
            self.bonus.load_state_dict(state["bonus"])
        if self.bonus_optimizer is not None:
            self.bonus_optimizer.load_state_dict(state["bonus_optimizer"])
        self.replay.load_state_dict(state["replay"])
        torch.set_rng_state(state["random"])


def make_agent(settings: Settings, observation_dim: int, action_dim: int) -> CuriousActorCritic:
    """Agent of a run."""
    return CuriousActorCritic(
        observation_dim,
        action_dim,
        hidden_dims=(settings.hidden_dim, settings.hidden_dim),
        policy_modes=settings.policy_modes,
        discount=settings.discount,
        curiosity=settings.bonus != "none",
        curiosity_discount=settings.curiosity_discount,
        hunger=settings.hunger,
        yielding=settings.yielding,
        prior=settings.prior,
        temperature=settings.temperature,
        tune_temperature=settings.tune_temperature,
        target_information_rate=settings.target_information_rate,
        learning_rate=settings.learning_rate,
        polyak=settings.polyak,
    )


def make_bonus(settings: Settings, observation_dim: int, action_dim: int) -> Bonus | None:
    """Bonus of a run, or `None` for plain soft actor-critic."""
    if settings.bonus == "none":
        return None
    if settings.bonus == "constant":
        return ConstantBonus(settings.bonus_weight)
    return CuriosityBonus(
        observation_dim,
        action_dim,
        weight=settings.bonus_weight,
        members=settings.members,
        outcomes=settings.outcomes,
        hidden_dims=(settings.hidden_dim, settings.hidden_dim),
        noise_floor=settings.noise_floor,
        components=settings.components,
        bandwidth=settings.bandwidth,
        refresh_interval=settings.refresh_interval,
        member_per_row=settings.member_per_row,
    )
