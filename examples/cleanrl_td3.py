"""Twin delayed DDPG in one file; the five lines marked with a plus make it curious.

Delete these five lines and the rest is plain TD3, for any gymnasium task with vector
observations and bounded actions.

    python examples/cleanrl_td3.py --env-id MountainCarContinuous-v0 --seed 1
    tensorboard --logdir runs

Reference: Fujimoto et al., "Addressing Function Approximation Error in Actor-Critic Methods"
(2018), https://arxiv.org/abs/1802.09477; algorithm 1.
"""

import copy
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
from torch.utils.tensorboard import SummaryWriter

from deep_curiosity import CuriosityBonus, Transition  # + bonus
from deep_curiosity.bonuses import BonusLearner  # + bonus


@dataclass(frozen=True)
class Args:
    """Settings of one run."""

    env_id: str = "MountainCarContinuous-v0"
    """Task, as gymnasium knows it; module:Task-v0 imports the module first."""
    total_steps: int = 20_000
    """Environment steps."""
    seed: int = 0
    """Seeds torch and the environment."""
    out: Path = Path("runs/cleanrl_td3")
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
    """Learning rate of Adam, for actor and critics."""
    discount: float = 0.99
    """Discount of the reward per step."""
    polyak: float = 0.02
    """Share of the networks that moves into their targets at each update of the actor."""
    exploration_std: float = 0.1
    """Standard deviation of the noise on actions that are carried out."""
    smoothing_std: float = 0.2
    """Standard deviation of the noise on the target actor's actions."""
    smoothing_bound: float = 0.5
    """Where that noise is cut off."""
    actor_interval: int = 2
    """Updates of the critics from one update of the actor to the next."""

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
    """One action for each observation, squashed by tanh."""

    def __init__(
        self, observation_dim: int, action_dim: int, hidden_dims: tuple[int, ...]
    ) -> None:
        super().__init__()
        self.network = mlp(observation_dim, *hidden_dims, action_dim)

    def forward(self, observation: Tensor) -> Tensor:
        """Actions `(batch, action_dim)`."""
        return self.network(observation).tanh()


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
            action = actor(to_tensor(observation)).numpy()
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
    target_actor, target_critic = copy.deepcopy((actor, critic))
    actor_optimizer = torch.optim.Adam(actor.parameters(), args.learning_rate)
    critic_optimizer = torch.optim.Adam(critic.parameters(), args.learning_rate)
    bonus = BonusLearner(CuriosityBonus.default(*sizes, hidden_dims=args.hidden_dims))  # + bonus

    def explore(observation: Tensor) -> Tensor:
        """Actions as they are carried out, with noise."""
        action = actor(observation)
        return (action + args.exploration_std * torch.randn_like(action)).clamp(-1, 1)

    start = time.perf_counter()
    observation, _ = environment.reset(seed=args.seed)
    for step in range(1, args.total_steps + 1):
        # act
        if step <= args.learning_starts:
            action = 2 * torch.rand(sizes[1]) - 1
        else:
            with torch.no_grad():
                action = explore(to_tensor(observation))
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
        bonus.learn(Transition(*batch), explore)  # + bonus
        batch = batch._replace(reward=batch.reward + bonus.compute(Transition(*batch)))  # + bonus

        # critic: towards reward and the value of the next state, if there is one
        with torch.no_grad():
            next_action = target_actor(batch.next_observation)
            noise = args.smoothing_std * torch.randn_like(next_action)
            noise = noise.clamp(-args.smoothing_bound, args.smoothing_bound)
            next_action = (next_action + noise).clamp(-1, 1)
            next_value = target_critic(batch.next_observation, next_action).amin(0)
            target = batch.reward + args.discount * ~batch.terminated * next_value
        value = critic(batch.observation, batch.action)  # 2 batch
        critic_loss = 0.5 * (value - target).square().mean(-1).sum()
        critic_optimizer.zero_grad()
        critic_loss.backward()
        critic_optimizer.step()

        if step % args.actor_interval == 0:
            # actor: towards actions of high value
            actor_loss = -critic(batch.observation, actor(batch.observation))[0].mean()
            actor_optimizer.zero_grad()
            actor_loss.backward()
            actor_optimizer.step()

            # targets: a share of the way
            with torch.no_grad():
                for fast, slow in ((actor, target_actor), (critic, target_critic)):
                    for source, copied in zip(fast.parameters(), slow.parameters(), strict=True):
                        copied.lerp_(source, args.polyak)

        if step % args.log_interval == 0:
            writer.add_scalar("agent/critic_loss", critic_loss.item(), step)
            writer.add_scalar("agent/value", value.mean().item(), step)
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
