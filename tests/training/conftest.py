"""Runs small enough to train in a second."""

from pathlib import Path

import pytest

from deep_curiosity.training import Settings


@pytest.fixture
def tiny(tmp_path: Path) -> Settings:
    return Settings(
        env_id="PendulumSwingup",
        env_kwargs={"action_cost": 0.1},
        total_steps=60,
        out=tmp_path / "run",
        hidden_dim=16,
        batch_size=32,
        components=16,
        members=2,
        refresh_interval=3,
        learning_starts=20,
        log_interval=20,
        evaluation_interval=40,
        evaluation_episodes=1,
        checkpoint_interval=25,
        replay_capacity=500,
    )
