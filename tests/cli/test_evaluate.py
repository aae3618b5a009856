import math
import os
import subprocess
import sys
from typing import ClassVar

import gymnasium
import imageio.v2 as imageio
import numpy as np
import pytest

from deep_curiosity.cli import main
from deep_curiosity.cli.evaluate import describe_returns
from deep_curiosity.training import train
from deep_curiosity.training.collector import Episode


def test_a_conditioned_run_is_played_at_several_hungers(tiny, capsys, refusal):
    train(tiny.override(hunger="random"), show_progress=False)
    capsys.readouterr()
    folder = str(tiny.run.out)
    assert main(["evaluate", folder, "--episodes", "1", "--hunger", "0", "0.5", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(": return")[0].split()[-1] for line in lines] == ["0", "0.5", "1"]
    assert "`hunger` must be at most 1, got 2.0" in refusal("evaluate", folder, "--hunger", 2)


def test_episodes_that_broke_do_not_count():
    episodes = [Episode(value, 5, math.nan, math.isnan(value)) for value in (1.0, math.nan, 3.0)]
    assert describe_returns(episodes) == "return 2.00 +- 1.41 (1 of 3 episodes broke off)"
    assert describe_returns(episodes[:1]) == "return 1.00 +- 0.00"
    assert describe_returns(episodes[1:2]) == "return unknown (1 of 1 episodes broke off)"


def test_a_video_is_written_where_something_renders(tiny, tmp_path):
    video = tmp_path / "video.gif"
    task = {"env_id": "ReacherSparse", "env_kwargs": {}, "frame_stack": 2}
    train(tiny.override(**task, max_episode_steps=30), show_progress=False)
    arguments = ["evaluate", str(tiny.run.out), "--episodes", "1", "--video", str(video)]
    played = subprocess.run(
        [sys.executable, "-m", "deep_curiosity", *arguments],
        capture_output=True,
        text=True,
        env=os.environ | {"MUJOCO_GL": "egl"},
    )
    if played.returncode:
        assert "error: MuJoCo could not start OpenGL" in played.stderr
        pytest.skip("nothing renders here")
    frames = np.stack(imageio.mimread(video))[..., :3]
    assert len(frames) == 30
    assert (frames[0] != frames[0, 0, 0]).any(-1).mean() > 0.01  # something is there
    assert (frames[0] != frames[-1]).any()  # and moves


class Unseen(gymnasium.Env):
    """A task that nobody can see; it counts its steps."""

    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    num_steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        Unseen.num_steps += 1
        return np.zeros(1, np.float32), 0.0, False, False, {}


class Blank(Unseen):
    """One that takes the mode, and draws nothing."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def render(self):
        return None


class Undrawn(Unseen):
    """One that takes the mode, and has no drawing."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode


@pytest.mark.filterwarnings("ignore:.*render_mode")  # of gymnasium, of a task without modes
@pytest.mark.parametrize("task", [Unseen, Blank, Undrawn])
def test_a_task_that_cannot_be_filmed_is_refused_before_it_is_played(
    tiny, tmp_path, refusal, task
):
    name = f"evaluate/{task.__name__}-v0"
    gymnasium.register(name, task)
    train(tiny.override(env_id=name, env_kwargs={}), show_progress=False)
    Unseen.num_steps = 0
    answer = refusal("evaluate", tiny.run.out, "--video", tmp_path / "film.gif")
    expected = "error: `video` must be left out for a task that renders no rgb_array, got"
    assert expected in answer and task.__name__ in answer and "env_kwargs" not in answer
    assert Unseen.num_steps == 0
    assert not (tmp_path / "film.gif").exists()
    assert main(["evaluate", str(tiny.run.out), "--episodes", "1"]) == 0


class Flickers(Blank):
    """One that is drawn, twenty frames a second."""

    metadata: ClassVar = {"render_modes": ["rgb_array"], "render_fps": 20}

    def render(self):
        return np.full((16, 16, 3), 64 * (Unseen.num_steps // 4 % 4), np.uint8)


def test_a_video_of_held_actions_keeps_the_pace_of_the_task(tiny, tmp_path):
    gymnasium.register("evaluate/Flickers-v0", Flickers)
    config = tiny.override(env_id="evaluate/Flickers-v0", env_kwargs={}, action_repeat=4)
    train(config, show_progress=False)
    video = tmp_path / "film.gif"
    assert main(["evaluate", str(tiny.run.out), "--episodes", "1", "--video", str(video)]) == 0
    assert imageio.get_reader(video).get_meta_data()["duration"] == 200  # ms, of four steps


def test_a_task_that_tells_no_pace_has_thirty_frames_a_second(tiny, tmp_path, monkeypatch):
    monkeypatch.setitem(Flickers.metadata, "render_fps", None)
    gymnasium.register("evaluate/Paceless-v0", Flickers)
    config = tiny.override(env_id="evaluate/Paceless-v0", env_kwargs={}, action_repeat=3)
    train(config, show_progress=False)
    video = tmp_path / "film.gif"
    assert main(["evaluate", str(tiny.run.out), "--episodes", "1", "--video", str(video)]) == 0
    assert imageio.get_reader(video).get_meta_data()["duration"] == 100


def test_a_missing_video_package_is_asked_for_by_name(tmp_path, monkeypatch, refusal):
    monkeypatch.setitem(sys.modules, "imageio", None)
    for command in (["evaluate", tmp_path], ["demo"]):
        answer = refusal(*command, "--video", tmp_path / "film.gif")
        assert "pip install 'deep-curiosity[video]'" in answer


def test_another_task_than_that_of_the_run_is_not_played(tiny, tmp_path, monkeypatch, refusal):
    gymnasium.register("evaluate/Renewed-v0", Unseen)
    train(tiny.override(env_id="evaluate/Renewed-v0", env_kwargs={}), show_progress=False)
    monkeypatch.setattr(Unseen, "action_space", gymnasium.spaces.Box(-2.0, 2.0, (1,)))
    answer = refusal("evaluate", tiny.run.out, "--episodes", 1)
    assert "`env_id` must name the task of the run in" in answer
    assert "action_low is (-1.0,), got one whose action_low is (-2.0,)" in answer
