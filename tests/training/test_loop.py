import csv
import json
import multiprocessing
import os
import signal
import subprocess
import sys
from typing import ClassVar

import gymnasium
import imageio.v2 as imageio
import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.summary.writer import event_file_writer

from deep_curiosity.experiments.runs import read_evaluations
from deep_curiosity.training import continue_run, environments, loop, train
from deep_curiosity.training import run as run_module
from deep_curiosity.training.checkpoint import NEWEST, load_checkpoint, save_checkpoint
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.divergence import DivergedError
from deep_curiosity.training.failure import EnvironmentFailedError
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.lease import LeaseError
from deep_curiosity.training.log import open_folder, read_config
from deep_curiosity.training.run import Run
from deep_curiosity.training.spaces import SPACES

SUMMARY_KEYS = {
    "env_id",
    "seed",
    "total_steps",
    "evaluation_return",
    "training_return",
    "success_rate",
    "first_success_step",
    "coverage",
    "steps_per_second",
    "wall_seconds",
}
TIMED = ("time/steps_per_second",)


def flat(state, prefix=""):
    """Every leaf of a nested checkpoint by its path."""
    if isinstance(state, dict):
        items = state.items()
    elif isinstance(state, list | tuple):
        items = enumerate(state)
    else:
        return {prefix: state}
    return {
        key: leaf for name, value in items for key, leaf in flat(value, f"{prefix}/{name}").items()
    }


def learned_weight(config):
    """First layer of the policy that a short run ends with."""
    train(config, show_progress=False)
    agent = load_checkpoint(config.run.out)["learner"]["agent"]
    return agent["policy.network.layers.0.weight"][-1:]  # of the curious policy


def assert_same_state(first, second):
    first, second = flat(first), flat(second)
    assert first.keys() == second.keys()
    for key, leaf in first.items():
        if "seconds" in key:
            continue
        if isinstance(leaf, torch.Tensor):
            assert torch.equal(leaf, second[key]) or (
                leaf.isnan().any() and torch.equal(leaf.nan_to_num(), second[key].nan_to_num())
            ), key
        else:
            np.testing.assert_equal(leaf, second[key], err_msg=key)


def assert_same_run(first, second):
    """Everything but times is equal."""
    one, other = load_checkpoint(first), load_checkpoint(second)
    for state in (one, other):
        del state["progress"]
    assert_same_state(one, other)
    assert rows(first) == rows(second)


def rows(folder):
    with (folder / "progress.csv").open() as file:
        return [
            {name: value for name, value in row.items() if name not in TIMED}
            for row in csv.DictReader(file)
        ]


@pytest.mark.parametrize("bonus", ["curiosity", "none"])
def test_a_resumed_run_equals_an_uninterrupted_one_bit_for_bit(tiny, tmp_path, bonus):
    whole = tiny.override(bonus=bonus, prior="learned", total_steps=90, out=tmp_path / "whole")
    halves = whole.override(total_steps=45, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    train(whole.override(out=halves.run.out), resume=True, show_progress=False)
    assert_same_state(
        load_checkpoint(whole.run.out)["learner"], load_checkpoint(halves.run.out)["learner"]
    )
    assert_same_state(
        load_checkpoint(whole.run.out)["collector"], load_checkpoint(halves.run.out)["collector"]
    )
    assert rows(whole.run.out)[-1] == rows(halves.run.out)[-1] != rows(whole.run.out)[-2]


@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_resumed_run_with_a_frame_stack_equals_an_uninterrupted_one(tiny, tmp_path, num_envs):
    hidden = tiny.override(env_id="PendulumHiddenVelocity", frame_stack=3, num_envs=num_envs)
    whole = hidden.override(total_steps=90, out=tmp_path / "whole")
    halves = whole.override(total_steps=45, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    train(whole.override(out=halves.run.out), resume=True, show_progress=False)
    for part in ("learner", "collector"):
        assert_same_state(
            load_checkpoint(whole.run.out)[part], load_checkpoint(halves.run.out)[part]
        )
    assert load_checkpoint(whole.run.out)["collector"]["observation"].shape[-1] == 3 * 2 + 2 * 1
    assert rows(whole.run.out)[-1] == rows(halves.run.out)[-1] != rows(whole.run.out)[-2]


@pytest.mark.parametrize("vectorization", ["native", "sync"])
def test_a_resumed_run_of_several_environments_equals_an_uninterrupted_one(
    tiny, tmp_path, vectorization
):
    reacher = tiny.override(env_id="ReacherSparse", vectorization=vectorization, num_envs=3)
    several = reacher.override(update_to_data=0.2, evaluation_interval=500)
    whole = several.override(total_steps=330, out=tmp_path / "whole")
    halves = several.override(total_steps=321, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    train(whole.override(out=halves.run.out), resume=True, show_progress=False)
    for part in ("learner", "collector"):
        assert_same_state(
            load_checkpoint(whole.run.out)[part], load_checkpoint(halves.run.out)[part]
        )
    assert rows(whole.run.out)[-1] == rows(halves.run.out)[-1] != rows(whole.run.out)[-2]


@pytest.mark.parametrize("vectorization", ["native", "sync", "async"])
def test_replay_holds_whole_episodes_of_every_environment(tiny, vectorization):
    several = tiny.override(
        env_id="ReacherSparse",
        env_kwargs={},
        max_episode_steps=None,
        num_envs=2,
        vectorization=vectorization,
        total_steps=210,
        learning_starts=205,
    )
    assert train(several, show_progress=False)["total_steps"] == 210
    state = load_checkpoint(several.run.out)["learner"]["replay"]["rows"].reshape(105, 2, -1)
    observation, next_observation = state[..., :10], state[..., 13:23]
    terminated, truncated = state[..., -2], state[..., -1]
    assert not terminated.any()
    assert truncated.nonzero().tolist() == [[99, environment] for environment in range(2)]
    continues = (observation[1:] == next_observation[:-1]).all(-1)
    assert torch.equal(~continues, truncated[:-1].bool())
    target = slice(6, 8)  # sampled anew in each episode
    assert torch.equal(
        next_observation[:100, :, target], observation[:1, :, target].expand(100, 2, 2)
    )
    assert (observation[100, :, target] != observation[99, :, target]).all()


def counted_updates(config, monkeypatch, **options):
    """Environment steps that were in replay at each update of a run."""
    steps, update = [], Learner.update

    def counting(self):
        steps.append(len(self.replay))
        return update(self)

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", counting)
        train(config, show_progress=False, **options)
    return steps


@pytest.mark.parametrize(
    ("num_envs", "update_to_data", "expected"),
    [
        (1, 1.0, list(range(21, 31))),
        (1, 0.3, [24, 27, 30]),
        (1, 2.0, [step for step in range(21, 31) for _ in range(2)]),
        (4, 1.0, [24] * 4 + [28] * 4 + [32] * 4),
        (4, 0.25, [24, 28, 32]),
        (4, 0.4, [24, 28, 28, 32]),
    ],
)
def test_updates_keep_the_ratio_to_environment_steps(
    tiny, monkeypatch, num_envs, update_to_data, expected
):
    config = tiny.override(num_envs=num_envs, update_to_data=update_to_data, total_steps=30)
    assert counted_updates(config, monkeypatch) == expected


def test_the_ratio_does_not_drift_over_resumed_parts(tiny, monkeypatch):
    part = tiny.override(update_to_data=0.29, learning_starts=0, evaluation_interval=1000)
    steps = counted_updates(part.override(total_steps=33), monkeypatch)
    for total_steps in (58, 77, 100):
        steps += counted_updates(part.override(total_steps=total_steps), monkeypatch, resume=True)
    assert len(steps) == 29
    assert all(29 * step >= 100 * due > 29 * (step - 1) for due, step in enumerate(steps, 1))


def test_every_evaluation_has_a_row_and_no_row_has_another_ones(tiny):
    train(tiny.override(evaluation_interval=25, log_interval=20), show_progress=False)
    evaluated = {int(row["step"]): row["eval/return"] != "nan" for row in rows(tiny.run.out)}
    assert evaluated == {25: True, 40: False, 50: True, 60: True}
    assert [step for step, _ in read_evaluations(tiny.run.out)] == [25, 50, 60]


def test_intervals_count_the_steps_of_all_environments(tiny):
    summary = train(tiny.override(num_envs=8, update_to_data=0.1), show_progress=False)
    assert summary["total_steps"] == 64  # the first multiple of 8 that is not below 60
    assert [int(row["step"]) for row in rows(tiny.run.out)] == [40, 64]
    assert [row["eval/return"] != "nan" for row in rows(tiny.run.out)] == [True, True]


def test_coverage_is_that_of_all_environments(tiny):
    maze = tiny.override(env_id="PointMaze", num_envs=16, total_steps=960, learning_starts=940)
    train(maze.override(evaluation_interval=1000), show_progress=False)
    cells = load_checkpoint(maze.run.out)["run_log"]["cells"]
    assert len(cells) > 3
    assert max(cells.values()) > 16


def test_another_seed_gives_another_run(tiny, tmp_path):
    train(tiny, show_progress=False)
    train(tiny.override(seed=1, out=tmp_path / "other"), show_progress=False)
    assert rows(tiny.run.out)[-1] != rows(tmp_path / "other")[-1]


@pytest.mark.plotted
def test_a_run_leaves_its_records(tiny):
    summary = train(tiny, show_progress=False)
    assert summary.keys() >= SUMMARY_KEYS
    assert json.loads((tiny.run.out / "summary.json").read_text()) == summary
    assert json.loads((tiny.run.out / "config.json").read_text())["batch_size"] == 32
    assert [int(row["step"]) for row in rows(tiny.run.out)] == [40, 60]
    picture = imageio.imread(tiny.run.out / "run.png")[..., :3]
    for panel in np.array_split(picture, 3, axis=1):
        assert (panel != 255).any(-1).mean() > 0.01
    events = EventAccumulator(str(tiny.run.out)).Reload()
    tags = set(events.Tags()["scalars"])
    assert tags >= {"eval/return", "curiosity/nats", "agent/critic_loss", "agent/information_rate"}


def test_coverage_is_reported_where_the_task_has_cells(tiny, tmp_path):
    maze = tiny.override(env_id="PointMaze", out=tmp_path / "maze")
    assert 0 < train(maze, show_progress=False)["coverage"] < 1
    assert train(tiny, show_progress=False)["coverage"] is None


@pytest.mark.parametrize("num_envs", [1, 2])
def test_cells_that_are_crossed_while_an_action_is_held_are_covered(tiny, num_envs):
    class Walks(gymnasium.Env):
        """Enters another cell at every step."""

        observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
        num_cells = 70

        def reset(self, *, seed=None, options=None):
            self.cell = 0
            return np.zeros(1, np.float32), {"cell": 0}

        def step(self, action):
            self.cell += 1
            return np.zeros(1, np.float32), 0.0, False, False, {"cell": self.cell}

    config = tiny.override(env_id="make_env", env_kwargs={}, action_repeat=7, num_envs=num_envs)
    assert train(config, make_env=Walks, show_progress=False)["coverage"] == 1


def test_a_task_that_tells_no_success_cannot_end_at_it(tiny):
    config = tiny.override(
        env_id="Pendulum-v1", env_kwargs={}, max_episode_steps=20, terminate_on_success=True
    )
    with pytest.warns(UserWarning, match="`terminate_on_success` .* Pendulum-v1 has said") as told:
        train(config, show_progress=False)
    assert len(told) == 1


def test_a_folder_that_holds_a_run_is_left_alone(tiny):
    train(tiny, show_progress=False)
    before = (tiny.run.out / "config.json").read_text()
    with pytest.raises(FileExistsError, match=r"`out` must not hold a run already.*--resume"):
        train(tiny.override(seed=5), show_progress=False)
    assert (tiny.run.out / "config.json").read_text() == before


def test_a_run_that_fails_at_once_can_be_continued(tiny, monkeypatch):
    monkeypatch.setattr(Collector, "step", lambda self, action: 1 / 0)
    with pytest.raises(EnvironmentFailedError, match=r"ZeroDivisionError: .*--resume"):
        train(tiny, show_progress=False)
    monkeypatch.undo()
    assert train(tiny, resume=True, show_progress=False)["total_steps"] == 60


def test_a_resumed_run_keeps_its_number_of_steps_unless_another_is_given(tiny):
    choosy = tiny.override(features=(0, -1), bonus_parts={"cross_entropy": 1.0})
    train(choosy, show_progress=False)
    assert continue_run(tiny.run.out, show_progress=False)["total_steps"] == 60


def test_a_run_is_continued_where_it_lies_and_nowhere_else(tiny, tmp_path):
    train(tiny, show_progress=False)
    other = tiny.override(out=tmp_path / "other")
    train(other, show_progress=False)
    with pytest.raises(ValueError, match=r"`out` must be left out where a run is .*, got .*other"):
        continue_run(tiny.run.out, out=other.run.out, total_steps=80, show_progress=False)
    assert rows(other.run.out)[-1]["step"] == "60"
    assert continue_run(tiny.run.out, out=tiny.run.out, show_progress=False)["total_steps"] == 60


def test_a_run_that_goes_on_with_the_next_episode_does_not_claim_to_be_the_same(tiny, capsys):
    train(tiny, show_progress=False)
    continue_run(tiny.run.out, total_steps=80, new_episode=True, show_progress=False)
    printed = capsys.readouterr().out
    assert "as if it had been so from the start, but for the episode that is cut off\n" in printed


def test_a_resumed_run_changes_what_leaves_what_is_learned_as_it_is(tiny, capsys):
    train(tiny, show_progress=False)
    capsys.readouterr()
    changes = {"log_interval": 10, "evaluation_episodes": 2, "checkpoint_interval": 7}
    changes |= {"numpy_policy": False}
    summary = continue_run(tiny.run.out, total_steps=80, **changes, show_progress=False)
    assert summary["total_steps"] == 80
    assert read_config(tiny.run.out) == tiny.override(total_steps=80, **changes)
    printed = capsys.readouterr().out
    assert "`total_steps` is 80, it was 60: the run goes on exactly as if" in printed
    assert "`log_interval` is 10, it was 20: what is learned stays exactly what" in printed
    assert "`numpy_policy` is False, it was True: from here on results are rounded oth" in printed
    evaluations = {row["step"]: row["eval/return"] for row in rows(tiny.run.out)}
    assert evaluations["60"] != evaluations["80"]  # of one episode, and of two
    assert evaluations["70"] == "nan"  # where there was none


def test_a_schedule_that_is_stretched_is_said_so(tiny, capsys):
    train(tiny.override(hunger="linear:1:2"), show_progress=False)
    continue_run(tiny.run.out, total_steps=80, show_progress=False)
    assert "`total_steps` is 80, it was 60: schedules are stretched" in capsys.readouterr().out


def test_a_run_is_not_continued_to_where_it_has_been(tiny, capsys):
    train(tiny, show_progress=False)
    with pytest.raises(ValueError, match=r"`total_steps` must be at least 60, .* got 50"):
        continue_run(tiny.run.out, total_steps=50, show_progress=False)
    assert read_config(tiny.run.out) == tiny
    continue_run(tiny.run.out, show_progress=False)
    assert f"All 60 steps of the run in {tiny.run.out} are taken" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"seed": 4}, ValueError, r"`seed` must stay as the run in .* has it, 0, got 4"),
        ({"bonus": "rnd"}, ValueError, r"`bonus` must stay .* 'curiosity', got 'rnd'"),
        ({"frame_stack": 2}, ValueError, r"`frame_stack` must stay .* 1, got 2"),
        ({"log_intervall": 2}, TypeError, r"the nearest is log_interval"),
    ],
    ids=str,
)
def test_a_run_is_continued_with_no_other_setting(tiny, changes, error, message):
    open_folder(tiny)
    with pytest.raises(error, match=message):
        continue_run(tiny.run.out, **changes, show_progress=False)


def test_a_resumed_run_keeps_its_own_settings(tiny):
    train(tiny, show_progress=False)
    with pytest.raises(ValueError, match=r"`batch_size` must stay.*32, got 64"):
        train(tiny.override(batch_size=64), resume=True, show_progress=False)


def test_a_truncated_checkpoint_is_reported_and_the_one_before_it_used(tiny):
    train(tiny, show_progress=False)
    newest = tiny.run.out / NEWEST
    newest.write_bytes(newest.read_bytes()[:1000])
    with pytest.warns(UserWarning, match=r"checkpoint.pt is damaged.*previous"):
        summary = continue_run(tiny.run.out, total_steps=70, show_progress=False)
    assert summary["total_steps"] == 70


def test_an_environment_that_raises_leaves_all_before_the_step(tiny, monkeypatch, tmp_path):
    whole = tiny.override(out=tmp_path / "whole")
    train(whole, show_progress=False)
    step = Collector.step

    def failing(self, action):
        if self.seed == tiny.run.seed and len(self.actions) == 55:
            raise RuntimeError("the simulator broke")
        return step(self, action)

    monkeypatch.setattr(Collector, "step", failing)
    with pytest.raises(EnvironmentFailedError) as raised:
        train(tiny, show_progress=False)
    told = str(raised.value)
    assert "RuntimeError: the simulator broke, from PendulumSwingup, in training" in told
    assert (
        f"after step 55; all up to step 55 is saved; continue with --resume {tiny.run.out}" in told
    )
    assert str(raised.value.__cause__) == "the simulator broke"
    monkeypatch.undo()
    assert load_checkpoint(tiny.run.out)["run_log"]["step"] == 55
    assert [int(row["step"]) for row in rows(tiny.run.out)] == [40]
    train(tiny, resume=True, show_progress=False)
    assert_same_run(whole.run.out, tiny.run.out)


def test_a_task_that_exits_leaves_all_before_the_step(tiny, monkeypatch):
    step = Collector.step

    def leaving(self, action):
        if self.seed == tiny.run.seed and len(self.actions) == 33:
            sys.exit(3)
        return step(self, action)

    monkeypatch.setattr(Collector, "step", leaving)
    with pytest.raises(EnvironmentFailedError, match=r"SystemExit: 3.*up to step 33 is saved"):
        train(tiny, show_progress=False)
    assert load_checkpoint(tiny.run.out)["run_log"]["step"] == 33


def test_the_line_of_progress_ends_before_an_error_is_told(tiny, capsys):
    def failing(step, values):
        raise KeyError("of the callback")

    with pytest.raises(KeyError):
        train(tiny, on_evaluation=failing)
    assert capsys.readouterr().err.endswith("\n")


def test_a_callback_that_exits_leaves_all_before_it(tiny):
    with pytest.raises(SystemExit):
        train(tiny, on_evaluation=lambda step, values: sys.exit(3), show_progress=False)
    assert load_checkpoint(tiny.run.out)["run_log"]["step"] == 40


class Stuck(gymnasium.Env):
    """Cannot be closed."""

    action_space = observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        return np.zeros(1), {}

    def step(self, action):
        return np.zeros(1), 0.0, False, False, {}

    def close(self):
        raise OSError("the socket is closed already")


@pytest.mark.parametrize("num_envs", [1, 2])
def test_a_task_that_cannot_be_closed_does_not_undo_the_run(tiny, num_envs):
    config = tiny.override(env_id=EnvironmentConfig().env_id, env_kwargs={}, num_envs=num_envs)
    with pytest.warns(
        UserWarning, match="`close` of the environment should raise no error"
    ) as told:
        assert train(config, make_env=Stuck, show_progress=False)["total_steps"] == 60
    assert len(told) == num_envs + 1  # every one is closed, and that of the evaluations

    def failing(step, values):
        raise KeyError("of the callback")

    with pytest.raises(KeyError, match="of the callback"):  # and not the warnings, errors here
        train(
            config.override(out=tiny.run.out / "other"),
            make_env=Stuck,
            on_evaluation=failing,
            show_progress=False,
        )


@pytest.mark.parametrize("change", [{"low": -5.0}, {"entries": 4}])
def test_another_task_is_refused_and_the_run_kept(tiny, change):
    class Task(gymnasium.Env):
        def __init__(self, low=-1.0, entries=3):
            self.action_space = gymnasium.spaces.Box(low, 1.0, (1,))
            self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (entries,))

        def reset(self, *, seed=None, options=None):
            return self.observation_space.low, {}

        def step(self, action):
            return self.observation_space.low, 0.0, False, False, {}

    config = tiny.override(env_id=EnvironmentConfig().env_id, env_kwargs={})
    train(config, make_env=Task, show_progress=False)
    before = (tiny.run.out / SPACES).read_bytes()
    with pytest.raises(ValueError, match=r"`env_id` must name the task of the run in .* whose"):
        continue_run(
            tiny.run.out, total_steps=80, make_env=lambda: Task(**change), show_progress=False
        )
    assert (tiny.run.out / SPACES).read_bytes() == before


def test_a_run_resumed_from_its_first_checkpoint_is_in_tensorboard_once(tiny, monkeypatch):
    # files of one second are read in the order of their numbers as text, in which 10 is before 9
    monkeypatch.setattr(event_file_writer, "_global_uid", event_file_writer.AtomicCounter(10))
    config = tiny.override(checkpoint_interval=1_000)
    with monkeypatch.context() as patch:  # killed: nothing is saved any more
        patch.setattr(loop, "_plot", lambda folder: sys.exit(9))
        patch.setattr("deep_curiosity.training.run.Run.save", _first_alone())
        with pytest.raises(SystemExit):
            train(config, show_progress=False)
    assert load_checkpoint(tiny.run.out)["run_log"]["step"] == 0
    (tiny.run.out / "summary.json").unlink()
    train(config, resume=True, show_progress=False)
    events = EventAccumulator(str(tiny.run.out))
    events.Reload()
    steps = [event.step for event in events.Scalars("agent/critic_loss")]
    assert len(steps) == len(set(steps)) > 0


def _first_alone():
    """`Run.save` that saves once."""
    save, saved = Run.save, []

    def first(self):
        if not saved:
            save(self)
        saved.append(self)

    return first


def test_processes_that_a_signal_ended_do_not_undo_the_run(tiny, monkeypatch):
    """As by a signal to the whole group: they are gone before they are closed."""
    config = tiny.override(num_envs=2, vectorization="async", total_steps=200)
    environments = []
    make = run_module.make_collector

    def made(*arguments):
        collector = make(*arguments)
        environments.append(collector.environment)
        return collector

    def killing(step, values):
        for process in environments[0].processes:
            process.terminate()
            process.join()
        return True

    monkeypatch.setattr(run_module, "make_collector", made)
    summary = train(config, on_evaluation=killing, show_progress=False)
    assert summary["total_steps"] < 200


def test_a_nan_from_the_environment_stops_the_run_by_name(tiny, monkeypatch):
    step = Collector.step

    def broken(self, action):
        taken, finished = step(self, action)
        return taken._replace(reward=np.array([np.nan])), finished

    monkeypatch.setattr(Collector, "step", broken)
    with pytest.raises(EnvironmentFailedError, match="`reward` must be finite, got \\[nan\\]"):
        train(tiny, show_progress=False)


@pytest.mark.filterwarnings("ignore:`observation` and `reward` must be finite")
@pytest.mark.parametrize("num_envs", [1, 2])
def test_nothing_is_learned_before_a_step_is_held(tiny, num_envs):
    class BreaksAtFirst(gymnasium.wrappers.TransformReward):
        broken = 0

        def __init__(self):
            super().__init__(gymnasium.make("Pendulum-v1"), self.first_broken)

        def first_broken(self, reward):
            type(self).broken += 1
            return np.nan if self.broken <= 2 * num_envs else reward

    config = tiny.override(env_id=EnvironmentConfig().env_id, env_kwargs={}, num_envs=num_envs)
    config = config.override(learning_starts=0, total_steps=20)
    summary = train(config, make_env=BreaksAtFirst, show_progress=False)
    assert summary["broken_episodes"] == 2 * num_envs
    state = load_checkpoint(config.run.out)
    assert state["run_log"]["learning_steps"] == 20
    assert len(rows(config.run.out)) == 1


def test_ctrl_c_ends_after_the_step_with_a_checkpoint(tiny, monkeypatch, capsys):
    handler = signal.getsignal(signal.SIGINT)
    update = Learner.update

    def interrupting(self):
        if len(self.replay) == 33:
            os.kill(os.getpid(), signal.SIGINT)
        return update(self)

    monkeypatch.setattr(Learner, "update", interrupting)
    summary = train(tiny)
    assert summary["total_steps"] == 33 and summary["stopped_by"] == "SIGINT"
    assert load_checkpoint(tiny.run.out)["run_log"]["step"] == 33
    assert f"--resume {tiny.run.out}" in capsys.readouterr().out
    monkeypatch.undo()
    assert signal.getsignal(signal.SIGINT) is handler


class Stopping(gymnasium.Wrapper):
    """Sends a signal to this process at a call of an environment, once."""

    calls: ClassVar[dict[str, int]] = {}
    after: ClassVar[tuple[str, int, int]] = ("step", 0, signal.SIGINT)

    def count(self, name):
        self.calls[name] = self.calls.get(name, 0) + 1
        if (name, self.calls[name]) == self.after[:2]:
            os.kill(os.getpid(), self.after[2])
            pytest.fail("the call should have been cut off")

    def step(self, action):
        self.count("step")
        return super().step(action)

    def reset(self, **options):
        self.count("reset")
        return super().reset(**options)


@pytest.fixture
def stop_at(monkeypatch):
    """Have the environments stop the run at a call, counted over all of them."""

    def stop(name, number, sent):
        monkeypatch.setattr(Stopping, "calls", {})
        monkeypatch.setattr(Stopping, "after", (name, number, sent))
        made = environments._make
        monkeypatch.setattr(environments, "_make", lambda *args: Stopping(made(*args)))

    return stop


@pytest.mark.parametrize(
    ("call", "num_envs", "step", "sent"),
    [
        (("step", 30), 1, 29, signal.SIGINT),
        (("step", 41 + 7), 1, 40, signal.SIGINT),  # in an evaluation
        (("reset", 2), 1, 40, signal.SIGTERM),  # of an evaluation
        (("step", 3 * 9 + 2), 3, 27, signal.SIGTERM),
        (("reset", 3 + 1 + 2), 3, 297, signal.SIGINT),  # of the second of three environments
    ],
)
def test_a_run_that_is_cut_off_goes_on_bit_for_bit(
    tiny, tmp_path, stop_at, monkeypatch, call, num_envs, step, sent
):
    sparse = {
        "env_id": "ReacherSparse",
        "env_kwargs": {},
        "max_episode_steps": None,
        "update_to_data": 0.1,
    }
    whole = tiny.override(**sparse, num_envs=num_envs, out=tmp_path / "whole")
    if num_envs > 1:
        lasting = {"evaluation_interval": 200, "total_steps": 306} if step == 297 else {}
        whole = whole.override(vectorization="sync", **lasting)
    config = whole.override(out=tiny.run.out)
    train(whole, show_progress=False)
    stop_at(*call, sent)
    summary = train(config, show_progress=False)
    assert load_checkpoint(config.run.out)["run_log"]["step"] == step == summary["total_steps"]
    monkeypatch.undo()
    train(config, resume=True, show_progress=False)
    assert_same_run(whole.run.out, config.run.out)


def test_a_run_in_processes_is_cut_off_as_well(tiny, stop_at):
    several = {
        "num_envs": 2,
        "vectorization": "async",
        "env_kwargs": {},
        "env_id": "ReacherSparse",
    }
    config = tiny.override(**several)
    step = Collector.step

    def interrupted(self, action):
        if len(self.actions) == 20:
            wait = AsyncVectorEnv.step_wait

            def stopping(environment, timeout=None):
                os.kill(os.getpid(), signal.SIGTERM)
                return wait(environment, timeout)

            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(AsyncVectorEnv, "step_wait", stopping)
                return step(self, action)
        return step(self, action)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Collector, "step", interrupted)
        assert train(config, show_progress=False)["total_steps"] == 40
    assert not multiprocessing.active_children()
    assert train(config, resume=True, show_progress=False)["total_steps"] == 60


def test_an_evaluation_that_raises_is_made_again(tiny, tmp_path, monkeypatch):
    whole = tiny.override(out=tmp_path / "whole")
    train(whole, show_progress=False)
    monkeypatch.setattr("deep_curiosity.training.run.evaluate", lambda *args, **options: 1 / 0)
    with pytest.raises(EnvironmentFailedError, match="in an evaluation after step 40; all up to"):
        train(tiny, show_progress=False)
    monkeypatch.undo()
    train(tiny, resume=True, show_progress=False)
    assert_same_run(whole.run.out, tiny.run.out)


def test_rows_between_updates_survive_a_resume(tiny, tmp_path):
    rare = {"update_to_data": 0.03, "log_interval": 5, "checkpoint_interval": 1}
    whole = tiny.override(**rare, evaluation_interval=7, total_steps=105, out=tmp_path / "whole")
    train(whole, show_progress=False)
    train(whole.override(out=tiny.run.out, total_steps=70), show_progress=False)
    train(whole.override(out=tiny.run.out), resume=True, show_progress=False)
    assert rows(whole.run.out) == rows(tiny.run.out)


def poisoned_update(monkeypatch, at, poison):
    """Let an update of the learner end in weights that are not finite."""
    update = Learner.update

    def broken(self):
        metrics = update(self)
        if len(self.replay) >= at:
            return poison(self, metrics)
        return metrics

    monkeypatch.setattr(Learner, "update", broken)


def poison_loss(learner, metrics):
    return metrics | {"agent/critic_loss": torch.tensor(float("nan"))}


@torch.no_grad()
def poison_policy(learner, metrics):
    next(learner.agent.policy.parameters()).fill_(float("nan"))
    return metrics


@pytest.mark.parametrize(
    ("poison", "at", "message"),
    [
        (
            poison_loss,
            35,
            r"`agent/critic_loss` must stay finite, got nan at step 40 of .*step 25",
        ),
        (
            poison_loss,
            45,
            r"`agent/critic_loss` must stay finite, got nan at step 50 of .*step 25",
        ),
        (poison_policy, 45, r"`agent\.policy\..*` must stay finite, got nan at step 45 .*step 25"),
        (poison_policy, 60, r"`agent\.policy\..*` must stay finite, got nan at step 60 .*step 50"),
    ],
)
def test_a_run_that_diverges_keeps_its_last_good_checkpoint(
    tiny, monkeypatch, poison, at, message
):
    poisoned_update(monkeypatch, at, poison)
    with pytest.raises(DivergedError, match=message):
        train(tiny.override(evaluation_interval=1000), show_progress=False)
    monkeypatch.undo()
    state = load_checkpoint(tiny.run.out)
    assert state["run_log"]["step"] == (50 if at == 60 else 25)
    assert all(weight.isfinite().all() for weight in state["learner"]["agent"].values())
    assert train(tiny.override(evaluation_interval=1000), resume=True, show_progress=False)


def test_broken_weights_are_not_continued(tiny):
    train(tiny, show_progress=False)
    state = load_checkpoint(tiny.run.out)
    state["learner"]["agent"]["policy.network.layers.0.weight"].fill_(float("inf"))
    save_checkpoint(tiny.run.out, state)
    with pytest.raises(DivergedError, match=r"agent\.policy.*got inf at step 60 .*no good check"):
        continue_run(tiny.run.out, total_steps=80, show_progress=False)


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_anew(tiny, monkeypatch):
    monkeypatch.setattr("deep_curiosity.training.run.save_checkpoint", lambda *a, **o: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train(tiny, show_progress=False)
    monkeypatch.undo()
    assert continue_run(tiny.run.out, show_progress=False)["total_steps"] == 60
    for name in ("checkpoint.pt", "checkpoint.previous.pt"):
        (tiny.run.out / name).unlink()
    with pytest.raises(FileNotFoundError, match="it holds none"):  # what it logged is kept
        continue_run(tiny.run.out, show_progress=False)


def test_damaged_progress_is_mended_when_a_run_is_continued(tiny):
    train(tiny, show_progress=False)
    path = tiny.run.out / "progress.csv"
    whole = path.read_bytes()
    path.write_bytes(whole[:-30] + bytes(30))
    with pytest.warns(UserWarning, match=r"run/progress\.csv was damaged; it is mended"):
        continue_run(tiny.run.out, show_progress=False)
    assert path.read_bytes() == whole


def test_a_checkpoint_of_an_earlier_version_is_continued(tiny):
    train(tiny, show_progress=False)
    state = load_checkpoint(tiny.run.out)
    for name in ("progress", "metrics", "action", "unrecorded"):
        del state[name]
    for name in ("evaluation_step", "evaluation_size"):
        del state["run_log"][name]
    torch.save(state, tiny.run.out / NEWEST)
    continue_run(tiny.run.out, total_steps=80, show_progress=False)
    assert [int(row["step"]) for row in rows(tiny.run.out)] == [40, 60, 80]


def test_of_two_resumes_at_once_one_wins(tiny):
    train(tiny.override(total_steps=30), show_progress=False)
    code = (
        "import sys; from deep_curiosity.training import continue_run; sys.stdin.readline(); "
        "continue_run(sys.argv[1], total_steps=150, show_progress=False)"
    )
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", code, tiny.run.out],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    for run in runs:
        run.stdin.write("\n")
        run.stdin.flush()
    told = [run.communicate()[1] for run in runs]
    codes = [run.returncode for run in runs]
    lost = codes.index(1)
    assert sorted(codes) == [0, 1], told
    holder = f"held by process {runs[1 - lost].pid} on "
    assert "LeaseError" in told[lost] and holder in told[lost]
    assert [int(row["step"]) for row in rows(tiny.run.out)] == [30, *range(40, 160, 20), 150]


def test_a_run_whose_folder_is_taken_over_writes_nothing_more(tiny, monkeypatch):
    update = Learner.update

    def taken_over(self):
        if len(self.replay) == 45:
            (lease,) = tiny.run.out.glob("lease.*.json")
            lease.rename(lease.with_name("lease.9.json"))
        return update(self)

    monkeypatch.setattr(Learner, "update", taken_over)
    with pytest.raises(LeaseError, match="taken over by process"):
        train(tiny, show_progress=False)
    assert load_checkpoint(tiny.run.out)["run_log"]["step"] == 25
    assert [int(row["step"]) for row in rows(tiny.run.out)] == [40]


SOON = {"total_steps": 34, "checkpoint_interval": 34, "evaluation_interval": 34}
"""Enough updates of `tiny` for every setting to have its effect."""


@pytest.fixture(scope="module")
def unchanged(tiny_config, tmp_path_factory):
    """The weight that the settings of `tiny` lead to."""
    out = tmp_path_factory.mktemp("unchanged") / "run"
    return learned_weight(tiny_config.override(out=out, **SOON))


@pytest.mark.parametrize(
    "change",
    [
        {"bonus": "none"},
        {"bonus": "constant"},
        {"prior": "uniform"},
        {"curiosity_discount": 0.0},
        {"bandwidth": "perplexity"},
        {"bandwidth": 0.3},
        {"whitening": "robust"},
        {"marginal_half_life": 0.5},
        {"marginal_half_life": None},
        {"critic_layer_norm": True},
        {"features": (0, -1)},
        {"bonus_parts": {"predictive_power": 1.0}},
        {"bonus_parts": {"information_gain": 1.0}},
        {"bonus_parts": {"cross_entropy": 1.0}},
        {"bonus_parts": {"negative_entropy": 1.0}},
        {"noise_floor": 0.3},
        {"hunger": 0.0},
        {"bonus_weight": 1.0},
        {"temperature": 1.0},
        {"temperature": "constant:0.02"},
        {"temperature": "linear:0.02:0.002"},
        {"temperature": "plateaus:1.0:0.1"},
        {"temperature": "linear:0.02:1.0"},
        {"hunger": "linear:1:10"},
        {"hunger": "linear:1:0.1"},
        {"curiosity_ends": 25},
        {"curiosity_steps": 1},
        {"reward_steps": 1},
        {"tune_bonus_weight": "past"},
        {"tune_bonus_weight": 50.0},
        {"target_information_rate": 3.0},
        {"discount": 0.5},
        {"polyak": 0.5},
        {"learning_rate": 1e-2},
        {"model_learning_rate": 1e-2},
        {"num_members": 3},
        {"components": 8},
        {"refresh_interval": 1},
        {"batch_size": 16},
        {"actor_batch_fraction": 1.0},
        {"actor_q": "min"},
        {"members": "all"},
        {"model_mixture_components": 2},
        {"soft_backup": False},
        {"curiosity_coefficient": 0.1},
    ],
    ids=str,
)
def test_every_setting_of_learning_changes_what_is_learned(tiny, unchanged, change):
    weight = learned_weight(tiny.override(**SOON, **change))
    assert weight.shape == unchanged.shape
    assert not torch.equal(weight, unchanged)


@pytest.mark.parametrize(
    ("change", "shape"),
    [
        ({"hidden_dim": 8}, (3, 8)),
        ({"frame_stack": 3}, (3 * 3 + 2 * 1, 16)),
        ({"hunger": "conditioned:1.0"}, (3 + 1, 16)),
    ],
    ids=str,
)
def test_a_setting_that_changes_the_shape_of_the_policy_is_learned_with(
    tiny, tmp_path, monkeypatch, change, shape
):
    learned = learned_weight(tiny.override(**change))
    monkeypatch.setattr(Learner, "update", lambda self: {})
    initial = learned_weight(tiny.override(out=tmp_path / "initial", **change))
    assert learned.shape == initial.shape == (1, *shape)
    assert (learned != initial).any(-1).all()  # from every entry of what the policy is given


def test_a_curiosity_of_fixed_coefficient_learns_otherwise(tiny, tmp_path):
    faint = tiny.override(bonus_weight=1e-3, hunger=100.0)
    train(faint, show_progress=False)
    train(faint.override(curiosity_coefficient=1.0, out=tmp_path / "changed"), show_progress=False)
    assert float(rows(tiny.run.out)[-1]["agent/curiosity_coefficient"]) < 1
    assert float(rows(tmp_path / "changed")[-1]["agent/curiosity_coefficient"]) == 1
    assert (
        rows(tiny.run.out)[-1]["agent/policy_loss"]
        != rows(tmp_path / "changed")[-1]["agent/policy_loss"]
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"total_steps": 0}, "`total_steps` must be at least 1, got 0"),
        ({"frame_stack": 0}, "`frame_stack` must be at least 1, got 0"),
        ({"num_envs": 0}, "`num_envs` must be at least 1, got 0"),
        ({"update_to_data": 0.0}, "`update_to_data` must be positive, got 0.0"),
        ({"update_to_data": float("inf")}, "`update_to_data` must be finite, got inf"),
        (
            {"env_id": "Pendulum-v1", "env_kwargs": {}, "num_envs": 2, "vectorization": "native"},
            "`vectorization` must be 'auto', 'sync' or 'async' for Pendulum-v1, got 'native'",
        ),
        ({"num_envs": 2, "env_kwargs": {"wind": 1.0}}, "`env_kwargs` must be arguments of .*wind"),
        ({"seed": -1}, "`seed` must not be negative, got -1"),
        ({"hunger": float("nan")}, "`hunger` must be finite, got nan"),
        ({"num_members": 1}, "`num_members` must be at least 2"),
        ({"noise_floor": 0.0}, "`noise_floor` must be positive"),
        ({"marginal_half_life": -1.0}, "`marginal_half_life` must be positive, got -1.0"),
        ({"features": (0, 9)}, r"`features` must name different entries of 3, got \[0, 9\]"),
        ({"bonus_parts": {"novelty": 1.0}}, "`parts` must be named .*got 'novelty'"),
        ({"temperature": -1.0}, "`temperature` must be positive, got -1.0"),
        ({"env_id": "PendulumSwingdown"}, "`env_id` must be a registered id such as .*Swingup"),
        ({"env_id": "CartPole-v1", "env_kwargs": {}}, "`action_space` must be a Box"),
        ({"env_kwargs": {"acton_cost": 1.0}}, "`env_kwargs` must be arguments of .*acton_cost"),
    ],
    ids=str,
)
def test_a_bad_setting_is_named_before_a_folder_is_made(tiny, change, message):
    with pytest.raises(ValueError, match=message):
        train(tiny.override(**change), show_progress=False)
    assert not tiny.run.out.exists()


def test_a_word_that_is_no_choice_is_named_with_the_choices(tiny):
    with pytest.raises(ValueError, match=r"`vectorization` must be one of .*sync.*got 'threads'"):
        tiny.override(num_envs=2, vectorization="threads")


def test_the_progress_bar_shows_return_nats_and_speed(tiny, capsys):
    train(tiny)
    shown = capsys.readouterr().err
    for name in ("return=", "nats=", "steps/s="):
        assert name in shown


def test_importing_the_library_leaves_torch_and_logging_alone():
    code = (
        "import logging, torch; before = torch.get_float32_matmul_precision(), "
        "torch.get_default_dtype(), logging.root.level, logging.root.handlers[:]; "
        "import deep_curiosity, deep_curiosity.agent.sac, deep_curiosity.bonuses.curiosity, sys; "
        "assert before == (torch.get_float32_matmul_precision(), torch.get_default_dtype(), "
        "logging.root.level, logging.root.handlers[:]); "
        "heavy = {'gymnasium', 'mujoco', 'torchrl', 'stable_baselines3', 'torch._dynamo'}; "
        "assert not heavy & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_loop_is_what_the_package_exports():
    assert train is loop.train
