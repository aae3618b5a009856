"""Soft actor-critic from the parts of torchrl; the five lines marked with a plus make it curious.

Delete these five lines and the rest is plain soft actor-critic.

    python examples/torchrl_sac.py --env-id MountainCarContinuous-v0 --seed 1
    tensorboard --logdir runs
"""

from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
import torch
import tyro
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torch.utils.tensorboard import SummaryWriter
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

from deep_curiosity import CuriosityBonus  # + bonus
from deep_curiosity.bonuses import BonusLearner  # + bonus
from deep_curiosity.integrations.torchrl import CuriosityTransform  # + bonus


@dataclass(frozen=True)
class Args:
    """Settings of one run."""

    env_id: str = "MountainCarContinuous-v0"
    """Task, as gymnasium knows it; module:Task-v0 imports the module first."""
    total_steps: int = 20_000
    """Environment steps."""
    seed: int = 0
    """Seeds torch and the environment."""
    out: Path = Path("runs/torchrl_sac")
    """Folder for TensorBoard."""

    learning_starts: int = 500
    """Steps of uniformly random actions before the first update; every later step has one."""
    replay_capacity: int = 100_000
    """Transitions kept."""
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
    """Price of a nat of information, at the start; it is then tuned."""

    log_interval: int = 100
    """Steps from one entry of losses to the next."""
    evaluation_episodes: int = 10
    """Episodes of the deterministic policy, after the last step."""


def make_environment(env_id: str) -> GymWrapper:
    """Environment that takes actions in [-1, 1]."""
    environment = gymnasium.make(env_id)
    environment = gymnasium.wrappers.TransformObservation(
        environment, np.array, environment.observation_space
    )  # copies, since a task may change the array that it returned
    low, high = np.array([-1.0, 1.0], environment.action_space.dtype)
    return GymWrapper(gymnasium.wrappers.RescaleAction(environment, low, high))


def make_actor(
    observation_dim: int, action_dim: int, hidden_dims: tuple[int, ...]
) -> ProbabilisticActor:
    """Diagonal Gaussian over pre-actions, squashed by tanh."""
    network = nn.Sequential(
        MLP(observation_dim, 2 * action_dim, num_cells=hidden_dims, activation_class=nn.ReLU),
        NormalParamExtractor(),
    )
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        default_interaction_type=ExplorationType.RANDOM,
        return_log_prob=False,
    )


def make_critic(
    observation_dim: int, action_dim: int, hidden_dims: tuple[int, ...]
) -> ValueOperator:
    """Value of each pair; the loss makes two of it."""
    sizes = observation_dim + action_dim, 1
    network = MLP(*sizes, num_cells=hidden_dims, activation_class=nn.ReLU)
    return ValueOperator(network, in_keys=["observation", "action"])


@torch.no_grad()
def evaluate(actor: ProbabilisticActor, environment: GymWrapper, episodes: int) -> float:
    """Mean return of the deterministic policy."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        played = [environment.rollout(100_000, actor) for _ in range(episodes)]
    return torch.stack([episode["next", "reward"].sum() for episode in played]).mean().item()


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # networks this small are fastest on one
    writer = SummaryWriter(args.out)
    environment = make_environment(args.env_id)
    environment.set_seed(args.seed)
    sizes = (
        environment.observation_spec["observation"].shape[-1],
        environment.action_spec.shape[-1],
    )

    actor = make_actor(*sizes, args.hidden_dims)
    bonus = BonusLearner(CuriosityBonus.default(*sizes, hidden_dims=args.hidden_dims))  # + bonus
    replay = TensorDictReplayBuffer(
        storage=LazyTensorStorage(args.replay_capacity),
        batch_size=args.batch_size,
        transform=CuriosityTransform(bonus, add_to_reward=True, policy=actor),  # + bonus
    )
    loss = SACLoss(
        actor,
        make_critic(*sizes, args.hidden_dims),
        loss_function="l2",
        alpha_init=args.temperature,
        action_spec=environment.action_spec,
    )
    loss.make_value_estimator(gamma=args.discount)
    targets = SoftUpdate(loss, tau=args.polyak)
    optimizer = torch.optim.Adam(loss.parameters(), args.learning_rate)

    state = environment.reset()
    for step in range(1, args.total_steps + 1):
        act = environment.rand_action if step <= args.learning_starts else actor
        with torch.no_grad():
            transition, state = environment.step_and_maybe_reset(act(state))
        replay.add(transition.select("observation", "action", "next"))
        if step <= args.learning_starts:
            continue
        losses = loss(replay.sample())
        total_loss = losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]
        optimizer.zero_grad()
        total_loss.backward()
        optimizer.step()
        targets.step()
        if step % args.log_interval == 0:
            for name in ("loss_actor", "loss_qvalue", "alpha", "entropy"):
                writer.add_scalar(f"agent/{name}", losses[name].item(), step)

    evaluation_environment = make_environment(args.env_id)
    evaluation_environment.set_seed(1_000 + args.seed)
    evaluation_return = evaluate(actor, evaluation_environment, args.evaluation_episodes)
    writer.add_scalar("eval/return", evaluation_return, args.total_steps)
    print(f"{args.env_id}: return {evaluation_return:.2f} after {args.total_steps} steps")
    writer.close()
    evaluation_environment.close()
