"""Soft actor-critic in one file; the five lines marked with a plus make it curious.

Delete these five lines and the rest is plain soft actor-critic, for any gymnasium task with vector
observations and bounded actions.

    python examples/cleanrl_sac.py --env-id MountainCarContinuous-v0 --seed 1
    tensorboard --logdir runs

Reference: Haarnoja et al., "Soft Actor-Critic Algorithms and Applications" (2018),
https://arxiv.org/abs/1812.05905; algorithm 1.
"""

import copy
import math
import statistics
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
import torch
import tyro
from gymnasium.wrappers import RecordEpisodeStatistics, RescaleAction
from torch import Tensor, nn
from torch.distributions import Normal
from torch.nn.functional import softplus
from torch.utils.tensorboard import SummaryWriter

from deep_curiosity import CuriosityBonus, Transition  # + bonus
from deep_curiosity.bonuses import BonusLearner  # + bonus

LOG_STD_RANGE = (-5.0, 2.0)  # below -5 the density of tanh is sharper than float32 resolves


@dataclass(frozen=True)
class Args:
    """Settings of one run."""

    env_id: str = "MountainCarContinuous-v0"
    """Task, as gymnasium knows it; module:Task-v0 imports the module first."""
    total_steps: int = 20_000
    """Environment steps."""
    seed: int = 0
    """Seeds torch and the environment."""
    out: Path = Path("runs/cleanrl_sac")
    """Folder for TensorBoard."""

    learning_starts: int = 500
    """Steps of uniformly random actions before the first update; every later step has one."""
    replay_capacity: int = 1_000_000
    """Transitions kept; memory is taken only as they come."""
    batch_size: int = 256
    """Transitions in an update."""
    hidden_dims: tuple[int, ...] = (64, 64)
    """Width of every hidden layer."""
    learning_rate: float = 1e-3
    """Learning rate of Adam, for actor, critics and temperature."""
    discount: float = 0.99
    """Discount of the reward per step."""
    polyak: float = 0.02
    """Share of the critics that moves into the target critics at each update."""
    temperature: float = 0.02
    """Price of a nat of information, at the start; it is then tuned to hold the entropy at -1 nat
    for each action dimension."""

    log_interval: int = 100
    """Steps from one entry of losses to the next."""
    evaluation_episodes: int = 10
    """Episodes of the deterministic policy, after the last step."""


class Batch(NamedTuple):
    """Environment steps as the environment gave them."""

    observation: Tensor  # batch observation_dim
    action: Tensor  # batch action_dim, in [-1, 1]
    reward: Tensor  # batch
    next_observation: Tensor  # batch observation_dim, the true one also where an episode ended
    terminated: Tensor  # batch, bool: there is nothing to bootstrap
    truncated: Tensor  # batch, bool: a clock ended the episode, the value goes on


class Replay:
    """Ring of the newest transitions."""

    def __init__(self, capacity: int, observation_dim: int, action_dim: int) -> None:
        self.held = Batch(
            observation=torch.zeros(capacity, observation_dim),
            action=torch.zeros(capacity, action_dim),
            reward=torch.zeros(capacity),
            next_observation=torch.zeros(capacity, observation_dim),
            terminated=torch.zeros(capacity, dtype=torch.bool),
            truncated=torch.zeros(capacity, dtype=torch.bool),
        )
        self.capacity = capacity
        self.num_added = 0

    def add(self, step: Batch) -> None:
        """Append one transition, in place of the oldest when full."""
        for field, value in zip(self.held, step, strict=True):
            field[self.num_added % self.capacity] = value
        self.num_added += 1

    def sample(self, batch_size: int) -> Batch:
        """Sample transitions uniformly, with replacement."""
        rows = torch.randint(min(self.num_added, self.capacity), (batch_size,))
        return Batch(*(field[rows] for field in self.held))


class Actor(nn.Module):
    """Diagonal Gaussian over pre-actions, squashed by tanh."""

    def __init__(
        self, observation_dim: int, action_dim: int, hidden_dims: tuple[int, ...]
    ) -> None:
        super().__init__()
        self.network = mlp(observation_dim, *hidden_dims, 2 * action_dim)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Fresh actions `(batch, action_dim)` and their log densities `(batch,)`, in nats."""
        loc, log_std = self.network(observation).chunk(2, dim=-1)
        gaussian = Normal(loc, log_std.clamp(*LOG_STD_RANGE).exp())
        pre_action = gaussian.rsample()
        # log(1 - tanh(u)^2) without the cancellation that its terms have where |u| is large
        log_slope = 2 * (math.log(2) - pre_action - softplus(-2 * pre_action))
        return pre_action.tanh(), (gaussian.log_prob(pre_action) - log_slope).sum(-1)

    def sample(self, observation: Tensor) -> Tensor:
        """Fresh actions `(batch, action_dim)`."""
        action, _ = self(observation)
        return action

    def mode(self, observation: Tensor) -> Tensor:
        """The action at the centre of the Gaussian."""
        loc, _ = self.network(observation).chunk(2, dim=-1)
        return loc.tanh()


class TwinCritic(nn.Module):
    """Two values of each pair, the lower of which is believed."""

    def __init__(
        self, observation_dim: int, action_dim: int, hidden_dims: tuple[int, ...]
    ) -> None:
        super().__init__()
        sizes = (observation_dim + action_dim, *hidden_dims, 1)
        self.networks = nn.ModuleList([mlp(*sizes), mlp(*sizes)])

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Both values, `(2, batch)`."""
        pair = torch.cat([observation, action], dim=-1)
        return torch.stack([network(pair).squeeze(-1) for network in self.networks])


def mlp(*sizes: int) -> nn.Sequential:
    """Linear layers with ReLU between them."""
    layers: list[nn.Module] = []
    for size, next_size in pairwise(sizes):
        layers += [nn.Linear(size, next_size), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def make_environment(env_id: str) -> gymnasium.Env:
    """Environment that takes actions in [-1, 1] and reports the return of its episodes."""
    environment = gymnasium.make(env_id)
    environment = gymnasium.wrappers.TransformObservation(
        environment, np.array, environment.observation_space
    )  # copies, since a task may change the array that it returned
    low, high = np.array([-1.0, 1.0], environment.action_space.dtype)
    return RecordEpisodeStatistics(RescaleAction(environment, low, high))


def to_tensor(observation: object) -> Tensor:
    """An observation as the networks take it, `(observation_dim,)`."""
    return torch.as_tensor(observation, dtype=torch.float32)


@torch.no_grad()
def evaluate(actor: Actor, environment: gymnasium.Env, episodes: int, seed: int) -> float:
    """Mean return of the deterministic policy."""
    returns = []
    for episode in range(episodes):
        observation, _ = environment.reset(seed=seed + episode)
        ended = False
        while not ended:
            action = actor.mode(to_tensor(observation)).numpy()
            observation, _, terminated, truncated, info = environment.step(action)
            ended = terminated or truncated
        returns.append(float(info["episode"]["r"]))
    return statistics.mean(returns)


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # networks this small are fastest on one
    writer = SummaryWriter(args.out)
    environment = make_environment(args.env_id)
    sizes = environment.observation_space.shape[0], environment.action_space.shape[0]

    # parts
    replay = Replay(args.replay_capacity, *sizes)
    actor, critic = Actor(*sizes, args.hidden_dims), TwinCritic(*sizes, args.hidden_dims)
    target_critic = copy.deepcopy(critic).requires_grad_(False)
    log_temperature = torch.tensor(args.temperature).log().requires_grad_()
    target_entropy = -float(sizes[1])
    actor_optimizer = torch.optim.Adam(actor.parameters(), args.learning_rate)
    critic_optimizer = torch.optim.Adam(critic.parameters(), args.learning_rate)
    temperature_optimizer = torch.optim.Adam([log_temperature], args.learning_rate)
    bonus = BonusLearner(CuriosityBonus.default(*sizes, hidden_dims=args.hidden_dims))  # + bonus

    start = time.perf_counter()
    observation, _ = environment.reset(seed=args.seed)
    for step in range(1, args.total_steps + 1):
        # act
        if step <= args.learning_starts:
            action = 2 * torch.rand(sizes[1]) - 1
        else:
            with torch.no_grad():
                action = actor.sample(to_tensor(observation))
        next_observation, reward, terminated, truncated, info = environment.step(action.numpy())

        # store what the environment gave, and nothing else
        replay.add(
            Batch(
                to_tensor(observation),
                action,
                torch.tensor(float(reward)),
                to_tensor(next_observation),
                torch.tensor(terminated),
                torch.tensor(truncated),
            )
        )
        observation = next_observation
        if terminated or truncated:
            writer.add_scalar("episode/return", info["episode"]["r"], step)
            writer.add_scalar("episode/length", info["episode"]["l"], step)
            observation, _ = environment.reset()
        if step <= args.learning_starts:
            continue

        batch = replay.sample(args.batch_size)
        bonus.learn(Transition(*batch), actor.sample)  # + bonus
        batch = batch._replace(reward=batch.reward + bonus.compute(Transition(*batch)))  # + bonus

        # critic: towards reward and the soft value of the next state, if there is one
        temperature = log_temperature.exp().detach()
        with torch.no_grad():
            next_action, next_log_prob = actor(batch.next_observation)
            next_value = target_critic(batch.next_observation, next_action).amin(0)
            next_value = next_value - temperature * next_log_prob
            target = batch.reward + args.discount * ~batch.terminated * next_value
        value = critic(batch.observation, batch.action)  # 2 batch
        critic_loss = 0.5 * (value - target).square().mean(-1).sum()
        critic_optimizer.zero_grad()
        critic_loss.backward()
        critic_optimizer.step()

        # actor: towards actions of high value, at the price of their information
        fresh_action, log_prob = actor(batch.observation)
        fresh_value = critic(batch.observation, fresh_action).amin(0)
        actor_loss = (temperature * log_prob - fresh_value).mean()
        actor_optimizer.zero_grad()
        actor_loss.backward()
        actor_optimizer.step()

        # temperature: up while the entropy is below its target
        entropy = -log_prob.detach().mean()
        temperature_loss = log_temperature * (entropy - target_entropy)
        temperature_optimizer.zero_grad()
        temperature_loss.backward()
        temperature_optimizer.step()

        # target critic: a share of the way
        with torch.no_grad():
            for slow, fast in zip(target_critic.parameters(), critic.parameters(), strict=True):
                slow.lerp_(fast, args.polyak)

        if step % args.log_interval == 0:
            writer.add_scalar("agent/critic_loss", critic_loss.item(), step)
            writer.add_scalar("agent/policy_loss", actor_loss.item(), step)
            writer.add_scalar("agent/value", value.mean().item(), step)
            writer.add_scalar("agent/entropy", entropy.item(), step)
            writer.add_scalar("agent/temperature", temperature.item(), step)
            speed = step / (time.perf_counter() - start)
            writer.add_scalar("time/steps_per_second", speed, step)

    evaluation_environment = make_environment(args.env_id)
    evaluation_return = evaluate(
        actor, evaluation_environment, args.evaluation_episodes, seed=1_000 + args.seed
    )
    writer.add_scalar("eval/return", evaluation_return, args.total_steps)
    print(f"{args.env_id}: return {evaluation_return:.2f} after {args.total_steps} steps")
    for opened in (writer, environment, evaluation_environment):
        opened.close()
