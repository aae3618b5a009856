"""The study behind torchrl's adapter: its own soft actor-critic with our transform and without."""

import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
import tyro
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import EnvBase, GymEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import (
    MLP,
    NormalParamExtractor,
    ProbabilisticActor,
    TanhNormal,
    ValueOperator,
)
from torchrl.objectives import SACLoss, SoftUpdate

import deep_curiosity_envs  # noqa: F401  # registers the task
from deep_curiosity.integrations.torchrl import CuriosityTransform
from deep_curiosity.bonuses.registry import BonusLearner, make_bonus
from deep_curiosity.training import Settings
from deep_curiosity.experiments.grid import (
    Task,
    draw_curves,
    markdown_table,
    median_and_range,
    write_table,
)

# 200 steps that pay at most 1 each: no return is above 200, and half of that is asked
TASK = Task("PendulumSwingup", Settings(env_id="PendulumSwingup"), solved_return=100.0)
AGENTS = ("torchrl SAC, curious", "torchrl SAC")
EPISODE_STEPS = 200
LEARNING_STARTS = 500  # steps of random actions before the first update
EVALUATION_EPISODES = 10
EVALUATION_INTERVAL = 2_000
HIDDEN_DIMS = (64, 64)
RESULT_COLUMNS = (
    "task",
    "agent",
    "seed",
    "solved",
    "evaluation_return",
    "mean_training_return",
    "total_steps",
    "wall_seconds",
)
CURVE_COLUMNS = ("task", "agent", "seed", "step", "evaluation_return")


@dataclass(frozen=True)
class Run:
    """One agent with one seed."""

    agent: str
    seed: int
    folder: Path
    total_steps: int
    weight: float


@dataclass(frozen=True)
class Args:
    """How many runs, how long, and where."""

    seeds: int = 5
    """Seeds of each agent."""
    total_steps: int = 16_000
    """Environment steps of each run; an update follows each."""
    weight: float = 0.1
    """Of the standardised bonus."""
    runs: Path = Path("runs/study/torchrl")
    """Folder for the runs; finished ones there are not run again."""
    out: Path = Path("docs/study")
    """Folder for tables and picture."""
    workers: int = 1
    """Processes at a time."""


def run_once(run: Run) -> dict[str, Any]:
    """Result of a run: read where it is finished, else trained for."""
    path = run.folder / f"seed{run.seed}.json"
    if not path.exists():
        torch.set_num_threads(1)
        result = train(run)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result))
    loaded: dict[str, Any] = json.loads(path.read_text())
    return loaded


def train(run: Run) -> dict[str, Any]:
    """Train an agent, step by step; with curiosity by a transform on its replay alone."""
    start = time.perf_counter()
    torch.manual_seed(run.seed)
    env, evaluation_env = make_env(run.seed), make_env(run.seed + 1_000)
    actor, critic = make_networks(env)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(run.total_steps), batch_size=256)
    if run.agent == AGENTS[0]:
        bonus = make_bonus(
            "curiosity", 3, 1, hidden_dims=HIDDEN_DIMS, weight=run.weight, member_per_row=True
        )
        transform = CuriosityTransform(BonusLearner(bonus), add_to_reward=True, policy=actor)
        replay.append_transform(transform)
    loss = SACLoss(actor, critic, loss_function="l2")
    loss.make_value_estimator(gamma=0.99)
    target = SoftUpdate(loss, tau=0.02)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)
    collector = Collector(
        env,
        actor,
        frames_per_batch=1,
        total_frames=run.total_steps,
        init_random_frames=LEARNING_STARTS,
        auto_register_policy_transforms=False,
    )
    total_reward, curve = 0.0, []
    for step, rollout in enumerate(collector, 1):
        replay.extend(rollout)
        total_reward += rollout["next", "reward"].item()
        if step >= LEARNING_STARTS:
            update(replay.sample(), loss, optimizer, target)
        if step % EVALUATION_INTERVAL == 0 or step == run.total_steps:
            curve.append({"step": step, "evaluation_return": evaluate(evaluation_env, actor)})
            print(run.agent, run.seed, curve[-1], flush=True)
    collector.shutdown()
    return {
        "evaluation_return": curve[-1]["evaluation_return"],
        "mean_training_return": total_reward / run.total_steps * EPISODE_STEPS,
        "total_steps": run.total_steps,
        "wall_seconds": time.perf_counter() - start,
        "curve": curve,
    }


def update(
    batch: TensorDictBase, loss: SACLoss, optimizer: torch.optim.Optimizer, target: SoftUpdate
) -> None:
    """One gradient step on actor, critics and temperature, then the target critics follow."""
    losses = loss(batch)
    optimizer.zero_grad()
    (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
    optimizer.step()
    target.step()


@torch.no_grad()
def evaluate(env: EnvBase, actor: ProbabilisticActor) -> float:
    """Mean return of deterministic episodes."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        episodes = [env.rollout(EPISODE_STEPS, actor) for _ in range(EVALUATION_EPISODES)]
    return sum(episode["next", "reward"].sum().item() for episode in episodes) / len(episodes)


def make_env(seed: int) -> EnvBase:
    """The task, seeded: an action costs reward, and doing nothing earns zero."""
    env = GymEnv("deep_curiosity/PendulumSwingup-v0", action_cost=0.1)
    env.set_seed(seed)
    return env


def make_networks(env: EnvBase) -> tuple[ProbabilisticActor, ValueOperator]:
    """Actor and critic as torchrl's examples build them."""
    network = nn.Sequential(
        MLP(in_features=3, out_features=2, num_cells=HIDDEN_DIMS, activation_class=nn.ReLU),
        NormalParamExtractor(),
    )
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(
        MLP(in_features=4, out_features=1, num_cells=HIDDEN_DIMS, activation_class=nn.ReLU),
        in_keys=["observation", "action"],
    )
    return actor, critic


def write_study(out: Path, runs: Sequence[Run], results: Sequence[dict[str, Any]]) -> str:
    """Write tables, curves and picture; return the summary."""
    rows, curves = [], []
    for run, result in zip(runs, results, strict=True):
        cell = {"task": TASK.name, "agent": run.agent, "seed": run.seed}
        solved = result["evaluation_return"] >= TASK.solved_return
        rows.append(cell | {"solved": int(solved)} | result)
        curves += [cell | point for point in result["curve"]]
    out.mkdir(parents=True, exist_ok=True)
    write_table(out / "torchrl.csv", RESULT_COLUMNS, rows)
    write_table(out / "torchrl_curves.csv", CURVE_COLUMNS, curves)
    draw_curves(out / "torchrl.png", [TASK], AGENTS, rows, curves)
    summary = summarize(rows)
    (out / "torchrl.md").write_text(summary)
    return summary


def summarize(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown table: seeds solved, and median and range over seeds."""
    header = ["agent", "seeds solved", "evaluation return", "mean training return"]
    lines = []
    for agent in AGENTS:
        own = [row for row in rows if row["agent"] == agent]
        spreads = [
            median_and_range([row[name] for row in own])
            for name in ("evaluation_return", "mean_training_return")
        ]
        solved = f"{sum(row['solved'] for row in own)} of {len(own)}"
        lines.append([agent, solved, *spreads])
    return markdown_table(header, lines) + "\n"


def main() -> None:
    """Run the study and print its table."""
    args = tyro.cli(Args, description=__doc__)
    runs = [
        Run(agent, seed, args.runs / agent, args.total_steps, args.weight)
        for seed in range(args.seeds)
        for agent in AGENTS
    ]
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        results = list(pool.map(run_once, runs))
    print(write_study(args.out, runs, results))


if __name__ == "__main__":
    main()
