"""A soft actor-critic of torchrl with a bonus, as the check of integrations handles it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import SACLoss
from torchrl.objectives.utils import TargetNetUpdater

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.integrations.base import Integration
from deep_curiosity.integrations.torchrl.actor_critic_loss import CuriousActorCriticLoss
from deep_curiosity.integrations.torchrl.transform import CuriosityTransform
from deep_curiosity.replay import oldest_first
from deep_curiosity.transitions import Transition


@dataclass(frozen=True)
class TorchRLAgent:
    """The parts of a torchrl script.

    Args:
        env: A single environment, in which the actor acts.
        actor: The policy that collects.
        loss: `SACLoss`, or `CuriousActorCriticLoss` with the bonus of the transform.
        optimizer: Over the parameters of the loss.
        target: Moves the target networks.
        replay: What is stored; the transform is appended to it.
        transform: Where the bonus is.
    """

    env: EnvBase
    actor: TensorDictModuleBase
    loss: SACLoss
    optimizer: torch.optim.Optimizer
    target: TargetNetUpdater
    replay: TensorDictReplayBuffer
    transform: CuriosityTransform


class TorchRLIntegration(Integration):
    """Soft actor-critic of torchrl with a `CuriosityTransform` on its replay buffer.

    Args:
        make_agent: Builds the parts, always alike, sharing nothing with those it built before.
        num_updates: Gradient steps of each call of `learn`.
    """

    def __init__(self, make_agent: Callable[[], TorchRLAgent], *, num_updates: int = 1) -> None:
        self.make_agent = make_agent
        self.num_updates = num_updates
        self.agent = make_agent()
        _ = self.agent.loss.value_estimator  # built at first use, and from then on saved

    @property
    def bonus(self) -> Bonus:
        """The bonus in use, not a copy."""
        return self.agent.transform.bonus

    def collect(self, num_steps: int, *, seed: int) -> Transition:
        """Reset the environment with a seed, act for some steps and store them."""
        torch.manual_seed(seed)
        self.agent.env.set_seed(seed)
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            rollout = self.agent.env.rollout(
                num_steps, self.agent.actor, break_when_any_done=False
            )
        given = self._read(rollout.clone())
        self.agent.replay.extend(rollout)
        return given

    def stored(self) -> Transition:
        """All that is stored, oldest first, as it is stored."""
        return self._read(oldest_first(self.agent.replay))

    def learn(self, *, seed: int) -> None:
        """Sample, and step critics, actor and what else has a loss; then the targets follow."""
        torch.manual_seed(seed)
        for _ in range(self.num_updates):
            losses = self.agent.loss(self.agent.replay.sample())
            self.agent.optimizer.zero_grad()
            total_loss(losses).backward()
            self.agent.optimizer.step()
            self.agent.target.step()

    def critic(self) -> list[Tensor]:
        """Parameters of the critic that learns from the bonus."""
        loss = self.agent.loss
        if isinstance(loss, CuriousActorCriticLoss) and loss.has_curiosity_critic:
            return list(loss.curiosity_network_params.parameters())
        return list(loss.qvalue_network_params.parameters())

    def actor(self) -> list[Tensor]:
        """Parameters of the actor."""
        return list(self.agent.loss.actor_network_params.parameters())

    def save(self, folder: Path) -> None:
        """Save loss, optimiser, and the replay with its transform, in which the bonus is."""
        folder.mkdir(parents=True, exist_ok=True)
        self.agent.replay.dumps(folder / "replay")
        state = {
            "loss": self.agent.loss.state_dict(),
            "optimizer": self.agent.optimizer.state_dict(),
        }
        torch.save(state, folder / "agent.pt")

    def load(self, folder: Path) -> "TorchRLIntegration":
        """Another agent, as `save` left it in the folder, with an environment of its own."""
        other = TorchRLIntegration(self.make_agent, num_updates=self.num_updates)
        other.agent.replay.loads(folder / "replay")
        state = torch.load(folder / "agent.pt")
        other.agent.loss.load_state_dict(state["loss"])
        other.agent.optimizer.load_state_dict(state["optimizer"])
        return other

    def _read(self, tensordict: TensorDictBase) -> Transition:
        return self.agent.transform.reader.read(tensordict)


def total_loss(losses: TensorDictBase) -> Tensor:
    """Sum of all entries of a loss module's output that are losses."""
    return torch.stack(
        [losses.get(name) for name in losses.keys() if name.startswith("loss_")]
    ).sum()
