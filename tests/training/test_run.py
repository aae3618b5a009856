import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

from deep_curiosity import load_bonus
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training import Config, continue_run, train
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.exploration import OrnsteinUhlenbeckNoise
from deep_curiosity.training.greedy import GreedyStretches
from deep_curiosity.training.hunger import RandomHunger
from deep_curiosity.training.log import Log, read_config, read_progress
from deep_curiosity.training.run import (
    make_collector,
    merge_config,
    open_run,
    peak_memory_megabytes,
)


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def process_state():
    return (
        torch.get_num_threads(),
        torch.get_float32_matmul_precision(),
        torch.get_default_dtype(),
        torch.is_grad_enabled(),
        np.geterr(),
        dict(os.environ),
    )


@pytest.mark.parametrize("precision", ["auto", "highest", "high", "medium"])
def test_training_leaves_the_process_as_it_was(tiny, two_threads, monkeypatch, precision):
    torch.set_float32_matmul_precision("high")
    before, within = process_state(), []
    sample_rows = ReplayBuffer.sample_rows

    def sampling(self, *arguments):
        within.append((torch.get_num_threads(), torch.get_float32_matmul_precision()))
        return sample_rows(self, *arguments)

    monkeypatch.setattr(ReplayBuffer, "sample_rows", sampling)
    train(tiny.override(threads=1, matmul_precision=precision), show_progress=False)
    assert process_state() == before
    chosen = read_config(tiny.run.out).speed.matmul_precision
    assert chosen == precision or precision == "auto"
    assert set(within) == {(1, chosen)}


def test_a_run_that_fails_leaves_the_process_as_it_was(tiny, two_threads, monkeypatch):
    before = process_state()
    monkeypatch.setattr(
        "deep_curiosity.training.run.Run.updates_due", property(lambda self: 1 / 0)
    )
    with pytest.raises(ZeroDivisionError):
        train(tiny.override(threads=1, matmul_precision="medium"), show_progress=False)
    assert process_state() == before


def test_everything_that_was_opened_is_closed_however_a_run_ends(tiny, monkeypatch):
    closed = []

    class Recorded(gymnasium.Wrapper):
        def close(self):
            closed.append("environment")
            super().close()

    monkeypatch.setattr(
        "deep_curiosity.training.run.make_environment",
        lambda config: Recorded(make_environment(config)),
    )
    monkeypatch.setattr(Log, "close", lambda self: closed.append("log"))
    with pytest.raises(KeyError), open_run(tiny):
        raise KeyError
    assert sorted(closed) == ["environment", "environment", "log"]


def test_a_run_begins_with_a_checkpoint_and_its_settings(tiny):
    with open_run(tiny) as run:
        assert read_config(tiny.run.out) == tiny
        assert (tiny.run.out / "checkpoint.pt").exists()
        assert not run.finished
        assert run.collector.environment.num_envs == 1


@pytest.mark.parametrize("num_envs", [1, 3])
def test_intervals_are_reached_once_for_every_multiple(tiny, num_envs):
    with open_run(tiny.override(num_envs=num_envs)) as run:
        reached = []
        for step in range(num_envs, 61, num_envs):
            run.run_log.step = step
            if run.reached(20):
                reached.append(step)
    assert len(reached) == 3
    assert [step // 20 for step in reached] == [1, 2, 3]


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("settings", [{"hunger": "random", "exploration": "ou"}, {}])
def test_in_the_next_episode_all_is_chosen_afresh_as_after_an_end(
    tiny, monkeypatch, num_envs, settings
):
    config = tiny.override(num_envs=num_envs, total_steps=63, **settings)
    train(config, show_progress=False)
    begun = []
    for kind in (RandomHunger, OrnsteinUhlenbeckNoise):
        monkeypatch.setattr(kind, "begin", lambda self, index: begun.append((type(self), index)))
    record = GreedyStretches.record

    def recorded(self, ended, share):
        assert share == (0.0 if settings else 0.25)
        begun.append((type(self), ended.all()))
        return record(self, ended, share)

    monkeypatch.setattr(GreedyStretches, "record", recorded)
    with open_run(config, resume=True, quiet=True):
        assert not begun
    with open_run(config, resume=True, new_episode=True, quiet=True):
        pass
    kinds = (RandomHunger, OrnsteinUhlenbeckNoise) if settings else ()
    expected = {(kind, index) for kind in kinds for index in range(num_envs)}
    assert set(begun) == expected | {(GreedyStretches, True)}
    assert len(begun) == len(expected) + 1


def test_a_collector_has_as_many_environments_as_are_set(tiny):
    for num_envs in (1, 2):
        collector = make_collector(tiny.override(num_envs=num_envs))
        assert collector.observation.shape == (num_envs, 3)
        collector.environment.close()


def test_a_continued_run_may_change_what_does_not_change_what_is_learned():
    own = Config.of(bonus="rnd", seed=3, total_steps=700)
    safe = {"total_steps": 900, "log_interval": 7, "threads": 2, "matmul_precision": "high"}
    merged = merge_config(own.override(**safe, out="elsewhere"), own)
    assert merged == own.override(**safe)
    kept = own.override(matmul_precision="high")
    assert merge_config(own, kept) == kept  # by "auto", which the clock had chosen
    with pytest.raises(ValueError, match=r"`seed` must stay as the run in .* has it, 3, got 4"):
        merge_config(own.override(seed=4), own)
    with pytest.raises(ValueError, match=r"`bonus` must stay .* 'rnd', got 'icm'"):
        merge_config(own.override(bonus="icm"), own)


@pytest.mark.parametrize("total_steps", [60, 80])
def test_the_summary_holds_the_last_evaluation_be_it_scheduled_or_not(tiny, total_steps):
    config = tiny.override(total_steps=total_steps, evaluation_episodes=2)
    summary = train(config, show_progress=False)
    last = read_progress(tiny.run.out)[-1]
    assert int(last["step"]) == summary["evaluation_step"] == total_steps
    assert summary["evaluation_return"] == float(last["eval/return"])
    assert summary["versions"]["torch"] == torch.__version__
    assert summary["bonus"] == "curiosity" and summary["total_steps"] == total_steps


def test_peak_memory_is_above_what_is_resident():
    assert peak_memory_megabytes() > 50


MANY_RUNS = """
import sys
from functools import partial
from pathlib import Path
import torch
from deep_curiosity.training import Config, train

def resident():
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1])

folder = Path(sys.argv[1])
for number in range(50):
    config = Config.of(
        env_id="PendulumSwingup", total_steps=40, learning_starts=20, hidden_dim=16,
        batch_size=32, components=16, evaluation_episodes=1, log_interval=20,
        out=folder / str(number),
    )
    train(config, show_progress=False)
    print("resident", number, resident())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_fifty_runs_in_a_process_hold_no_more_memory_than_ten(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", MANY_RUNS, tmp_path], capture_output=True, text=True, check=True
    )
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith("resident")]
    resident = [int(kilobytes) for _, _, kilobytes in lines]
    assert len(resident) == 50
    assert resident[49] < 1.1 * resident[9], resident


def test_another_default_of_torch_is_refused_by_name(tiny):
    torch.set_default_dtype(torch.float64)
    try:
        with pytest.raises(ValueError, match=r"`torch\.set_default_dtype` must be left at .*64"):
            train(tiny, show_progress=False)
    finally:
        torch.set_default_dtype(torch.float32)
    assert not tiny.run.out.exists()


class Wanders(gymnasium.Wrapper):
    """Changes the working folder when it is made, and at every reset."""

    def __init__(self, elsewhere):
        super().__init__(gymnasium.make("Pendulum-v1"))
        self.elsewhere = elsewhere
        os.chdir(elsewhere)

    def reset(self, **options):
        os.chdir(self.elsewhere / "deeper")
        return super().reset(**options)


@pytest.mark.parametrize("num_envs", [1, 2])
def test_a_run_stays_where_it_was_begun_wherever_its_environment_goes(
    tiny, tmp_path, monkeypatch, num_envs
):
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "deeper").mkdir(parents=True)
    monkeypatch.setattr("deep_curiosity.training.figures.plot_run", lambda to: drawn.append(to))
    monkeypatch.chdir(tmp_path)
    drawn, make_env = [], lambda: Wanders(elsewhere)
    config = tiny.override(env_id=EnvironmentConfig().env_id, env_kwargs={}, num_envs=num_envs)
    config = config.override(out="runs/wandering")
    train(config, make_env=make_env, show_progress=False)
    assert Path.cwd() == tmp_path
    assert drawn == [tmp_path / "runs" / "wandering"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "runs"]
    assert [path.name for path in elsewhere.rglob("*")] == ["deeper"]
    written = {path.name for path in Path("runs/wandering").iterdir()}
    assert written >= {"config.json", "spaces.json", "checkpoint.pt", "progress.csv"}
    assert json.loads(Path("runs/wandering/config.json").read_text())["out"] == "runs/wandering"
    Path("runs/wandering").rename("moved")
    continue_run("moved", total_steps=80, make_env=make_env, show_progress=False)
    begun = config.override(init_from="moved", out="runs/next")
    train(begun, make_env=make_env, show_progress=False)
    assert read_config(Path("runs/next")).run.init_from == Path("moved")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "moved", "runs"]


def test_a_folder_is_named_in_errors_as_it_was_given(tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    train(tiny.override(out="mine"), show_progress=False)
    with pytest.raises(FileExistsError, match="must not hold a run already, got mine; continue"):
        train(tiny.override(out="mine"), show_progress=False)


def test_training_and_evaluations_never_share_an_environment(tiny):
    one = gymnasium.make("Pendulum-v1")
    config = Config.of(out=tiny.run.out, total_steps=60, learning_starts=20)
    with pytest.raises(ValueError, match="`make_env` must make a new environment at every call"):
        train(config, make_env=lambda: one, show_progress=False)


def test_settings_that_were_changed_by_hand_are_told_from_weights_of_another_size(tiny):
    config = tiny.override(bonus="rnd")
    train(config, show_progress=False)
    path = config.run.out / "config.json"
    path.write_text(path.read_text().replace('"hidden_dim": 16', '"hidden_dim": 24'))
    for use in (partial(continue_run, total_steps=70), load_bonus):
        with pytest.raises(ValueError, match=r"^`config\.json` in .* size mismatch for "):
            use(config.run.out)


@pytest.mark.parametrize(
    ("folder", "error", "message"),
    [
        (None, TypeError, "`folder` must be a path, got None"),
        ("~nobody-of-this-name/x", FileNotFoundError, "~nobody-of-this-name/x"),
    ],
)
def test_a_folder_of_nobody_is_refused_by_name_where_a_run_is_to_go_on(folder, error, message):
    with pytest.raises(error, match=message):
        continue_run(folder)
