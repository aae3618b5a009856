import csv
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from deep_curiosity.training import Settings, loop, train
from deep_curiosity.training.checkpoint import NEWEST, load_checkpoint
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.learner import Learner

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


def learned_weight(settings):
    """First layer of the policy that a short run ends with."""
    train(replace(settings, total_steps=30), show_progress=False)
    return load_checkpoint(settings.out)["learner"]["agent"]["policy.network.layers.0.weight"]


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


def rows(folder):
    with (folder / "progress.csv").open() as file:
        return [
            {name: value for name, value in row.items() if name not in TIMED}
            for row in csv.DictReader(file)
        ]


@pytest.mark.parametrize("bonus", ["curiosity", "none"])
def test_a_resumed_run_equals_an_uninterrupted_one_bit_for_bit(tiny, tmp_path, bonus):
    whole = replace(tiny, bonus=bonus, prior="learned", total_steps=90, out=tmp_path / "whole")
    halves = replace(whole, total_steps=45, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    train(replace(whole, resume=halves.out), show_progress=False)
    assert_same_state(
        load_checkpoint(whole.out)["learner"], load_checkpoint(halves.out)["learner"]
    )
    assert_same_state(
        load_checkpoint(whole.out)["collector"], load_checkpoint(halves.out)["collector"]
    )
    assert rows(whole.out)[-1] == rows(halves.out)[-1] != rows(whole.out)[-2]


@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_resumed_run_with_a_history_equals_an_uninterrupted_one(tiny, tmp_path, num_envs):
    hidden = replace(tiny, env_id="PendulumHiddenVelocity", history=3, num_envs=num_envs)
    whole = replace(hidden, total_steps=90, out=tmp_path / "whole")
    halves = replace(whole, total_steps=45, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    train(replace(whole, resume=halves.out), show_progress=False)
    for part in ("learner", "collector"):
        assert_same_state(load_checkpoint(whole.out)[part], load_checkpoint(halves.out)[part])
    assert load_checkpoint(whole.out)["collector"]["observation"].shape[-1] == 3 * 2 + 2 * 1
    assert rows(whole.out)[-1] == rows(halves.out)[-1] != rows(whole.out)[-2]


@pytest.mark.parametrize("vectorization", ["native", "sync"])
def test_a_resumed_run_of_several_worlds_equals_an_uninterrupted_one(
    tiny, tmp_path, vectorization
):
    reacher = replace(tiny, env_id="ReacherSparse", vectorization=vectorization, num_envs=3)
    several = replace(reacher, update_to_data=0.2, evaluation_interval=500)
    whole = replace(several, total_steps=330, out=tmp_path / "whole")
    halves = replace(several, total_steps=321, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    train(replace(whole, resume=halves.out), show_progress=False)
    for part in ("learner", "collector"):
        assert_same_state(load_checkpoint(whole.out)[part], load_checkpoint(halves.out)[part])
    assert rows(whole.out)[-1] == rows(halves.out)[-1] != rows(whole.out)[-2]


@pytest.mark.parametrize("vectorization", ["native", "sync", "async"])
def test_replay_holds_whole_episodes_of_every_world(tiny, vectorization):
    several = replace(
        tiny,
        env_id="ReacherSparse",
        env_kwargs={},
        num_envs=2,
        vectorization=vectorization,
        total_steps=210,
        learning_starts=205,
    )
    assert train(several, show_progress=False)["total_steps"] == 210
    state = load_checkpoint(several.out)["learner"]["replay"]["rows"].reshape(105, 2, -1)
    observation, next_observation = state[..., :10], state[..., 13:23]
    terminated, truncated = state[..., -2], state[..., -1]
    assert not terminated.any()
    assert truncated.nonzero().tolist() == [[99, world] for world in range(2)]
    follows = (observation[1:] == next_observation[:-1]).all(-1)
    assert torch.equal(~follows, truncated[:-1].bool())
    target = slice(6, 8)  # drawn anew in each episode
    assert torch.equal(
        next_observation[:100, :, target], observation[:1, :, target].expand(100, 2, 2)
    )
    assert (observation[100, :, target] != observation[99, :, target]).all()


def counted_updates(settings, monkeypatch):
    """Environment steps that were in replay at each update of a run."""
    steps, update = [], Learner.update

    def counting(self):
        steps.append(len(self.replay))
        return update(self)

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", counting)
        train(settings, show_progress=False)
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
    settings = replace(tiny, num_envs=num_envs, update_to_data=update_to_data, total_steps=30)
    assert counted_updates(settings, monkeypatch) == expected


def test_the_ratio_does_not_drift_over_resumed_parts(tiny, monkeypatch):
    part = replace(tiny, update_to_data=0.29, learning_starts=0, evaluation_interval=1000)
    steps = counted_updates(replace(part, total_steps=33), monkeypatch)
    for total_steps in (58, 77, 100):
        resumed = replace(part, resume=tiny.out, total_steps=total_steps)
        steps += counted_updates(resumed, monkeypatch)
    assert len(steps) == 29
    assert all(29 * step >= 100 * due > 29 * (step - 1) for due, step in enumerate(steps, 1))


def test_intervals_count_the_steps_of_all_worlds(tiny):
    summary = train(replace(tiny, num_envs=8, update_to_data=0.1), show_progress=False)
    assert summary["total_steps"] == 64  # the first multiple of 8 that is not below 60
    assert [int(row["step"]) for row in rows(tiny.out)] == [40, 64]
    assert [row["eval/return"] != "nan" for row in rows(tiny.out)] == [True, True]


def test_coverage_is_that_of_all_worlds(tiny):
    maze = replace(tiny, env_id="PointMaze", num_envs=16, total_steps=960, learning_starts=950)
    train(replace(maze, evaluation_interval=1000), show_progress=False)
    cells = load_checkpoint(maze.out)["history"]["cells"]
    assert len(cells) > 3
    assert max(cells.values()) > 16


def test_another_seed_gives_another_run(tiny, tmp_path):
    train(tiny, show_progress=False)
    train(replace(tiny, seed=1, out=tmp_path / "other"), show_progress=False)
    assert rows(tiny.out)[-1] != rows(tmp_path / "other")[-1]


@pytest.mark.drawn
def test_a_run_leaves_its_records(tiny):
    summary = train(tiny, show_progress=False)
    assert summary.keys() >= SUMMARY_KEYS
    assert json.loads((tiny.out / "summary.json").read_text()) == summary
    assert json.loads((tiny.out / "config.json").read_text())["batch_size"] == 32
    assert [int(row["step"]) for row in rows(tiny.out)] == [40, 60]
    assert (tiny.out / "run.png").stat().st_size > 10_000
    events = EventAccumulator(str(tiny.out)).Reload()
    tags = set(events.Tags()["scalars"])
    assert tags >= {"eval/return", "curiosity/nats", "agent/critic_loss", "agent/information_rate"}


def test_coverage_is_told_where_the_task_has_cells(tiny, tmp_path):
    maze = replace(tiny, env_id="PointMaze", out=tmp_path / "maze")
    assert 0 < train(maze, show_progress=False)["coverage"] < 1
    assert train(tiny, show_progress=False)["coverage"] is None


def test_a_folder_that_holds_a_run_is_left_alone(tiny):
    train(tiny, show_progress=False)
    before = (tiny.out / "config.json").read_text()
    with pytest.raises(FileExistsError, match=r"`out` must not hold a run already.*--resume"):
        train(replace(tiny, seed=5), show_progress=False)
    assert (tiny.out / "config.json").read_text() == before


def test_a_run_that_fails_at_once_can_be_continued(tiny, monkeypatch):
    monkeypatch.setattr(Collector, "step", lambda self, action: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train(tiny, show_progress=False)
    monkeypatch.undo()
    assert train(replace(tiny, resume=tiny.out), show_progress=False)["total_steps"] == 60


def test_a_resumed_run_keeps_its_number_of_steps_unless_another_is_given(tiny):
    choosy = replace(tiny, features=(0, -1), bonus_parts={"cross_entropy": 1.0})
    train(choosy, show_progress=False)
    assert train(Settings(resume=tiny.out), show_progress=False)["total_steps"] == 60


def test_a_resumed_run_keeps_its_own_settings(tiny):
    train(tiny, show_progress=False)
    with pytest.raises(ValueError, match=r"`batch_size` must stay.*32, got 64"):
        train(replace(tiny, resume=tiny.out, batch_size=64), show_progress=False)


def test_a_truncated_checkpoint_is_reported_and_the_one_before_it_used(tiny):
    train(tiny, show_progress=False)
    newest = tiny.out / NEWEST
    newest.write_bytes(newest.read_bytes()[:1000])
    with pytest.warns(UserWarning, match=r"checkpoint.pt is damaged.*previous"):
        summary = train(replace(tiny, resume=tiny.out, total_steps=70), show_progress=False)
    assert summary["total_steps"] == 70


def test_an_environment_that_raises_leaves_checkpoint_and_records(tiny, monkeypatch):
    step = Collector.step

    def failing(self, action):
        if self.seed == tiny.seed and len(self.actions) == 55:
            raise RuntimeError("the simulator broke")
        return step(self, action)

    monkeypatch.setattr(Collector, "step", failing)
    with pytest.raises(RuntimeError, match="the simulator broke"):
        train(tiny, show_progress=False)
    monkeypatch.undo()
    assert load_checkpoint(tiny.out)["history"]["step"] == 50
    assert [int(row["step"]) for row in rows(tiny.out)] == [40]
    assert train(replace(tiny, resume=tiny.out), show_progress=False)["total_steps"] == 60


def test_a_nan_from_the_environment_stops_the_run_by_name(tiny, monkeypatch):
    step = Collector.step

    def broken(self, action):
        taken, episode = step(self, action)
        return taken._replace(reward=float("nan")), episode

    monkeypatch.setattr(Collector, "step", broken)
    with pytest.raises(ValueError, match="`reward` must be finite, got \\[nan\\]"):
        train(tiny, show_progress=False)


def test_ctrl_c_ends_after_the_step_with_a_checkpoint(tiny, monkeypatch, capsys):
    handler = signal.getsignal(signal.SIGINT)
    update = Learner.update

    def interrupting(self):
        if len(self.replay) == 33:
            os.kill(os.getpid(), signal.SIGINT)
        return update(self)

    monkeypatch.setattr(Learner, "update", interrupting)
    summary = train(tiny, show_progress=False)
    assert summary["total_steps"] == 33
    assert load_checkpoint(tiny.out)["history"]["step"] == 33
    assert f"--resume {tiny.out}" in capsys.readouterr().out
    monkeypatch.undo()
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.fixture(scope="module")
def unchanged(tiny_settings, tmp_path_factory):
    """The weight that the settings of `tiny` lead to."""
    return learned_weight(replace(tiny_settings, out=tmp_path_factory.mktemp("unchanged") / "run"))


@pytest.mark.parametrize(
    "change",
    [
        {"bonus": "none"},
        {"bonus": "constant"},
        {"prior": "learned"},
        {"curiosity_discount": 0.0},
        {"bandwidth": "perplexity"},
        {"bandwidth": 0.3},
        {"whitening": "robust"},
        {"marginal_horizon": 5},
        {"marginal_horizon": 5, "marginal_forgetting": "exponential"},
        {"features": (0, -1)},
        {"bonus_parts": {"predictive_power": 1.0}},
        {"bonus_parts": {"information_gain": 1.0}},
        {"bonus_parts": {"cross_entropy": 1.0}},
        {"bonus_parts": {"negative_entropy": 1.0}},
        {"noise_floor": 0.3},
        {"hunger": 0.0},
        {"bonus_weight": 1.0},
        {"temperature": 1.0},
        {"temperature_control": "constant"},
        {"temperature_control": "linear"},
        {"temperature_control": "annealing", "temperature": 1.0},
        {"temperature_control": "linear", "final_temperature": 1.0},
        {"hunger_control": "linear"},
        {"hunger_control": "linear", "final_hunger": 0.1},
        {"curiosity_ends": 25},
        {"curiosity_steps": 3},
        {"reward_steps": 3},
        {"tune_bonus_weight": "past"},
        {"tune_bonus_weight": 50.0},
        {"hunger_control": "dial"},
        {"target_information_rate": 3.0},
        {"discount": 0.5},
        {"polyak": 0.5},
        {"learning_rate": 1e-2},
        {"model_learning_rate": 1e-2},
        {"members": 3},
        {"components": 8},
        {"refresh_interval": 1},
        {"batch_size": 16},
        {"actor_stride": 1},
        {"critic_per_row": False},
        {"hidden_dim": 8},
        {"history": 3},
    ],
    ids=str,
)
def test_every_setting_of_learning_changes_what_is_learned(tiny, unchanged, change):
    weights = unchanged, learned_weight(replace(tiny, **change))
    assert weights[0].shape != weights[1].shape or not torch.equal(*weights)


def test_ways_of_forgetting_are_not_the_same(tiny, tmp_path):
    window = replace(tiny, marginal_horizon=5)
    train(window, show_progress=False)
    fading = replace(window, marginal_forgetting="exponential", out=tmp_path / "fading")
    train(fading, show_progress=False)
    assert rows(window.out)[-1]["agent/policy_loss"] != rows(fading.out)[-1]["agent/policy_loss"]


def test_a_curiosity_that_does_not_yield_learns_otherwise(tiny, tmp_path):
    faint = replace(tiny, bonus_weight=1e-3)
    train(faint, show_progress=False)
    train(replace(faint, yielding=False, out=tmp_path / "changed"), show_progress=False)
    assert float(rows(tiny.out)[-1]["agent/curiosity_share"]) < 1
    assert float(rows(tmp_path / "changed")[-1]["agent/curiosity_share"]) == 1
    assert (
        rows(tiny.out)[-1]["agent/policy_loss"]
        != rows(tmp_path / "changed")[-1]["agent/policy_loss"]
    )


def test_forgetting_without_a_horizon_is_rejected():
    with pytest.raises(ValueError, match="`marginal_forgetting` must be 'window' where no"):
        Settings(marginal_forgetting="exponential")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"total_steps": 0}, "`total_steps` must be at least 1, got 0"),
        ({"history": 0}, "`history` must be at least 1, got 0"),
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
        ({"members": 1}, "`members` must be at least 2"),
        ({"noise_floor": 0.0}, "`noise_floor` must be positive"),
        ({"marginal_horizon": 0}, "`marginal_horizon` must be at least 1, got 0"),
        ({"features": (0, 9)}, r"`features` must name different entries of 3, got \[0, 9\]"),
        ({"bonus_parts": {"novelty": 1.0}}, "`parts` must be named .*got 'novelty'"),
        ({"temperature": -1.0}, "`temperature` must be finite and positive"),
        ({"env_id": "PendulumSwingdown"}, "`env_id` must be a registered id such as .*Swingup"),
        ({"env_id": "CartPole-v1", "env_kwargs": {}}, "`action_space` must be a Box"),
        ({"env_kwargs": {"acton_cost": 1.0}}, "`env_kwargs` must be arguments of .*acton_cost"),
    ],
    ids=str,
)
def test_a_bad_setting_is_named_before_a_folder_is_made(tiny, change, message):
    with pytest.raises(ValueError, match=message):
        train(replace(tiny, **change), show_progress=False)
    assert not tiny.out.exists()


def test_a_word_that_is_no_choice_is_named_with_the_choices(tiny):
    object.__setattr__(tiny, "vectorization", "threads")  # as without the type checks of the tests
    with pytest.raises(ValueError, match=r"`vectorization` must be one of .*sync.*got 'threads'"):
        tiny.__post_init__()


def test_the_progress_bar_tells_return_nats_and_speed(tiny, capsys):
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
