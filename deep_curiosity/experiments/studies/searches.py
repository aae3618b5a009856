"""Searches for settings, made by `deep-curiosity tune NAME`."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("optuna", extra="tune")

from optuna.distributions import CategoricalDistribution, FloatDistribution

from deep_curiosity.experiments.search import Search
from deep_curiosity.experiments.studies.comparisons import MOUNTAIN_CAR, PENDULUM
from deep_curiosity.experiments.study import Task
from deep_curiosity.training.config import Config

STEPS = 8_000  # half of what the studies take: few settings are slow first and better later


def _halved(task: Task) -> Task:
    config = task.config.override(total_steps=STEPS, update_to_data=0.5)
    return Task(task.name, config, task.solved_return)


def _short(env_id: str) -> Task:
    """A task that some agents have begun to learn after a few seconds."""
    config = Config.of(
        env_id=env_id,
        max_episode_steps=200,
        total_steps=1_200,
        learning_starts=200,
        update_to_data=0.25,
        hidden_dim=32,
        num_members=2,
        components=32,
        log_interval=300,
        evaluation_interval=300,
        evaluation_episodes=3,
        compile="off",
        matmul_precision="highest",
    )
    return Task(env_id, config)


SEARCHES = {
    "agent": Search(
        [_halved(PENDULUM), _halved(MOUNTAIN_CAR)],
        {
            "learning_rate": FloatDistribution(1e-4, 1e-2, log=True),
            "temperature": FloatDistribution(2e-3, 0.2, log=True),
            "curiosity_discount": CategoricalDistribution((0.9, 0.97, 0.99)),
            "batch_size": CategoricalDistribution((64, 128, 256)),
        },
        {PENDULUM.name: (0.0, 150.0), MOUNTAIN_CAR.name: (0.0, 95.0)},
    ),
    "short": Search(
        [_short("InvertedPendulum-v5"), _short("InvertedDoublePendulum-v5")],
        {
            "learning_rate": FloatDistribution(1e-4, 1e-2, log=True),
            "temperature": FloatDistribution(2e-3, 0.2, log=True),
            "polyak": FloatDistribution(2e-3, 0.2, log=True),
            "batch_size": CategoricalDistribution((64, 128, 256)),
        },
        {"InvertedPendulum-v5": (5.0, 200.0), "InvertedDoublePendulum-v5": (50.0, 1_870.0)},
        seeds=1,
    ),
}
"""Name of each search to what it is."""
