"""A task whose actions are in units of their own, and runs of it."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from deep_curiosity.training import train

TASK = "trained/Slope-v0"
LOW, HIGH = (-2.0, 0.0), (2.0, 3.0)


class Slope(gymnasium.Env):
    """A point that actions push along two axes; its third entry is a battery that drains."""

    observation_space = spaces.Box(-np.inf, np.inf, (3,))
    action_space = spaces.Box(np.array(LOW, np.float32), np.array(HIGH, np.float32))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.point = np.append(self.np_random.normal(size=2), 1.0)
        return self.point.astype(np.float32), {}

    def step(self, action):
        assert self.action_space.contains(action)
        self.point = self.point + 0.1 * np.append(self.push(action), -0.5)
        reward = -float(np.abs(self.point[:2]).sum())
        return self.point.astype(np.float32), reward, False, False, {}

    def push(self, action):
        return action


gymnasium.register(TASK, Slope, max_episode_steps=15)


@pytest.fixture(scope="session")
def far_run(slope_config, tmp_path_factory):
    """Folder of a run whose actions lie where float32 tells few of them apart."""

    class Far(Slope):
        action_space = spaces.Box(np.array([0.1, 1e6]), np.array([0.3, 1e6 + 1]), dtype=np.float64)

        def push(self, action):
            return action - self.action_space.low

    folder = tmp_path_factory.mktemp("far") / "run"
    train(slope_config.override(env_id="make_env", out=folder), make_env=Far, show_progress=False)
    return folder


@pytest.fixture(scope="session")
def slope_config(tiny_config):
    return tiny_config.override(env_id=TASK, env_kwargs={}, total_steps=45)


@pytest.fixture(scope="session")
def run_of(slope_config, tmp_path_factory):
    """Folder of a run with some settings, which is trained once."""
    folders = {}

    def find(**settings):
        key = tuple(sorted(settings.items()))
        if key not in folders:
            folders[key] = tmp_path_factory.mktemp("trained") / "run"
            train(slope_config.override(out=folders[key], **settings), show_progress=False)
        return folders[key]

    return find
