import itertools
import json

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import deep_curiosity as dc
from deep_curiosity.training import Config, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.log import read_config, read_progress
from tests.trained.conftest import TASK

TINY = {
    "total_steps": 40,
    "learning_starts": 20,
    "hidden_dim": 16,
    "batch_size": 16,
    "components": 16,
    "num_members": 2,
    "log_interval": 20,
    "evaluation_episodes": 1,
    "matmul_precision": "highest",
    "show_progress": False,
}


def test_a_run_in_one_call(tmp_path):
    run = dc.train(env=TASK, out=tmp_path / "run", seed=3, **TINY)
    assert run.folder == tmp_path / "run"
    assert run.summary == json.loads((run.folder / "summary.json").read_text())
    config = read_config(run.folder)
    assert (config.run.seed, config.environment.env_id) == (3, TASK)
    observation = np.array([0.1, 0.2, 0.3])
    action, _ = run.policy.predict(observation)
    np.testing.assert_array_equal(action, dc.load(run.folder).predict(observation)[0])
    assert run.model.predict(observation, action).mean.shape == (3,)
    assert run.bonus.ready


def test_callbacks_are_told_and_stop_a_run_that_lies_where_it_began(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = []
    each = TINY | {"evaluation_interval": 20}
    run = dc.train(env=TASK, out="run", on_evaluation=lambda step, _: step == 20, **each)
    assert run.summary["total_steps"] == 20
    run = dc.continue_run(
        "run", on_evaluation=lambda step, values: told.append(step), show_progress=False
    )
    assert told == [40]
    monkeypatch.chdir(tmp_path.parent)
    assert run.policy.predict(np.zeros(3))[0].shape == (2,)


class Arm(gymnasium.Env):
    """Observations are dictionaries in dictionaries, actions lie in [-2, 2]."""

    observation_space = spaces.Dict(
        {
            "joint": spaces.Dict({"speed": spaces.Box(-9, 9, (2,)), "angle": spaces.Box(-9, 9)}),
            "goal": spaces.Box(-1, 1, (1,)),
        }
    )
    action_space = spaces.Box(-2.0, 2.0, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.speed = np.zeros(2, np.float32)
        return self.seen(), {}

    def step(self, action):
        self.speed = 0.9 * self.speed + 0.1 * action
        return self.seen(), -1.0, False, False, {}

    def seen(self):
        one = np.ones(1, np.float32)
        return {"joint": {"speed": self.speed, "angle": 2 * one}, "goal": 0.5 * one}


@pytest.mark.parametrize("settings", [{}, {"frame_stack": 2}, {"observation_keys": ("joint",)}])
def test_a_task_of_ones_own_with_dictionaries(tmp_path, settings):
    def make_env():
        return Arm()

    run = dc.train(
        make_env=make_env, out=tmp_path / "run", max_episode_steps=20, **settings, **TINY
    )
    policy = run.policy
    observation, _ = make_env().reset(seed=0)
    observation["joint"]["speed"] = np.array([0.25, 0.5], np.float32)
    action, _ = policy.predict(observation)
    assert make_env().action_space.contains(action)
    entries = [0.5] if not settings.get("observation_keys") else []
    vector = [*entries, 2.0, 0.25, 0.5]  # in gymnasium's order, that of the alphabet
    np.testing.assert_array_equal(action, policy.predict(vector)[0])
    assert not np.allclose(action, policy.predict([*entries, 2.0, 0.5, 0.25])[0])
    again = dc.continue_run(
        tmp_path / "run", total_steps=60, make_env=make_env, show_progress=False
    )
    assert again.summary["total_steps"] == 60


@pytest.mark.parametrize("given", [{"env": TASK}, {"env_id": Config().environment.env_id}])
def test_a_task_is_given_by_an_id_or_by_a_function(tmp_path, given):
    with pytest.raises(ValueError, match="`env_id` must be left out beside `make_env`, got '"):
        dc.train(make_env=lambda: gymnasium.make(TASK), out=tmp_path / "run", **given, **TINY)
    with pytest.raises(ValueError, match="`env` must be left out beside `env_id`, got '"):
        dc.train(TASK, env_id="PointMaze", out=tmp_path / "run", **TINY)
    assert not (tmp_path / "run").exists()


def test_a_run_goes_on(tmp_path):
    dc.train(TASK, out=tmp_path / "run", **TINY)
    run = dc.continue_run(tmp_path / "run", total_steps=60, show_progress=False)
    assert run.summary["total_steps"] == 60
    assert run.policy.predict(np.zeros(3))[0].shape == (2,)


@pytest.mark.parametrize("hunger", [0.5, "conditioned:0.5", "linear:1:10"])
def test_hunger_is_a_setting(tmp_path, hunger):
    run = dc.train(TASK, out=tmp_path / "run", hunger=hunger, **TINY)
    assert read_config(run.folder).agent.hunger == dc.Config.of(hunger=hunger).agent.hunger


def test_hunger_is_a_function(tmp_path):
    run = dc.train(TASK, out=tmp_path / "run", hunger=lambda observation, info: 0.25, **TINY)
    assert read_config(run.folder).agent.hunger == 1.0
    assert {float(row["agent/hunger"]) for row in read_progress(run.folder)} == {0.25}


def test_hunger_may_be_a_schedule(tmp_path):
    schedule = dc.Config.of(hunger="linear:1:10").agent.hunger
    run = dc.train(TASK, out=tmp_path / "run", hunger=schedule, **TINY)
    assert read_config(run.folder).agent.hunger == schedule


def test_a_preset_is_taken_as_on_the_command_line(tmp_path):
    run = dc.train(TASK, preset="exact", out=tmp_path / "run", **TINY)
    written = json.loads((run.folder / "config.json").read_text())
    assert (written["members"], written["actor_q"]) == ("all", "min")
    with pytest.raises(ValueError, match=r"`preset` must be one of .* got 'quick'"):
        dc.train(TASK, preset="quick", out=tmp_path / "other", **TINY)


def test_a_setting_that_is_none_is_named(tmp_path):
    with pytest.raises(TypeError, match="`bonus_wait` is no setting here"):
        dc.train(TASK, out=tmp_path / "run", bonus_wait=1)


class Unrepeatable(Arm):
    """Starts elsewhere at every call, whatever the seed."""

    starts = itertools.count(1)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.speed = np.full(2, next(self.starts), np.float32)
        return self.seen(), {}


def test_a_task_that_cannot_repeat_its_episode_goes_on_with_the_next(tmp_path):
    settings = TINY | {"max_episode_steps": 15, "evaluation_interval": 20}
    run = dc.train(
        make_env=Unrepeatable,
        out=tmp_path / "run",
        on_evaluation=lambda step, values: step == 20,
        **settings,
    )
    before = read_config(run.folder)
    again = {"make_env": Unrepeatable, "total_steps": 60, "show_progress": False}
    with pytest.raises(RuntimeError, match="with `new_episode` a run goes on in the next one"):
        dc.continue_run(run.folder, **again)
    assert read_config(run.folder) == before
    run = dc.continue_run(run.folder, new_episode=True, **again)
    assert run.summary["total_steps"] == 60
    rows = load_checkpoint(run.folder)["learner"]["replay"]["rows"]
    assert len(rows) == 60
    ends = rows[:, -1].nonzero().flatten().tolist()
    assert ends == [14, 19, 34, 49]  # the second one was cut off where the run stopped


def test_a_run_that_begins_has_no_episode_to_leave(tmp_path):
    config = Config.of(env_id=TASK, out=tmp_path / "run", total_steps=2_000)
    with pytest.raises(ValueError, match="`new_episode` must be left out where no run is contin"):
        train(config, new_episode=True)
