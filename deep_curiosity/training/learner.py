"""The learner: agent, bonus, their optimisers and replay, assembled from a configuration."""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deep_curiosity.agent.sac import BonusFunction, CuriousSAC
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.gaussians import DiagonalMixture
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.schedules import Schedule
from deep_curiosity.speed.compile import compiled
from deep_curiosity.speed.machine import EAGER_UPDATES, should_compile
from deep_curiosity.speed.numpy_policy import NumpyPolicy
from deep_curiosity.training.checkpoint import load_weights
from deep_curiosity.training.collector import Step, as_batch
from deep_curiosity.training.config import Config
from deep_curiosity.training.exploration import Noise, make_noise
from deep_curiosity.training.greedy import GreedyStretches
from deep_curiosity.training.hindsight import Hindsight
from deep_curiosity.training.hunger import (
    HungerController,
    HungerFunction,
    make_hunger_controller,
)
from deep_curiosity.training.interfaces import Info, Policy
from deep_curiosity.training.parts import make_agent, make_run_bonus
from deep_curiosity.transitions import Sequences, Transition

NUM_DIAGNOSED_STATES = 512  # of replay, over which the information of the actions is estimated


class Learner:
    """Everything that learns, and the replay it learns from.

    Args:
        config: Settings of the run.
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        hunger: The caller's own function of observation and info.
        hindsight: Relabels goals, where the setting of this name is.

    Raises:
        ValueError: If goals are to be relabelled and there is nothing that does it.
    """

    def __init__(
        self,
        config: Config,
        observation_dim: int,
        action_dim: int,
        hunger: HungerFunction | None = None,
        hindsight: Hindsight | None = None,
    ) -> None:
        self.config = config
        self.hindsight = hindsight
        self.device = torch.device(config.speed.device)
        self.hunger_controller = make_hunger_controller(
            config, observation_dim, action_dim, hunger
        )
        self.has_hunger_function = hunger is not None
        """Whether the hunger is a function of the caller's own, which no checkpoint holds."""
        self.agent = make_agent(config, observation_dim, action_dim).to(self.device)
        self.bonus = make_run_bonus(
            config, observation_dim, action_dim, None if hindsight is None else hindsight.spaces
        )
        if self.bonus is not None:
            self.bonus.to(self.device)
        self.greedy_stretches = GreedyStretches(
            config.environment.num_envs,
            length=1 / (1 - config.agent.curiosity.discount),  # as far as curiosity looks ahead
        )
        self.noise = make_noise(config.run.exploration, config.environment.num_envs, action_dim)
        self.bonus_optimizer = config.bonus.make_optimizer(self.bonus)
        self.replay = ReplayBuffer(
            config.run.replay_capacity,
            observation_dim,
            action_dim,
            num_envs=config.environment.num_envs,
            seed=config.run.seed,
            device=self.device,
        )
        self.evaluation_policy = make_evaluation_policy(
            config, self.agent, self.hunger_controller, self.device
        )
        self._hunger = torch.full((config.environment.num_envs,), self.agent.hunger)
        self._last_hunger: list[float] = []  # of the controller, as the agent has it
        self._numpy_policies = self._make_numpy_policies()
        self._numpy_noise = torch.empty(action_dim)  # filled anew for every action
        self._learn = self._learn_eagerly
        self._compile_from = compiles_from(config)
        if config.speed.compile == "on":
            self._compile()

    def before_step(self, step: int, observation: np.ndarray, info: Info) -> None:
        """Set what goes with time, or with what is observed, before a step is taken.

        The number of steps alone says when a graph is made of the update, so that a resumed run
        computes as an uninterrupted one.

        Args:
            step: Environment steps taken so far.
            observation: `(num_envs, observation_dim)`.
            info: Infos that came with it.
        """
        self.compile_when_due(step)
        hunger = self.hunger_controller.hunger(step, observation, info)
        values = hunger.tolist()
        if values != self._last_hunger:
            self._last_hunger = values
            self._hunger = torch.as_tensor(hunger, dtype=torch.float32)
            self.agent.hunger = float(hunger.mean())
        temperature = self.config.agent.temperature
        if isinstance(temperature, Schedule):
            self.agent.temperature = temperature(step / self.config.run.total_steps)
        ends = self.config.agent.curiosity.ends
        if ends is not None and step >= ends:
            self.agent.curiosity_coefficient = 0.0

    def compile_when_due(self, step: int) -> None:
        """Make a graph of the updates from a number of steps on, where that is to be done."""
        if self._compile_from is not None and step >= self._compile_from:
            self._compile()

    def act(self, observation: np.ndarray, *, explore_uniformly: bool = False) -> np.ndarray:
        """Sample actions in [-1, 1] from the policy, or from the whole action box.

        Args:
            observation: `(num_envs, observation_dim)`.
            explore_uniformly: Leave the policy aside.

        Returns:
            `(num_envs, action_dim)`.
        """
        shape = (len(observation), self.agent.action_dim)
        if explore_uniformly:
            return (2 * torch.rand(shape) - 1).numpy()
        greedy = self.greedy_stretches.is_greedy
        if self._numpy_policies is not None:
            noise = self._numpy_noise.normal_().numpy()
            entered = _numpy_input(self.agent, observation, self._hunger.numpy())
            return self._numpy_policies[int(greedy[0])].act(entered, noise)[None]
        batch = as_batch(observation).to(self.device)
        hunger = self._hunger.to(self.device)
        if self.noise is None and not greedy.any():
            return self.agent.act(batch, hunger=hunger).cpu().numpy()
        policy_input = self.agent.policy_input(batch, hunger)
        chosen = torch.from_numpy(greedy).to(self.device)
        if self.noise is None:
            return self._sample(policy_input, chosen).cpu().numpy()
        action = self._explore(policy_input, self.noise)
        if greedy.any():
            greedy_action = self.agent.act(batch, greedy=True, hunger=hunger)
            action = torch.where(chosen.unsqueeze(-1), greedy_action, action)
        return action.cpu().numpy()

    @torch.no_grad()
    def _sample(self, policy_input: Tensor, greedy: Tensor) -> Tensor:
        """Actions of the greedy policy where that is to act, of the curious one elsewhere.

        There is one draw for both, as in NumPy: the random stream is the same with either.
        """
        of_greedy, of_curious = (self.agent.policy(policy_input, number) for number in (0, -1))
        fields = [
            torch.where(greedy.view(-1, *[1] * (own.ndim - 1)), own, other)
            for own, other in zip(of_greedy, of_curious, strict=True)
        ]
        return torch.tanh(DiagonalMixture(*fields).sample())

    @torch.no_grad()
    def _explore(self, policy_input: Tensor, noise: Noise) -> Tensor:
        """Actions of the policy under a noise that is not its own."""
        hidden = self.agent.policy.hidden(policy_input)
        sample = noise.sample(hidden).to(hidden.device)
        policy = self.agent.policy.at(hidden)
        return torch.tanh(policy.component_samples(sample.unsqueeze(1)).squeeze(1))

    def store(self, step: Step) -> None:
        """Keep a step of every environment in replay."""
        self.replay.extend(*step)
        ended = np.logical_or(step.terminated, step.truncated)
        self.hunger_controller.record(step.reward, ended)
        self.greedy_stretches.record(ended, self.agent.greedy_share)
        if self.noise is not None:
            for index in np.flatnonzero(ended):
                self.noise.begin(int(index))

    def update(self) -> dict[str, Tensor]:
        """One gradient step on the bonus's models and on every part of the agent."""
        batch_size = self.config.run.batch_size
        rows, alive, slot = self.replay.sample_rows(batch_size, self.agent.sequence_length)
        if self.bonus is not None:
            if self.bonus.should_skip:
                self.bonus.skip()
            else:
                self._observe(self.bonus, rows, alive)
        later = slot[batch_size : batch_size * self.agent.num_steps[-1]]
        remembered = self.replay.bonus.index_select(0, later)
        relabelled = (
            None
            if self.hindsight is None
            else self.hindsight.relabel(self.replay, rows, alive, slot)
        )
        metrics, bonus = self._learn(rows, alive, remembered, relabelled)
        if bonus is not None:
            self.replay.bonus.index_copy_(0, slot[:batch_size], bonus)
        return metrics

    def _observe(self, bonus: Bonus, rows: Tensor, alive: Tensor) -> None:
        """Show the bonus the batch, and where the agent has been of late if it asks for that."""
        transition = self.replay.sequences(rows, alive).first
        visited = self.config.bonus.sample_visited(self.replay, self.config.run.batch_size)
        bonus.observe(transition, self.agent.act, visited)

    def _compile(self) -> None:
        """Make one graph of the update, when it is next called."""
        self._compile_from = None
        self._learn = compiled(
            self._learn_eagerly,
            speed=self.config.speed,
            fall_back=self.config.speed.compile == "auto",
        )

    def _learn_eagerly(
        self, rows: Tensor, alive: Tensor, remembered: Tensor, relabelled: Sequences | None
    ) -> tuple[dict[str, Tensor], Tensor | None]:
        """The part of an update that can be one graph.

        Args:
            rows: Sequences as they lie in replay.
            alive: Which of them belong to their sequence.
            remembered: Bonus of the later steps that count, as it last was.
            relabelled: The same sequences with the goals that the agent is to learn from, where
                these are others; bonus and models are about what was, whatever is desired.

        Returns:
            What to log, and the bonus of the first step of every sequence.
        """
        sequences = self.replay.sequences(rows, alive)
        fresh: Tensor | None = None
        bonus: Tensor | BonusFunction | None = self.bonus
        metrics = {}
        if self.bonus is not None:
            if self.agent.has_curiosity_critic:
                # before the models learn: in a graph it then needs no pass of its own
                observation, action, _, next_observation, *_ = sequences.head(1)
                with torch.no_grad():
                    fresh = self.bonus(observation, action, next_observation)
                bonus = torch.cat([fresh, remembered])
            loss = self.bonus.loss(sequences.head(1))
            if self.bonus_optimizer is not None:
                self.bonus_optimizer.step(loss)
            metrics["curiosity/model_loss"] = loss.detach()
        seen = sequences if relabelled is None else relabelled
        for name, value in self.agent.update(seen, bonus).items():
            metrics[f"agent/{name}"] = value
        return metrics, fresh

    def diagnostics(self) -> dict[str, Tensor]:
        """Metrics of agent and bonus that cost a few milliseconds."""
        held = self.replay.evenly_spaced(NUM_DIAGNOSED_STATES)
        of_agent = self.agent.metrics(held.observation)
        metrics = {f"agent/{key}": value for key, value in of_agent.items()}
        if self.bonus is not None:
            metrics |= {f"curiosity/{key}": value for key, value in self.bonus.metrics().items()}
            metrics |= self._bonus_over(held, self.bonus)
        return metrics

    @torch.no_grad()
    def _bonus_over(self, held: Transition, bonus: Bonus) -> dict[str, Tensor]:
        """Mean and standard deviation of the bonus over transitions, in units of its weight."""
        weight = getattr(self.config.bonus, "weight", 0.0)
        if not (weight and bonus.ready):
            return {}
        observation, action, _, next_observation, *_ = held
        value = bonus(observation, action, next_observation) / weight
        return {
            "curiosity/bonus_mean": value.mean(),
            "curiosity/bonus_std": value.std(correction=0),
        }

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimisers, statistics, replay and the state of the random generators."""
        optimizer = self.bonus_optimizer
        return {
            "agent": self.agent.state_dict(),
            "bonus": {} if self.bonus is None else self.bonus.state_dict(),
            "bonus_optimizer": {} if optimizer is None else optimizer.state_dict(),
            "noise": {} if self.noise is None else self.noise.state_dict(),
            "hunger": self.hunger_controller.state_dict(),
            "greedy_stretches": self.greedy_stretches.state_dict(),
            "has_hunger_function": self.has_hunger_function,
            "replay": self.replay.state_dict(),
            "random": self._random_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave.

        Raises:
            ValueError: If a part has other sizes now.
        """
        folder = self.config.run.out
        load_weights(self.agent, state["agent"], folder)
        if self.bonus is not None:
            load_weights(self.bonus, state["bonus"], folder)
        if self.bonus_optimizer is not None:
            load_weights(self.bonus_optimizer, state["bonus_optimizer"], folder)
        if self.noise is not None:
            self.noise.load_state_dict(state["noise"])
        self.hunger_controller.load_state_dict(state["hunger"])
        self.greedy_stretches.load_state_dict(state["greedy_stretches"])
        self._last_hunger = []
        self.replay.load_state_dict(state["replay"] | {"generator": self._own_generator(state)})
        torch.set_rng_state(state["random"]["cpu"])
        if "cuda" in state["random"] and self.device.type == "cuda":
            torch.cuda.set_rng_state(state["random"]["cuda"], self.device)

    def _own_generator(self, state: dict[str, Any]) -> Tensor:
        """State of the replay's generator; begun anew where the run comes from another device."""
        own = torch.Generator(self.device).manual_seed(self.config.run.seed).get_state()
        saved: Tensor = state["replay"]["generator"]
        return saved if saved.shape == own.shape else own

    def _make_numpy_policies(self) -> tuple[NumpyPolicy, NumpyPolicy] | None:
        """Curious and greedy policy in NumPy, if one environment is stepped on the CPU."""
        if not acts_by_numpy(self.config):
            return None
        policy, scaling = self.agent.policy, self.agent.observation_scaling
        return NumpyPolicy(policy, scaling=scaling), NumpyPolicy(policy, 0, scaling=scaling)

    def _random_state(self) -> dict[str, Tensor]:
        """State of the global generators that the run samples from."""
        state = {"cpu": torch.get_rng_state()}
        if self.device.type == "cuda":
            state["cuda"] = torch.cuda.get_rng_state(self.device)
        return state


def make_evaluation_policy(
    config: Config,
    agent: CuriousSAC,
    hunger_controller: HungerController,
    device: str | torch.device = "cpu",
) -> Policy:
    """The agent without noise, as it acts for reward, at the hunger of an evaluation.

    Args:
        config: Settings of its run: where that acts by NumPy, a single observation is acted on by
            NumPy here, too.
        agent: Which is evaluated, as it then is.
        hunger_controller: Says how hungry it is.
        device: Where the agent is.
    """

    def act(observation: Tensor, info: Info) -> Tensor:
        hunger = hunger_controller.in_evaluation(observation.numpy(), info)
        chosen = torch.as_tensor(hunger, dtype=torch.float32, device=device)
        return agent.act(
            observation.to(device), deterministic=True, greedy=True, hunger=chosen
        ).cpu()

    def act_by_numpy(observation: Tensor, info: Info) -> Tensor:
        if len(observation) > 1:
            return act(observation, info)
        observed = observation.numpy()
        hunger = hunger_controller.in_evaluation(observed, info)
        return torch.from_numpy(policy.center(_numpy_input(agent, observed, hunger))[None])

    if not acts_by_numpy(config):
        return act
    policy = NumpyPolicy(agent.policy, 0, scaling=agent.observation_scaling)
    return act_by_numpy


def acts_by_numpy(config: Config) -> bool:
    """Whether a run acts by NumPy: one environment on the CPU, and a policy of one Gaussian."""
    return (
        config.speed.numpy_policy
        and config.environment.num_envs == 1
        and config.agent.mixture_components == 1
        and torch.device(config.speed.device).type == "cpu"
        and config.run.exploration == "policy"
    )


def _numpy_input(agent: CuriousSAC, observation: np.ndarray, hunger: np.ndarray) -> np.ndarray:
    """What a policy in NumPy is shown of one environment: `(1, observation_dim)` to a vector."""
    policy_input: np.ndarray = observation[0].astype(np.float32)
    if agent.is_conditioned:
        policy_input = np.append(policy_input, hunger.astype(np.float32))
    return policy_input


def compiles(config: Config) -> bool:
    """Whether the updates of a run are compiled."""
    num_updates = (config.run.total_steps - config.run.learning_starts) * config.run.update_to_data
    return should_compile(config.speed, num_updates)


def compiles_from(config: Config) -> int | None:
    """Environment steps after which the updates of a run are compiled; `None` for never."""
    if not compiles(config):
        return None
    num_eager = EAGER_UPDATES if config.speed.compile == "auto" else 0
    return config.run.learning_starts + math.ceil(num_eager / config.run.update_to_data)
