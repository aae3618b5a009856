"""Learning runs of minutes: `make slow`."""

import functools
from pathlib import Path

import gymnasium
import numpy as np
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


class Spiked(gymnasium.ObservationWrapper):
    """Shows an absurd number at one step of its life."""

    life = 0

    def __init__(self, spike: float) -> None:
        super().__init__(gymnasium.make("Pendulum-v1"))
        self.spike = spike

    def observation(self, observation):
        self.life += 1
        return np.where(self.life == 800, np.float32(self.spike), observation)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`observation` should stay")
def test_one_absurd_observation_leaves_the_return_within_the_spread_of_seeds(tmp_path):
    def returns(name: str, make_env) -> list[float]:
        config = Config.of(total_steps=4_000, hidden_dim=64)
        return [
            train(
                config.override(seed=seed, out=tmp_path / f"{name}{seed}"),
                make_env=make_env,
                show_progress=False,
            )["evaluation_return"]
            for seed in range(5)
        ]

    usual = returns("usual", functools.partial(gymnasium.make, "Pendulum-v1"))
    spiked = returns("spiked", functools.partial(Spiked, 1e12))
    print(f"usual {np.round(usual, 1)}, with one observation of 1e12 {np.round(spiked, 1)}")
    assert min(usual) <= np.median(spiked) <= max(usual)
    assert min(spiked) > 2 * min(usual)  # returns are costs: none is lost
