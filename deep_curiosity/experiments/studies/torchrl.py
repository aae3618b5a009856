"""Torchrl's own soft actor-critic with our transform on its replay buffer and without."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("torchrl", extra="torchrl")

import time

import torch
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

from deep_curiosity.bonuses import BonusLearner, make_bonus
from deep_curiosity.experiments.runs import run_foreign
from deep_curiosity.experiments.studies.comparisons import PENDULUM
from deep_curiosity.experiments.study import Cell, Result, Row, Study
from deep_curiosity.integrations.torchrl import CuriosityTransform
from deep_curiosity.training.environments import registered_id

EPISODE_STEPS = 200
EVALUATION_EPISODES = 10
EVALUATION_INTERVAL = 2_000
HIDDEN_DIMS = (64, 64)


def train_cell(cell: Cell) -> tuple[Row, list[Row]]:
    """Train an agent, step by step; with curiosity by a transform on its replay alone."""
    torch.set_num_threads(1)
    start, course = time.perf_counter(), cell.task.config.run
    torch.manual_seed(cell.seed)
    env, evaluation_env = make_env(cell, cell.seed), make_env(cell, cell.seed + 1_000)
    actor, critic = make_networks(env)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(course.total_steps), batch_size=256)
    if cell.study.agents[cell.agent]["curiosity"]:
        bonus = make_bonus("curiosity", 3, 1, hidden_dims=HIDDEN_DIMS)
        replay.append_transform(
            CuriosityTransform(BonusLearner(bonus), add_to_reward=True, policy=actor)
        )
    update = make_update(actor, critic)
    collector = Collector(
        env,
        actor,
        frames_per_batch=1,
        total_frames=course.total_steps,
        init_random_frames=course.learning_starts,
        auto_register_policy_transforms=False,
    )
    total_reward, curve = 0.0, []
    for step, rollout in enumerate(collector, 1):
        replay.extend(rollout)
        total_reward += rollout["next", "reward"].item()
        if step >= course.learning_starts:
            update(replay.sample())
        if step % EVALUATION_INTERVAL == 0 or step == course.total_steps:
            curve.append({"step": step, "evaluation_return": evaluate(evaluation_env, actor)})
    collector.shutdown()
    row = {
        "evaluation_return": curve[-1]["evaluation_return"],
        "mean_training_return": total_reward / course.total_steps * EPISODE_STEPS,
        "total_steps": course.total_steps,
        "wall_seconds": time.perf_counter() - start,
    }
    return row, curve


def make_update(actor: ProbabilisticActor, critic: ValueOperator):  # noqa: ANN201  a closure
    """One gradient step on actor, critics and temperature, then the target critics follow."""
    loss = SACLoss(actor, critic, loss_function="l2")
    loss.make_value_estimator(gamma=0.99)
    target = SoftUpdate(loss, tau=0.02)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)

    def update(batch) -> None:  # noqa: ANN001  as the buffer gives it
        losses = loss(batch)
        optimizer.zero_grad()
        (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
        optimizer.step()
        target.step()

    return update


@torch.no_grad()
def evaluate(env: EnvBase, actor: ProbabilisticActor) -> float:
    """Mean return of deterministic episodes."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        episodes = [env.rollout(EPISODE_STEPS, actor) for _ in range(EVALUATION_EPISODES)]
    return sum(episode["next", "reward"].sum().item() for episode in episodes) / len(episodes)


def make_env(cell: Cell, seed: int) -> EnvBase:
    """The task, seeded."""
    environment = cell.task.config.environment
    env = GymEnv(registered_id(environment.env_id), **environment.env_kwargs)
    env.set_seed(seed)
    return env


def make_networks(env: EnvBase) -> tuple[ProbabilisticActor, ValueOperator]:
    """Actor and critic as torchrl's examples build them."""
    shape = {"num_cells": HIDDEN_DIMS, "activation_class": nn.ReLU}
    network = nn.Sequential(MLP(3, 2, **shape), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    return actor, ValueOperator(MLP(4, 1, **shape), in_keys=["observation", "action"])


def run(cell: Cell) -> Result:
    """Result of a cell: read where it is finished, else trained."""
    return run_foreign(cell, train_cell)


STUDIES = {
    "torchrl": Study(
        [PENDULUM],
        {"torchrl SAC, curious": {"curiosity": True}, "torchrl SAC": {"curiosity": False}},
        columns=("evaluation_return", "mean_training_return"),
        run=run,
        curves=True,
    )
}
