import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from deep_curiosity.integrations.check.profile import profile


class Scripted(gymnasium.Env):
    """Gives back a list of observations, in episodes of five steps."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,))
    action_space = spaces.Box(-1, 1, (1,))

    def __init__(self, observations):
        self.observations = iter(observations)
        self.steps = 0

    def reset(self, *, seed=None, options=None):
        return np.zeros(2), {}

    def step(self, action):
        self.steps += 1
        return np.array(next(self.observations)), self.steps, False, self.steps % 5 == 0, {}


def test_ranges_are_those_observed():
    found = profile(Scripted([(i, 7) for i in range(10)]), num_steps=10)
    first, second = found.features()
    assert (first["lowest"], first["highest"], first["std"]) == ("0", "9", "2.87")
    assert second["note"] == "never moves"
    assert found.reward_range == (1.0, 10.0) and found.num_episodes == 2


def test_heavy_tails_are_distinguished_from_light_ones():
    random = np.random.default_rng(0)
    values = np.stack([random.standard_t(2, 2_000), random.normal(size=2_000)], axis=1)
    heavy, light = profile(Scripted(values), num_steps=2_000).features()
    assert heavy["note"] == "heavy tail" and light["note"] == ""


def test_what_is_not_finite_is_counted_and_left_out():
    found = profile(Scripted([(1, 1), (np.nan, 1), (np.inf, 1), (2, 1)]), num_steps=4)
    assert found.num_not_finite == 2 and len(found.observation) == 2


def test_an_environment_of_nothing_but_nan_is_an_error():
    with pytest.raises(ValueError, match="`observation` must be finite"):
        profile(Scripted([(np.nan, 1)] * 3), num_steps=3)
