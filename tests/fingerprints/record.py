"""Records what short runs end with: evaluation return and a hash of all weights, to the last bit.

    python tests/fingerprints/record.py before.csv   # on one commit
    python tests/fingerprints/record.py after.csv    # on another, same machine
    diff before.csv after.csv

A change that only moves code leaves the table as it is. Bits are the same on one class of CPU.
"""

import csv
import hashlib
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import gymnasium
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import (
    MLP,
    NormalParamExtractor,
    ProbabilisticActor,
    TanhNormal,
    ValueOperator,
)
from torchrl.objectives import SACLoss, SoftUpdate

import deep_curiosity_envs  # noqa: F401  # registers the tasks
from deep_curiosity.bonuses import BonusLearner, make_bonus
from deep_curiosity.integrations.stable_baselines3 import (
    CuriosityCallback,
    CuriousReplayBuffer,
    CuriousRolloutBuffer,
)
from deep_curiosity.integrations.torchrl import CuriosityTransform, CuriousActorCriticLoss
from deep_curiosity.training import Config, train
from deep_curiosity.training.checkpoint import load_checkpoint

NUM_STEPS = 1_500
NUM_UPDATES = 300  # of torchrl, on one rollout
PENDULUM = "deep_curiosity/PendulumSwingup-v0"
BASE = Config.of(
    env_id="PendulumSwingup",
    env_kwargs={"action_cost": 0.1},
    total_steps=NUM_STEPS,
    hidden_dim=64,
    compile="off",
    matmul_precision="highest",
)
TRAINED = {
    "plain": BASE.override(bonus="none"),
    "default": BASE,
    "learned prior": BASE.override(prior="learned"),
    "random hunger": BASE.override(hunger="random"),
    "four environments": BASE.override(num_envs=4),
    "frame stack": BASE.override(env_id="PendulumHiddenVelocity", frame_stack=3),
    "nearest neighbours": BASE.override(bonus="nearest-neighbours"),
    "one step ahead": BASE.override(reward_steps=1, curiosity_steps=1),
    "exact": BASE.override("exact"),
}
CURIOSITY = {"hidden_dims": (64, 64), "refresh_interval": 10, "members": "all"}


def weights_hash(tensors: Iterable[Tensor]) -> str:
    """Hash of tensors, whatever their names and their order."""
    hashes = sorted(
        hashlib.sha256(value.detach().contiguous().numpy().tobytes()).hexdigest()
        for value in tensors
    )
    return hashlib.sha256("".join(hashes).encode()).hexdigest()[:16]


def trained(config: Config) -> tuple[float, str]:
    """A run of the trainer."""
    with tempfile.TemporaryDirectory() as folder:
        config = config.override(out=Path(folder) / "run")
        summary = train(config, show_progress=False)
        learner = load_checkpoint(config.run.out)["learner"]
    weights = [
        value
        for part in ("agent", "bonus")
        for name, value in learner[part].items()
        if name.endswith(
            (".weight", ".bias", "log_temperature", "prior.raw_loc", "raw_std", "prior.logits")
        )
    ]
    return summary["evaluation_return"], weights_hash(weights)


def stable_baselines3(
    kind: type, buffer: dict[str, object], **options: object
) -> tuple[float, str]:
    """An agent of Stable-Baselines3 with a curious buffer."""
    model = kind(
        "MlpPolicy",
        gymnasium.make(PENDULUM),
        policy_kwargs={"net_arch": [64, 64]},
        seed=0,
        device="cpu",
        **buffer,
        **options,
    )
    model.learn(NUM_STEPS, callback=CuriosityCallback())
    score, _ = evaluate_policy(model, gymnasium.make(PENDULUM), 1)
    held = getattr(model, "replay_buffer", None) or model.rollout_buffer
    return float(score), weights_hash([*model.policy.parameters(), *held.bonus.parameters()])


def sb3_sac() -> tuple[float, str]:
    """Soft actor-critic with a curious replay buffer."""
    buffer = {
        "replay_buffer_class": CuriousReplayBuffer,
        "replay_buffer_kwargs": {"bonus_kwargs": CURIOSITY},
    }
    return stable_baselines3(SAC, buffer, learning_starts=500)


def sb3_ppo() -> tuple[float, str]:
    """PPO with a curious rollout buffer."""
    buffer = {
        "rollout_buffer_class": CuriousRolloutBuffer,
        "rollout_buffer_kwargs": {"bonus_kwargs": CURIOSITY},
    }
    return stable_baselines3(PPO, buffer, n_steps=512)


def torchrl(curious_loss: bool) -> tuple[float, str]:
    """Soft actor-critic of torchrl, with the bonus in the reward or with a value of its own."""
    torch.manual_seed(0)
    env = GymEnv(PENDULUM)
    env.set_seed(0)
    network = nn.Sequential(MLP(3, 2, num_cells=(64, 64)), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(4, 1, num_cells=(64, 64)), in_keys=["observation", "action"])
    bonus = make_bonus("curiosity", 3, 1, **CURIOSITY)
    transform = CuriosityTransform(
        BonusLearner(bonus), add_to_reward=not curious_loss, policy=actor
    )
    if curious_loss:
        loss = CuriousActorCriticLoss(actor, critic, bonus, prior="learned", loss_function="l2")
    else:
        loss = SACLoss(actor, critic, loss_function="l2")
        loss.make_value_estimator(gamma=0.99)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(NUM_STEPS), batch_size=64)
    replay.append_transform(transform)
    with torch.no_grad():
        replay.extend(env.rollout(NUM_STEPS, actor, break_when_any_done=False))
    target, optimizer = SoftUpdate(loss, tau=0.02), torch.optim.Adam(loss.parameters(), lr=1e-3)
    for _ in range(NUM_UPDATES):
        losses = loss(replay.sample())
        total = sum(losses[name] for name in losses.keys() if name.startswith("loss_"))
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        target.step()
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        score = env.rollout(200, actor)["next", "reward"].sum().item()
    return score, weights_hash([*loss.parameters(), *bonus.parameters()])


ADAPTERS: dict[str, Callable[[], tuple[float, str]]] = {
    "Stable-Baselines3, SAC": sb3_sac,
    "Stable-Baselines3, PPO": sb3_ppo,
    "torchrl, transform": lambda: torchrl(curious_loss=False),
    "torchrl, loss": lambda: torchrl(curious_loss=True),
}


def main(path: Path) -> None:
    """Run all of it and write the table."""
    torch.set_num_threads(1)
    runs = {name: lambda own=own: trained(own) for name, own in TRAINED.items()} | ADAPTERS
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("configuration", "evaluation_return", "weights"))
        for name, run in runs.items():
            row = (name, *run())
            print(*row, sep="  ", flush=True)
            writer.writerow(row)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
