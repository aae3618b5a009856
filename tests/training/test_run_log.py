import json
import math

import numpy as np
import pytest
import torch

from deep_curiosity.training.collector import Episode
from deep_curiosity.training.infos import joined
from deep_curiosity.training.run_log import NUM_RECENT, RunLog, mean_return, success_rate

EPISODES = [Episode(float(number), 5, number % 2) for number in range(15)]


def test_the_mean_return_is_that_of_the_newest_episodes():
    assert mean_return([]) is None
    assert mean_return(EPISODES) == pytest.approx(9.5)  # of 5 to 14
    assert mean_return(EPISODES, num_recent=2) == pytest.approx(13.5)
    assert mean_return(EPISODES[:3]) == pytest.approx(1.0)


def test_the_success_rate_is_that_of_the_newest_episodes():
    assert success_rate([]) is None
    assert success_rate(EPISODES) == pytest.approx(0.5)
    assert success_rate([Episode(0.0, 5, 1.0)] + [Episode(0.0, 5, 0.0)] * NUM_RECENT) == 0
    assert success_rate([Episode(0.0, 5)]) is None  # the task defines none


def test_the_first_success_is_that_of_any_environment():
    log = RunLog()
    for step, succeeded in enumerate([[False, False], [False, True], [True, True]], 1):
        log.step = 2 * step
        log.on_step({"is_success": np.array(succeeded)})
    assert log.first_success_step == 4
    log = RunLog(step=1)
    log.on_step({})
    assert log.first_success_step is None


def test_a_cell_is_noted_when_it_is_first_visited():
    log = RunLog()
    for step, cells in enumerate([[1, 1], [2, 1], [1, 3]], 1):
        log.step = 2 * step
        log.on_step({"cell": np.array(cells)})
    assert log.cells == {1: 2, 2: 4, 3: 6}
    assert log.coverage(12) == pytest.approx(0.25)
    assert log.coverage(None) is None


def test_a_cell_is_that_of_an_environment_which_tells_one():
    log = RunLog(step=2)
    for cell in (5, np.int64(6), np.array([7]), np.array([8, 9])):
        log.on_step(joined([{}, {"cell": cell}]))
    log.on_step(joined([{}, {"is_success": False}, {"cell": 5.0}, {"cell": True}]))
    assert log.cells == dict.fromkeys(range(5, 10), 2)
    assert log.first_success_step is None
    log.on_step(joined([{}, {"is_success": True}]))
    assert log.first_success_step == 2


@pytest.mark.parametrize("cell", ["kitchen", None, 0.5, [None]])
def test_what_another_task_calls_a_cell_is_left_alone(cell):
    log = RunLog()
    log.on_step({"cell": np.array(cell)})
    log.on_step({"cell": cell})
    assert log.cells == {}


def test_speed_is_counted_while_learning():
    log = RunLog()
    assert math.isnan(log.steps_per_second)
    assert log.summary(None)["steps_per_second"] is None
    log = RunLog(learning_steps=8, learning_seconds=2.0)
    assert log.steps_per_second == log.summary(None)["steps_per_second"] == pytest.approx(4.0)


def test_it_comes_back_from_a_checkpoint(tmp_path):
    log = RunLog(step=9, episodes=EPISODES, evaluations=EPISODES[:2], cells={4: 1})
    log.learning_steps, log.learning_seconds = 3, 0.25
    torch.save(log.state_dict(), tmp_path / "log.pt")
    restored = RunLog.from_state(torch.load(tmp_path / "log.pt", weights_only=True))
    assert restored == log
    assert type(restored.episodes[0]) is Episode


def test_the_summary_is_plain_and_of_evaluations_and_training_apart():
    log = RunLog(step=9, episodes=EPISODES, evaluations=EPISODES[:2], wall_seconds=2.0)
    summary = log.summary(4)
    assert json.loads(json.dumps(summary)) == summary
    assert summary["evaluation_return"] == pytest.approx(0.5)
    assert summary["training_return"] == pytest.approx(9.5)
    assert summary["mean_training_return"] == pytest.approx(7.0)
    assert summary["success_rate"] == pytest.approx(0.5)
    assert summary["coverage"] == 0
    assert summary["wall_seconds"] == 2.0


def test_a_task_that_speaks_of_success_at_a_success_alone_is_understood():
    silent, success = Episode(0.0, 5), Episode(0.0, 5, 1.0)
    assert success_rate([silent, success, silent, silent]) == pytest.approx(0.25)
    assert success_rate([silent] * 3, is_defined=True) == 0
    assert success_rate([success] + [silent] * NUM_RECENT) == 0
    log = RunLog(episodes=[silent], evaluations=[silent])
    assert not log.defines_success and log.summary(None)["success_rate"] is None
    log = RunLog(episodes=[silent, success], evaluations=[silent])
    assert log.defines_success and log.summary(None)["success_rate"] == 0


def test_an_episode_that_broke_is_counted_and_its_return_is_not():
    broken = Episode(-100.0, 2, broken=True)
    log = RunLog(episodes=[*EPISODES, broken], evaluations=[broken, Episode(3.0, 5)])
    assert log.broken_episodes == log.summary(None)["broken_episodes"] == 2
    assert log.summary(None)["evaluation_return"] == 3.0
    assert mean_return([broken]) is None
    assert RunLog.from_state(log.state_dict()).broken_episodes == 2
