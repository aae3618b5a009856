"""Runs of tasks that are as tasks of users are: unsteady, absurd, endless, registered anywhere."""

import json
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from deep_curiosity.training import continue_run, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.environments import make_vector_environment
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.log import read_progress


class Mass(gymnasium.Env):
    """A mass on a line that is pushed; now and then something is wrong with what it shows."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    breaks = False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.np_random.normal(size=2)
        self.time = 0
        self.is_unsteady = self.np_random.uniform() < 0.3
        return self.state, {}

    def step(self, action):
        self.time += 1
        self.state[0] += 0.1 * self.state[1]
        self.state[1] += 0.1 * float(action[0])
        if self.breaks and self.is_unsteady and self.time == 4:
            self.state[:] = np.nan
        reward = -float(np.square(self.state).sum())
        return self.state, reward, False, self.time >= 10, {}


class Unsteady(Mass):
    breaks = True


class Spiked(Mass):
    """Shows one absurd number in its life."""

    life = 0
    spike = 0.0
    spiked_reward = 0.0

    def step(self, action):
        observation, reward, *rest = super().step(action)
        self.life += 1
        if self.life != 105:
            return observation, reward, *rest
        return observation + np.array([self.spike, 0.0]), reward + self.spiked_reward, *rest


@pytest.fixture
def small(tiny):
    return tiny.override(
        env_id="make_env", env_kwargs={}, max_episode_steps=10, total_steps=100, num_envs=1
    )


BREAKS = pytest.mark.filterwarnings("ignore:`observation` and `reward` must be finite")


@BREAKS
@pytest.mark.parametrize(("num_envs", "reward_steps"), [(1, 1), (3, 3)])
def test_a_run_goes_on_where_its_simulator_breaks_and_resumes_to_the_bit(
    small, tmp_path, num_envs, reward_steps
):
    config = small.override(num_envs=num_envs, reward_steps=reward_steps)
    summary = train(config, make_env=Unsteady, show_progress=False)
    assert summary["total_steps"] >= 100 and summary["broken_episodes"] > 0
    assert float(read_progress(config.run.out)[-1]["episode/broken"]) == summary["broken_episodes"]
    replay = load_checkpoint(config.run.out)["learner"]["replay"]["rows"]
    assert torch.isfinite(replay).all()
    part = config.override(out=tmp_path / "part", total_steps=50)
    train(part, make_env=Unsteady, show_progress=False)
    continue_run(part.run.out, total_steps=100, make_env=Unsteady, show_progress=False)
    whole, resumed = (load_checkpoint(each.run.out) for each in (config, part))
    assert replay.equal(resumed["learner"]["replay"]["rows"])
    for name, value in whole["learner"]["agent"].items():
        torch.testing.assert_close(
            value, resumed["learner"]["agent"][name], rtol=0, atol=0, equal_nan=True
        )
    assert str(whole["run_log"]["episodes"]) == str(resumed["run_log"]["episodes"])


def test_a_run_on_a_function_says_that_it_must_be_given_again(small):
    config = small.override(env_id=type(small.environment)().env_id, total_steps=40)
    train(config, make_env=Mass, show_progress=False)
    settings = json.loads((config.run.out / "config.json").read_text())
    assert settings["env_id"] == "make_env" and settings["max_episode_steps"] == 10
    with pytest.raises(ValueError, match=r"`make_env` must be given again.*got None"):
        continue_run(config.run.out, total_steps=60, show_progress=False)
    summary = continue_run(config.run.out, total_steps=60, make_env=Mass, show_progress=False)
    assert summary["total_steps"] == 60
    summary = train(
        config.override(total_steps=80), resume=True, make_env=Mass, show_progress=False
    )
    assert summary["total_steps"] == 80


@pytest.mark.plotted
def test_a_run_on_a_function_leaves_its_picture(small):
    train(small.override(total_steps=40), make_env=Mass, show_progress=False)
    assert (small.run.out / "run.png").exists()


@pytest.mark.filterwarnings("ignore:`observation` should stay")  # it goes far beyond 30 steps
def test_a_task_without_end_is_told_of_and_its_evaluation_ends(small):
    class Endless(Mass):
        def step(self, action):
            return *super().step(action)[:3], False, {}

    config = small.override(max_episode_steps=None, total_steps=30)
    with pytest.warns(UserWarning, match="`max_episode_steps` should be set"):
        train(config, make_env=Endless, show_progress=False)
    (episode,) = load_checkpoint(config.run.out)["run_log"]["evaluations"]
    assert episode[1] == 1_000


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_know_a_task_that_is_registered_in_a_script(tmp_path, method):
    (tmp_path / "script.py").write_text(f"""
import multiprocessing
import gymnasium
from gymnasium.envs.classic_control import PendulumEnv
class Mine(PendulumEnv):
    pass
if __name__ == "__main__":
    gymnasium.register("Mine-v0", entry_point=Mine, max_episode_steps=10)
    multiprocessing.set_start_method({method!r})
    from deep_curiosity.training.collector import Collector
    from deep_curiosity.training.config import EnvironmentConfig
    from deep_curiosity.training.environments import make_vector_environment
    import numpy as np
    config = EnvironmentConfig("Mine-v0", num_envs=2, vectorization="async")
    environments = make_vector_environment(config)
    step, _ = Collector(environments, seed=0).step(np.zeros((2, 1), np.float32))
    print(step.reward.shape)
    environments.close()
""")
    run = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.stdout == "(2,)\n", run.stderr


def test_what_a_native_environment_returned_stays_as_it_was(tiny):
    config = tiny.override(env_id="PointMaze", env_kwargs={}, num_envs=3).environment
    collector = Collector(make_vector_environment(config), seed=0)
    action = np.full((3, 2), 0.5, np.float32)
    taken = [collector.step(action)[0] for _ in range(4)]
    kept = [[field.copy() for field in step] for step in taken]
    for _ in range(4):
        collector.step(-action)
    for step, copy in zip(taken, kept, strict=True):
        assert all(np.array_equal(*pair) for pair in zip(step, copy, strict=True))
    collector.environment.close()


def critics_after_a_spike(config, num_updates, **spike):
    """Share of critic parameters that stood still in the updates, and the learner."""
    torch.manual_seed(0)
    environment = Spiked()
    for name, value in spike.items():
        setattr(environment, name, value)
    collector = Collector(environment, seed=0)
    learner = Learner(config, 2, 1)
    for _ in range(150):
        action = learner.act(collector.observation, explore_uniformly=True)
        learner.store(collector.step(action)[0])
    before = [parameter.clone() for parameter in learner.agent.critics.parameters()]
    for _ in range(num_updates):
        learner.update()
    after = list(learner.agent.critics.parameters())
    frozen = sum(int((b == a).sum()) for b, a in zip(before, after, strict=True))
    return frozen / sum(map(torch.numel, after)), learner


def assert_finite(state):
    for value in state.values() if isinstance(state, dict) else state:
        if isinstance(value, dict | list | tuple):
            assert_finite(value)
        elif isinstance(value, torch.Tensor) and value.is_floating_point():
            assert torch.isfinite(value).all()


@pytest.mark.filterwarnings("ignore:`observation` should stay", "ignore:`reward` should stay")
@pytest.mark.parametrize(
    "spike",
    [{"spike": size} for size in (1e6, 1e12, 1e25, 3e38)] + [{"spiked_reward": 1e30}],
    ids=str,
)
def test_after_one_absurd_number_everything_that_is_learned_is_finite(small, spike):
    _, learner = critics_after_a_spike(small.override(compile="off"), 60, **spike)
    assert torch.isfinite(learner.replay.all().next_observation).all()
    state = learner.state_dict()
    assert_finite({name: state[name] for name in ("bonus", "bonus_optimizer")})
    assert_finite(list(learner.agent.parameters()))
    assert all(torch.isfinite(value) for value in learner.update().values())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`observation` should stay")
def test_one_absurd_observation_freezes_no_critics(small):
    config = small.override(compile="off", hidden_dim=64, batch_size=64)
    usual, _ = critics_after_a_spike(config, 2_000)
    spiked, _ = critics_after_a_spike(config, 2_000, spike=1e12)
    assert spiked <= usual + 0.05
