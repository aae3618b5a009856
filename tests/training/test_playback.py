import gymnasium
import imageio.v2 as imageio
import numpy as np
import pytest
import torch
from imageio.v3 import immeta

from deep_curiosity.training import train
from deep_curiosity.training.checkpoint import load_checkpoint, save_checkpoint
from deep_curiosity.training.collector import evaluate
from deep_curiosity.training.divergence import DivergedError
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.playback import load_agent, load_policy, record_episode, write_video
from deep_curiosity.training.run import EVALUATION_SEED


@pytest.fixture
def environment(tiny):
    environment = make_environment(tiny.environment)
    yield environment
    environment.close()


def test_the_policy_is_that_of_the_runs_own_evaluation(tiny, environment):
    summary = train(tiny, show_progress=False)
    policy = load_policy(tiny.run.out, tiny, environment)
    (episode,) = evaluate(policy, environment, episodes=1, seed=EVALUATION_SEED)
    evaluations = load_checkpoint(tiny.run.out)["run_log"]["evaluations"]
    assert episode[:2] == evaluations[-1][:2]
    assert summary["evaluation_return"] == episode.episode_return


def test_the_agent_is_as_the_newest_checkpoint_has_it(tiny, environment):
    train(tiny, show_progress=False)
    agent = load_agent(tiny.run.out, tiny, environment)
    saved = load_checkpoint(tiny.run.out)["learner"]["agent"]
    state = agent.state_dict()
    assert state.keys() == saved.keys()
    for name, value in state.items():
        torch.testing.assert_close(value, saved[name], rtol=0, atol=0, equal_nan=True)
    observation = torch.randn(4, 3)
    policy = load_policy(tiny.run.out, tiny, environment)
    expected = agent.act(observation, deterministic=True, greedy=True)
    assert torch.equal(policy(observation, {}), expected)


def test_a_conditioned_run_is_played_at_a_hunger(tiny, environment):
    config = tiny.override(hunger="random")
    train(config, show_progress=False)
    observation = torch.randn(4, 3)
    actions = [
        load_policy(config.run.out, config, environment, hunger=hunger)(observation, {})
        for hunger in (None, 1.0, 0.0)
    ]
    assert torch.equal(actions[0], actions[1])  # evaluations are all for reward
    assert not torch.equal(actions[1], actions[2])
    with pytest.raises(
        ValueError, match=r"`hunger` must lie in \[0, 1\] where conditioned, got 2"
    ):
        load_policy(config.run.out, config, environment, hunger=2.0)


def test_a_folder_without_a_checkpoint_is_named(tiny, environment, tmp_path):
    with pytest.raises(FileNotFoundError, match="it holds none"):
        load_policy(tmp_path, tiny, environment)


def test_a_policy_that_is_not_finite_is_refused(tiny, environment):
    train(tiny, show_progress=False)
    state = load_checkpoint(tiny.run.out)
    state["learner"]["agent"]["policy.network.layers.0.weight"][0, 0, 0] = float("nan")
    save_checkpoint(tiny.run.out, state)
    with pytest.raises(DivergedError, match=r"`policy\.network\..*got nan, in the checkpoint in"):
        load_policy(tiny.run.out, tiny, environment)


class Painted:
    """Paints the number of the step, in place of what MuJoCo would."""

    def __init__(self, environment):
        self.environment = environment
        self.count = 0

    def render(self):
        self.count += 1
        return np.full((16, 16, 3), self.count, np.uint8)


def test_an_episode_has_a_frame_for_every_state_but_the_last(environment, monkeypatch):
    paint = Painted(environment)
    monkeypatch.setattr(type(environment), "render", lambda self: paint.render())
    frames = record_episode(lambda observation, info: torch.zeros(1, 1), environment, seed=0)
    assert len(frames) == 70  # as the episode is limited
    assert [frame[0, 0, 0] for frame in frames] == list(range(1, 71))


def test_a_video_holds_its_frames(tmp_path):
    (tmp_path / "mine.gif").write_text("mine")
    with pytest.raises(FileExistsError, match=r"`video` must name a new file, got .*mine\.gif"):
        write_video(tmp_path / "mine.gif", [], fps=10)
    frames = [np.full((16, 16, 3), 60 * number, np.uint8) for number in range(4)]
    write_video(tmp_path / "new" / "video.gif", frames, fps=10)
    shown = imageio.mimread(tmp_path / "new" / "video.gif")
    assert immeta(tmp_path / "new" / "video.gif", index=1)["duration"] == 100  # milliseconds
    assert [int(frame[0, 0, 0]) for frame in shown] == [0, 60, 120, 180]


def test_a_video_that_fails_does_not_block_its_name(tmp_path, monkeypatch):
    def fails(path, frames, **pace):
        assert path.suffix == ".gif"
        path.write_text("half")
        raise KeyboardInterrupt

    frames = [np.zeros((16, 16, 3), np.uint8)] * 2
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(imageio, "mimwrite", fails)
        write_video(tmp_path / "video.gif", frames, fps=10)
    assert not [*tmp_path.iterdir()]
    write_video(tmp_path / "video.gif", frames, fps=10)


def test_frames_stay_as_they_were_when_the_renderer_reuses_its_memory():
    class Drawn(gymnasium.Env):
        observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
        canvas = np.zeros((2, 2, 3), np.uint8)

        def reset(self, *, seed=None, options=None):
            self.canvas[:] = 0
            return np.zeros(1, np.float32), {}

        def step(self, action):
            self.canvas += 1
            return np.zeros(1, np.float32), 0.0, False, bool(self.canvas[0, 0, 0] == 3), {}

        def render(self):
            return self.canvas

    frames = record_episode(lambda observation, info: torch.zeros(1, 1), Drawn(), seed=0)
    assert [int(frame.max()) for frame in frames] == [0, 1, 2]
