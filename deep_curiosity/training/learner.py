"""The learner: agent, bonus, its optimiser and replay, assembled from settings."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deep_curiosity.agent.policy import NumpyPolicy
from deep_curiosity.agent.sac import BonusFunction, CuriousSAC
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.registry import BonusLearner, make_bonus
from deep_curiosity.speed.compile import compiled
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.schedules import Schedule
from deep_curiosity.training.collector import (
    EnvironmentStep,
    EnvironmentSteps,
    Info,
    Policy,
    as_batch,
)
from deep_curiosity.training.exploration import NOISES, Noise
from deep_curiosity.training.hunger import HungerController, HungerFunction, make_hunger_controller
from deep_curiosity.speed.machine import should_compile
from deep_curiosity.training.config import Settings
from deep_curiosity.transitions import Sequences, Transition, first_of

NUM_DIAGNOSED_STATES = 512  # of replay, over which the information of the actions is estimated


class Learner:
    """Everything that learns, and the replay it learns from.

    Args:
        settings: Of the run.
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        sense: The caller's own sense of hunger.
    """

    def __init__(
        self,
        settings: Settings,
        observation_dim: int,
        action_dim: int,
        sense: HungerFunction | None = None,
    ) -> None:
        self.settings = settings
        self.hunger_controller = make_hunger_controller(settings, observation_dim, sense)
        self.agent = make_agent(settings, observation_dim, action_dim)
        self.bonus = make_run_bonus(settings, observation_dim, action_dim)
        self.noise = (
            None
            if settings.exploration == "policy"
            else NOISES[settings.exploration](settings.num_envs, action_dim)
        )
        self.bonus_learner = (
            None
            if self.bonus is None
            else BonusLearner(self.bonus, learning_rate=settings.model_learning_rate)
        )
        self.agent.to(settings.device)
        if self.bonus_learner is not None:
            self.bonus_learner.to(settings.device)
        self.replay = ReplayBuffer(
            settings.replay_capacity,
            observation_dim,
            action_dim,
            seed=settings.seed,
            device=settings.device,
        )
        self.act_deterministically = evaluation_policy(self.agent, self.hunger_controller, settings.device)
        quick = (
            settings.policy_modes == 1
            and self.agent.log_temperature.device.type == "cpu"
            and self.noise is None
        )
        self._temperature = make_temperature_schedule(settings)
        self._hunger = torch.full((settings.num_envs,), self.agent.hunger)
        self._told_hunger: list[float] = []  # by the hunger_controller, and passed on to the agent
        self._numpy_policy = NumpyPolicy(self.agent.policy) if quick else None
        self._numpy_noise = torch.empty(action_dim)  # drawn anew for every action
        self._learn = self._learn_eagerly
        if should_compile(settings):
            self._learn = compiled(
                self._learn_eagerly,
                device=settings.device,
                fall_back=settings.compile == "auto",
            )

    def turn(self, step: int, observation: np.ndarray, info: Info) -> None:
        """Set what goes with time, or with what is seen, before a step is taken.

        Args:
            step: Environment steps taken so far.
            observation: `(observation_dim,)`, or `(num_envs, observation_dim)`.
            info: What the worlds say with it.
        """
        hunger = self.hunger_controller.hunger(step, observation.reshape(-1, observation.shape[-1]), info)
        told = hunger.tolist()
        if told != self._told_hunger:
            self._told_hunger = told
            self._hunger = torch.as_tensor(hunger, dtype=torch.float32)
            self.agent.hunger = float(hunger.mean())
        if self._temperature is not None:
            self.agent.temperature = self._temperature(step)
        ends = self.settings.curiosity_ends
        if ends is not None and step >= ends:
            self.agent.curiosity_weight = 0.0

    def act(self, observation: np.ndarray, *, explore_uniformly: bool = False) -> np.ndarray:
        """Draw actions in [-1, 1] from the policy, or from the whole action box.

        Args:
            observation: `(observation_dim,)`, or `(num_envs, observation_dim)` for an action each.
            explore_uniformly: Leave the policy aside.
        """
        shape = (*observation.shape[:-1], self.agent.action_dim)
        if explore_uniformly:
            return (2 * torch.rand(shape) - 1).numpy()
        if self._numpy_policy is not None and observation.ndim == 1:
            noise = self._numpy_noise.normal_().numpy()
            seen = observation.astype(np.float32)
            if self.agent.dial:
                seen = np.append(seen, self._hunger.numpy())
            return self._numpy_policy.act(seen, noise)
        batch = as_batch(observation).to(self.settings.device)
        hunger = self._hunger.to(self.settings.device)
        if self.noise is None:
            action = self.agent.act(batch, hunger=hunger)
        else:
            action = self._explore(self.agent.seen(batch, hunger), self.noise)
        return action.reshape(shape).cpu().numpy()

    @torch.no_grad()
    def _explore(self, seen: Tensor, noise: Noise) -> Tensor:
        """Actions of the policy under a noise that is not its own."""
        hidden = self.agent.policy.hidden(seen)
        drawn = noise.draw(hidden).to(hidden.device)
        return torch.tanh(self.agent.policy.at(hidden).pre_actions(drawn.unsqueeze(0)))[0]

    def store(self, step: EnvironmentStep | EnvironmentSteps) -> None:
        """Keep the step of one world, or of several, in replay."""
        if isinstance(step, EnvironmentSteps):
            self.replay.extend(*step)
        else:
            self.replay.add(*step)
        ended = np.atleast_1d(np.logical_or(step.terminated, step.truncated))
        self.hunger_controller.record(np.atleast_1d(step.reward), ended)
        if self.noise is not None:
            for world in np.flatnonzero(ended):
                self.noise.begin(int(world))

    def update(self) -> dict[str, Tensor]:
        """One gradient step on the bonus's models and on every part of the agent."""
        batch = self._sample()
        if self.bonus is not None and not self.bonus.passes():
            self._show(self.bonus, first_of(self._in_fields(batch)))
        return self._learn(batch)

    def _sample(self) -> Tensor | Sequences:
        """Rows of transitions, or sequences where more than one step is summed."""
        num_steps, size = max(self.agent.num_steps), self.settings.batch_size
        if num_steps == 1:
            return self.replay.sample_rows(size)
        return self.replay.sample_sequences(size, num_steps, stride=self.settings.num_envs)

    def _in_fields(self, batch: Tensor | Sequences) -> Transition | Sequences:
        return self.replay.transition(batch) if isinstance(batch, Tensor) else batch

    def _show(self, bonus: Bonus, transition: Transition) -> None:
        """Let the bonus observe a batch, and the newest transitions where it asks for them."""
        if isinstance(bonus, CuriosityBonus):
            bonus.observe(transition, self.agent.act, self._visited())
        else:
            bonus.observe(transition, self.agent.act)

    def _visited(self) -> Transition | None:
        """What the marginal is formed from, where that is not the batch."""
        horizon, size = self.settings.marginal_horizon, self.settings.batch_size
        if horizon is None:
            return None
        if self.settings.marginal_forgetting == "window":
            return self.replay.sample_newest(size, window=horizon)
        return self.replay.sample_fading(size, half_life=horizon)

    def _learn_eagerly(self, drawn: Tensor | Sequences) -> dict[str, Tensor]:
        """The part of an update that can be one graph; returns what to log."""
        batch = self._in_fields(drawn)
        bonus = self._answered(batch)
        metrics = {}
        if self.bonus_learner is not None:
            metrics["curiosity/model_loss"] = self.bonus_learner.fit(first_of(batch))
        agent_metrics = self.agent.update(batch, bonus)
        return metrics | {f"agent/{name}": value for name, value in agent_metrics.items()}

    def _answered(self, batch: Transition | Sequences) -> BonusFunction | None:
        """The bonus, or its answer to all that the agent will ask of it.

        BonusFunction before the models learn, it needs no pass of its own in a graph; and they learn while
        the pass is at hand.
        """
        if self.bonus_learner is None or not self.agent.has_curiosity_critic:
            return self.bonus
        answer = self.bonus_learner.ask(batch.steps if isinstance(batch, Sequences) else batch)
        return lambda *_: answer

    def diagnostics(self) -> dict[str, Tensor]:
        """What agent and bonus say of themselves; costs a few milliseconds."""
        visited = self.replay.spread(NUM_DIAGNOSED_STATES).observation
        metrics = {f"agent/{name}": value for name, value in self.agent.metrics(visited).items()}
        if self.bonus is not None:
            metrics |= {f"curiosity/{name}": value for name, value in self.bonus.metrics().items()}
        return metrics

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimisers, statistics, replay and the state of the random generators."""
        return {
            "agent": self.agent.state_dict(),
            "bonus": {} if self.bonus_learner is None else self.bonus_learner.state_dict(),
            "noise": {} if self.noise is None else self.noise.state_dict(),
            "hunger_controller": self.hunger_controller.state_dict(),
            "replay": self.replay.state_dict(),
            "random": self._random_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self.agent.load_state_dict(state["agent"])
        if self.bonus_learner is not None:
            self.bonus_learner.load_state_dict(state["bonus"])
        if self.noise is not None:
            self.noise.load_state_dict(state["noise"])
        self.hunger_controller.load_state_dict(state["hunger_controller"])
        self._told_hunger = []
        self.replay.load_state_dict(state["replay"])
        torch.set_rng_state(state["random"]["cpu"])
        if "cuda" in state["random"]:
            torch.cuda.set_rng_state(state["random"]["cuda"], self.settings.device)

    def _random_state(self) -> dict[str, Tensor]:
        """Of the global generators that the run draws from."""
        state = {"cpu": torch.get_rng_state()}
        if torch.device(self.settings.device).type == "cuda":
            state["cuda"] = torch.cuda.get_rng_state(self.settings.device)
        return state


def evaluation_policy(agent: CuriousSAC, hunger_controller: HungerController, device: str = "cpu") -> Policy:
    """Centre of the agent's policy, at the hunger of an evaluation."""

    def act(observation: Tensor, info: Info) -> Tensor:
        sensed = hunger_controller.in_evaluation(observation.numpy(), info)
        hunger = torch.as_tensor(sensed, dtype=torch.float32, device=device)
        return agent.act(observation.to(device), deterministic=True, hunger=hunger).cpu()

    return act


def make_agent(settings: Settings, observation_dim: int, action_dim: int) -> CuriousSAC:
    """Agent of a run."""
    return CuriousSAC(
        observation_dim,
        action_dim,
        hidden_dims=(settings.hidden_dim, settings.hidden_dim),
        policy_modes=settings.policy_modes,
        discount=settings.discount,
        curiosity=settings.bonus != "none",
        curiosity_discount=settings.curiosity_discount,
        reward_steps=settings.reward_steps,
        curiosity_steps=settings.curiosity_steps,
        curiosity_episodic=settings.curiosity_episodic,
        hunger=settings.hunger,
        dial=settings.has_dial,
        yielding=settings.yielding,
        prior=settings.prior,
        temperature=settings.temperature,
        tune_temperature=settings.temperature_control == "rate",
        target_information_rate=settings.target_information_rate,
        learning_rate=settings.learning_rate,
        actor_stride=settings.actor_stride,
        critic_per_row=settings.critic_per_row,
        polyak=settings.polyak,
    )


def make_temperature_schedule(settings: Settings) -> Schedule | None:
    """Schedule of the temperature, `None` where it stays or is tuned."""
    match settings.temperature_control:
        case "rate" | "constant":
            return None
        case shape:
            return Schedule(
                settings.temperature, settings.final_temperature, settings.total_steps, shape
            )


def make_run_bonus(settings: Settings, observation_dim: int, action_dim: int) -> Bonus | None:
    """Bonus of a run, or `None` for plain soft actor-critic."""
    if settings.bonus == "none":
        return None
    if settings.bonus == "constant":
        return ConstantBonus(settings.bonus_weight)
    if settings.bonus != "curiosity":
        return _make_rival(settings, observation_dim, action_dim)
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
        whitening=settings.whitening,
        features=features_of(settings, observation_dim, action_dim),
        parts=settings.bonus_parts or None,
        tune_weight=settings.tune_bonus_weight,
    )


def features_of(settings: Settings, observation_dim: int, action_dim: int) -> Sequence[int] | None:
    """Entries that curiosity is about: those asked for, or a window's two newest observations.

    Two, since a speed is in their difference; what is older, and the actions, tell little of where
    an action leads.
    """
    if settings.features:
        return settings.features
    if settings.history == 1:
        return None
    size = (observation_dim - (settings.history - 1) * action_dim) // settings.history
    before = size + action_dim
    return [*range(-before - size, -before), *range(-size, 0)]


def _make_rival(settings: Settings, observation_dim: int, action_dim: int) -> Bonus:
    """A rival with its own defaults, but for its scale and sizes, which all bonuses share."""
    networks: dict[str, Any] = {"hidden_dims": (settings.hidden_dim, settings.hidden_dim)}
    ensemble = networks | {"members": settings.members}
    sizes = {
        "disagreement": ensemble,
        "information-gain": ensemble,
        "rnd": networks,
        "icm": networks,
    }
    return make_bonus(
        settings.bonus,
        observation_dim,
        action_dim,
        weight=settings.bonus_weight,
        center=True,
        scale=True,
        refresh_interval=settings.refresh_interval,
        **sizes.get(settings.bonus, {}),
    )
