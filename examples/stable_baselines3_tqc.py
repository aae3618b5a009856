"""TQC, whose critics know the distribution of returns; the four lines with a plus make it curious.

Delete these four lines and the rest is the plain agent.

    python examples/stable_baselines3_tqc.py --seed 1
    tensorboard --logdir runs
"""

from dataclasses import dataclass
from pathlib import Path

import gymnasium
import tyro
from sb3_contrib import TQC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from deep_curiosity.integrations import stable_baselines3 as curiosity  # + bonus


@dataclass(frozen=True)
class Args:
    """Settings of one run."""

    env_id: str = "MountainCarContinuous-v0"
    """Task, as gymnasium knows it; module:Task-v0 imports the module first."""
    total_steps: int = 10_000
    """Environment steps."""
    seed: int = 0
    """Seeds the agent and the environment."""
    out: Path = Path("runs/stable_baselines3_tqc")
    """Folder for TensorBoard and for the agent."""

    learning_starts: int = 500
    """Steps of uniformly random actions before the first update; every later step has one."""
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
    """Price of a nat of information, at the start; the agent tunes it."""
    quantiles: int = 25
    """Atoms by which each critic describes the distribution of returns."""
    truncated_quantiles: int = 2
    """The largest of each critic, which the target leaves out."""
    evaluation_episodes: int = 10
    """Episodes of the deterministic policy, after the last step."""


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    environment = gymnasium.make(args.env_id)
    agent = TQC(
        "MlpPolicy",
        environment,
        learning_rate=args.learning_rate,
        learning_starts=args.learning_starts,
        batch_size=args.batch_size,
        tau=args.polyak,
        gamma=args.discount,
        ent_coef=f"auto_{args.temperature}",
        top_quantiles_to_drop_per_net=args.truncated_quantiles,
        policy_kwargs={"net_arch": list(args.hidden_dims), "n_quantiles": args.quantiles},
        replay_buffer_class=curiosity.CuriousReplayBuffer,  # + bonus
        replay_buffer_kwargs={"bonus_kwargs": {"hidden_dims": args.hidden_dims}},  # + bonus
        tensorboard_log=str(args.out),
        seed=args.seed,
        device="cpu",
    )
    agent.learn(
        args.total_steps,
        callback=curiosity.CuriosityCallback(),  # + bonus
    )
    agent.save(args.out / "agent")

    evaluation_environment = Monitor(gymnasium.make(args.env_id))
    evaluation_environment.reset(seed=1_000 + args.seed)
    evaluation_return, _ = evaluate_policy(
        agent, evaluation_environment, n_eval_episodes=args.evaluation_episodes
    )
    print(f"{args.env_id}: return {evaluation_return:.2f} after {args.total_steps} steps")
    agent.logger.close()
    environment.close()
    evaluation_environment.close()
