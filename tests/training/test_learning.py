"""Learning runs of minutes: `make slow`."""

from pathlib import Path

import pytest

from deep_curiosity.training import Config, train

HALF_OF_ALL_STEPS = 100.0  # of PendulumSwingup: 200 steps that pay at most one each


def evaluation_return(bonus: str, out: Path) -> float:
    settings = Config.of(
        env_id="PendulumSwingup",
        env_kwargs={"action_cost": 0.1},
        total_steps=16_000,
        hidden_dim=64,
        bonus=bonus,
        out=out,
    )
    return train(settings, show_progress=False)["evaluation_return"]


@pytest.mark.slow
def test_curiosity_swings_the_pendulum_up(tmp_path):
    assert evaluation_return("curiosity", tmp_path / "run") > HALF_OF_ALL_STEPS


@pytest.mark.slow
@pytest.mark.parametrize("bonus", ["none", "constant"])
def test_neither_noise_nor_a_constant_bonus_does(tmp_path, bonus):
    assert evaluation_return(bonus, tmp_path / "run") < HALF_OF_ALL_STEPS
