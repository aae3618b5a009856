"""The study of Stable-Baselines3: SAC and TD3 with a curious replay buffer and without."""

import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from deep_curiosity.integrations.stable_baselines3 import CuriosityCallback, CuriousReplayBuffer
from deep_curiosity.training import Settings
from deep_curiosity.experiments.grid import (
    CURVE_COLUMNS,
    Task,
    draw_curves,
    summarize,
    write_table,
)

TASK = Task(
    "MountainCarContinuous-v0",
    Settings(env_id="MountainCarContinuous-v0", total_steps=20_000),
    solved_return=90.0,
)
EVALUATION_INTERVAL = 2_000
EVALUATION_EPISODES = 10
RESULT_COLUMNS = (
    "task",
    "agent",
    "seed",
    "solved",
    "evaluation_return",
    "mean_training_return",
    "first_success_step",
    "total_steps",
    "wall_seconds",
)
SHARED: dict[str, Any] = {
    "learning_rate": 1e-3,
    "tau": 0.02,
    "gamma": 0.99,
    "learning_starts": 1_000,
    "policy_kwargs": {"net_arch": [64, 64]},
    "device": "cpu",
}
SAC_ALONE = {"ent_coef": "auto_0.1", "batch_size": 128, "train_freq": 2}
TD3_ALONE = {"batch_size": 256, "train_freq": 1}  # with half as many updates its actor saturates
CURIOUS: dict[str, Any] = {
    "replay_buffer_class": CuriousReplayBuffer,
    "replay_buffer_kwargs": {
        "bonus": "curiosity",
        "bonus_kwargs": {"hidden_dims": (64, 64), "member_per_row": True},
    },
}
AGENTS = ("SAC, curious", "SAC", "TD3, curious", "TD3")


def make_agent(name: str, seed: int) -> OffPolicyAlgorithm:
    """An agent of the study; the curious one differs from the plain one by its buffer alone."""
    settings = deepcopy(SHARED | (CURIOUS if "curious" in name else {}))  # agents add to theirs
    if name.startswith("SAC"):
        return SAC("MlpPolicy", TASK.name, seed=seed, **SAC_ALONE, **settings)
    noise = NormalActionNoise(np.zeros(1), np.full(1, 0.1))
    return TD3("MlpPolicy", TASK.name, action_noise=noise, seed=seed, **TD3_ALONE, **settings)


def run_once(agent: str, seed: int, folder: Path) -> dict[str, Any]:
    """Result of a run: read where it is finished, else trained and written."""
    path = folder / f"{agent.replace(', ', '_')}_seed{seed}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(train(agent, seed), indent=1))
    result: dict[str, Any] = json.loads(path.read_text())
    return result


def train(agent: str, seed: int) -> dict[str, Any]:
    """Train an agent, and evaluate its deterministic policy on environments of its own."""
    torch.set_num_threads(1)
    model = make_agent(agent, seed)
    model.set_logger(configure(format_strings=[]))
    evaluation = Evaluation(seed=1_000 + seed)
    curiosity = [CuriosityCallback()] if "curious" in agent else []
    start = time.monotonic()
    model.learn(TASK.settings.total_steps, callback=[evaluation, *curiosity])
    return {
        "curve": evaluation.curve,
        "wall_seconds": time.monotonic() - start,
        **training_of(model),
    }


class Evaluation(BaseCallback):
    """Mean return of the deterministic policy at fixed intervals."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.env = make_vec_env(TASK.name, EVALUATION_EPISODES, seed=seed)
        self.curve: list[dict[str, float]] = []

    def _on_step(self) -> bool:
        if self.num_timesteps % EVALUATION_INTERVAL == 0:
            mean, _ = evaluate_policy(self.model, self.env, EVALUATION_EPISODES)
            point = {"step": self.num_timesteps, "evaluation_return": float(mean)}
            self.curve.append(point)
        return True


def training_of(model: OffPolicyAlgorithm) -> dict[str, Any]:
    """Mean return of the training episodes, and the step at which the flag was first reached."""
    env = model.get_env()
    assert env is not None
    (returns,), (lengths,) = (
        env.env_method(f"get_episode_{kind}") for kind in ("rewards", "lengths")
    )
    ends = np.cumsum(lengths)
    # the flag pays 100 and the way there costs less, so a return above zero has reached it
    successes = ends[np.array(returns) > 0]
    return {
        "mean_training_return": float(np.mean(returns)),
        "first_success_step": int(successes[0]) if len(successes) else None,
    }


def report(cells: Sequence[tuple[str, int]], results: Sequence[dict[str, Any]], out: Path) -> None:
    """Write table, curves, summary and picture."""
    rows, curves = [], []
    for (agent, seed), result in zip(cells, results, strict=True):
        cell = {"task": TASK.name, "agent": agent, "seed": seed}
        final = result["curve"][-1]
        solved = {"solved": int(final["evaluation_return"] >= TASK.solved_return)}
        rows.append(cell | solved | result | final | {"total_steps": final["step"]})
        curves += [cell | point for point in result["curve"]]
    out.parent.mkdir(parents=True, exist_ok=True)
    write_table(out.with_suffix(".csv"), RESULT_COLUMNS, rows)
    write_table(out.with_name(f"{out.name}_curves.csv"), CURVE_COLUMNS, curves)
    out.with_suffix(".md").write_text(summarize(rows))
    draw_curves(out.with_suffix(".png"), [TASK], AGENTS, rows, curves)
    print(summarize(rows))


@dataclass(frozen=True)
class Args:
    """How many runs, and where."""

    seeds: int = 5
    """Seeds of each agent."""
    runs: Path = Path("runs/study/stable_baselines3")
    """Folder for the results of the runs; finished ones there are not run again."""
    out: Path = Path("docs/study")
    """Folder for table and picture."""
    workers: int = 2
    """Processes at a time."""


def main() -> None:
    """Run the study and print its table."""
    args = tyro.cli(Args, description=__doc__)
    cells = [(agent, seed) for seed in range(args.seeds) for agent in AGENTS]
    agents, seeds = zip(*cells, strict=True)
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        results = list(pool.map(run_once, agents, seeds, [args.runs] * len(cells)))
    report(cells, results, args.out / "stable_baselines3")


if __name__ == "__main__":
    main()
