from functools import partial

import gymnasium
import imageio.v2 as imageio
import numpy as np
import pytest
from matplotlib.figure import Figure

from deep_curiosity.training import train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.figures import BONUS_CURVES, PICTURE, plot_run
from deep_curiosity.training.log import read_progress


@pytest.fixture
def plotted(monkeypatch):
    """Plots a run and gives the axes of its picture: returns, bonus, states and colour bar."""

    def plot(folder):
        figures = []
        monkeypatch.setattr(Figure, "savefig", lambda self, path, **options: figures.append(self))
        plot_run(folder)
        (figure,) = figures
        monkeypatch.undo()
        return figure.axes

    return plot


def curve(axes, label):
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return line.get_xdata(), line.get_ydata()


def column(folder, name):
    return [float(row[name]) for row in read_progress(folder)]


@pytest.fixture
def maze(tiny):
    """A run with two episodes that end in training, in a task that names its features."""
    whole = {"max_episode_steps": None, "total_steps": 210, "learning_starts": 180}
    config = tiny.override(env_id="ReacherSparse", **whole)
    train(config, show_progress=False)
    return config


def test_the_learning_curve_is_that_of_the_records(maze, plotted):
    returns, *_ = plotted(maze.run.out)
    steps, values = curve(returns, "evaluation")
    assert list(steps) == column(maze.run.out, "step")
    np.testing.assert_array_equal(values, column(maze.run.out, "eval/return"))
    steps, values = curve(returns, "training episode")
    episodes = load_checkpoint(maze.run.out)["run_log"]["episodes"]
    assert list(steps) == [100, 200]
    assert list(values) == [episode[0] for episode in episodes]


def test_the_bonus_is_plotted_with_its_parts(maze, plotted):
    _, bonus, *_ = plotted(maze.run.out)
    assert [line.get_label() for line in bonus.lines] == list(BONUS_CURVES.values())
    for name, label in BONUS_CURVES.items():
        steps, values = curve(bonus, label)
        assert list(steps) == column(maze.run.out, "step")
        assert list(values) == column(maze.run.out, name)
    assert bonus.get_ylim()[0] == 0


def test_the_states_are_those_visited_in_the_two_features_of_the_task(tiny, plotted):
    train(tiny, show_progress=False)
    _, _, states, _ = plotted(tiny.run.out)
    (points,) = states.collections
    rows = load_checkpoint(tiny.run.out)["learner"]["replay"]["rows"].numpy()
    np.testing.assert_array_equal(points.get_offsets(), rows[:60, [0, 2]])
    assert points.get_array().tolist() == sorted(points.get_array().tolist())
    assert (states.get_xlabel(), states.get_ylabel()) == ("observation[0]", "observation[2]")


def test_of_a_task_without_an_id_the_newest_frame_is_plotted(tiny, plotted):
    config = tiny.override(env_id="make_env", env_kwargs={}, frame_stack=2)
    train(config, make_env=partial(gymnasium.make, "Pendulum-v1"), show_progress=False)
    _, _, states, _ = plotted(config.run.out)
    assert (states.get_xlabel(), states.get_ylabel()) == ("observation[4]", "observation[6]")


def test_the_states_go_from_the_oldest_to_the_newest_where_replay_is_full(tiny, plotted):
    config = tiny.override(replay_capacity=40)
    train(config, show_progress=False)
    _, _, states, _ = plotted(config.run.out)
    (points,) = states.collections
    rows = load_checkpoint(config.run.out)["learner"]["replay"]["rows"].numpy()
    np.testing.assert_array_equal(points.get_offsets()[20:], rows[:20, [0, 2]])


def test_without_a_bonus_the_picture_says_so(tiny, plotted):
    train(tiny.override(bonus="none"), show_progress=False)
    _, bonus, *_ = plotted(tiny.run.out)
    assert not bonus.lines
    assert [text.get_text() for text in bonus.texts] == ["no bonus"]


def test_a_run_that_has_logged_nothing_yet_is_plotted(tiny, plotted):
    train(tiny.override(log_interval=1000), show_progress=False)
    (tiny.run.out / "progress.csv").unlink()
    returns, bonus, states, _ = plotted(tiny.run.out)
    assert not returns.lines and not bonus.lines
    assert states.collections


def test_the_picture_holds_three_panels_and_is_that_of_its_run(tiny, tmp_path):
    pictures = []
    for seed in (0, 1):
        config = tiny.override(seed=seed, out=tmp_path / str(seed))
        train(config, show_progress=False)
        assert plot_run(config.run.out) == config.run.out / PICTURE
        picture = imageio.imread(config.run.out / PICTURE)[..., :3]
        for panel in np.array_split(picture[60:], 3, axis=1):  # below the title
            assert (panel != 255).any(-1).mean() > 0.01
        pictures.append(picture[60:])
    assert pictures[0].shape == pictures[1].shape
    assert (pictures[0] != pictures[1]).any(-1).mean() > 0.001


def test_a_picture_that_cannot_be_drawn_loses_no_run(tiny, monkeypatch):
    def fails(folder):
        raise RuntimeError("a port that is in use")

    monkeypatch.setattr("deep_curiosity.training.figures.plot_run", fails)
    with pytest.warns(UserWarning, match="is whole, but its picture could not be drawn: .*port"):
        summary = train(tiny, show_progress=False)
    assert summary["total_steps"] == tiny.run.total_steps
