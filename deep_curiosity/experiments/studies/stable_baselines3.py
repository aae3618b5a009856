"""Stable-Baselines3's SAC and TD3 with a curious replay buffer and without."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("stable_baselines3", extra="sb3")

import time
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from deep_curiosity.experiments.runs import run_foreign
from deep_curiosity.experiments.studies.comparisons import MOUNTAIN_CAR
from deep_curiosity.experiments.study import Cell, Result, Row, Study, Task
from deep_curiosity.integrations.stable_baselines3 import CuriosityCallback, CuriousReplayBuffer

EVALUATION_INTERVAL = 2_000
EVALUATION_EPISODES = 10
SHARED: dict[str, Any] = {
    "learning_rate": 1e-3,
    "tau": 0.02,
    "gamma": 0.99,
    "learning_starts": 1_000,
    "policy_kwargs": {"net_arch": [64, 64]},
    "device": "cpu",
}
SAC_ALONE = {"kind": "SAC", "ent_coef": "auto_0.1", "batch_size": 128, "train_freq": 2}
# with half as many updates its actor saturates
TD3_ALONE = {"kind": "TD3", "batch_size": 256, "train_freq": 1}
CURIOUS: dict[str, Any] = {"bonus": "curiosity", "bonus_kwargs": {"hidden_dims": (64, 64)}}


def make_agent(env_id: str, seed: int, settings: dict[str, Any]) -> OffPolicyAlgorithm:
    """An agent of the study; the curious one differs from the plain one by its buffer alone."""
    options = deepcopy(SHARED | settings)  # agents add to theirs
    kind, curiosity = options.pop("kind"), options.pop("curiosity", None)
    if curiosity is not None:
        options |= {"replay_buffer_class": CuriousReplayBuffer, "replay_buffer_kwargs": curiosity}
    if kind == "SAC":
        return SAC("MlpPolicy", env_id, seed=seed, **options)
    noise = NormalActionNoise(np.zeros(1), np.full(1, 0.1))
    return TD3("MlpPolicy", env_id, action_noise=noise, seed=seed, **options)


def train_cell(cell: Cell) -> tuple[Row, list[Row]]:
    """Train an agent, and evaluate its deterministic policy on environments of its own."""
    torch.set_num_threads(1)
    settings = dict(cell.study.agents[cell.agent])
    env_id = cell.task.config.environment.env_id
    model = make_agent(env_id, cell.seed, settings)
    model.set_logger(configure(format_strings=[]))
    evaluation = Evaluation(env_id, seed=1_000 + cell.seed)
    callbacks = [evaluation, *([CuriosityCallback()] if "curiosity" in settings else [])]
    start = time.monotonic()
    model.learn(cell.task.config.run.total_steps, callback=callbacks)
    row = {
        "evaluation_return": evaluation.curve[-1]["evaluation_return"],
        **training_of(model),
        "total_steps": model.num_timesteps,
        "wall_seconds": time.monotonic() - start,
    }
    return row, evaluation.curve


class Evaluation(BaseCallback):
    """Mean return of the deterministic policy at fixed intervals."""

    def __init__(self, env_id: str, seed: int) -> None:
        super().__init__()
        self.env = make_vec_env(env_id, EVALUATION_EPISODES, seed=seed)
        self.curve: list[Row] = []

    def _on_step(self) -> bool:
        if self.num_timesteps % EVALUATION_INTERVAL == 0:
            mean, _ = evaluate_policy(self.model, self.env, EVALUATION_EPISODES)
            self.curve.append(
                {"step": self.num_timesteps, "evaluation_return": float(np.mean(mean))}
            )
        return True


def training_of(model: OffPolicyAlgorithm) -> Row:
    """Mean return of the training episodes, and the step at which the flag was first reached."""
    env = model.get_env()
    assert env is not None
    (returns,), (lengths,) = (
        env.env_method(f"get_episode_{kind}") for kind in ("rewards", "lengths")
    )
    # the flag pays 100 and the way there costs less, so a return above zero has reached it
    successes = np.cumsum(lengths)[np.array(returns) > 0]
    return {
        "mean_training_return": float(np.mean(returns)),
        "first_success_step": int(successes[0]) if len(successes) else None,
    }


def run(cell: Cell) -> Result:
    """Result of a cell: read where it is finished, else trained."""
    return run_foreign(cell, train_cell)


STUDIES = {
    "stable_baselines3": Study(
        [Task(MOUNTAIN_CAR.name, MOUNTAIN_CAR.config.override(total_steps=20_000), 90.0)],
        {
            "SAC, curious": SAC_ALONE | {"curiosity": CURIOUS},
            "SAC": SAC_ALONE,
            "TD3, curious": TD3_ALONE | {"curiosity": CURIOUS},
            "TD3": TD3_ALONE,
        },
        run=run,
        curves=True,
    )
}
