import shutil
from random import Random

import numpy as np
import pytest
import torch

from deep_curiosity.speed import machine
from deep_curiosity.speed.config import SpeedConfig
from deep_curiosity.speed.machine import (
    choose_matmul_precision,
    fitted_machine,
    matmul_rate,
    should_compile,
)
from deep_curiosity.training import Config, continue_run, train
from deep_curiosity.training import learner as learner_module
from deep_curiosity.training.learner import Learner, compiles, compiles_from
from deep_curiosity.training.log import read_config
from deep_curiosity.training.run import open_run


@pytest.fixture
def other_settings():
    """Threads and precision that no run would choose."""
    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    torch.set_float32_matmul_precision("medium")
    yield 3, "medium"
    torch.set_num_threads(threads)


def settings_of_torch():
    return torch.get_num_threads(), torch.get_float32_matmul_precision()


def test_a_machine_is_fitted_inside_the_block_alone(other_settings):
    speed = SpeedConfig(threads=2, matmul_precision="high", keep_memory=False)
    for _ in range(2):
        with fitted_machine(speed) as precision:
            assert precision == "high" and settings_of_torch() == (2, "high")
        assert settings_of_torch() == other_settings


@pytest.mark.parametrize("keep_memory", [False, True])
def test_a_machine_is_restored_also_when_the_block_raises(other_settings, keep_memory):
    speed = SpeedConfig(threads=2, matmul_precision="high", keep_memory=keep_memory)
    with pytest.raises(RuntimeError, match="inside"), fitted_machine(speed):
        raise RuntimeError("inside")
    assert settings_of_torch() == other_settings


def test_a_machine_is_restored_also_when_no_precision_can_be_chosen(other_settings, monkeypatch):
    def fail(device):
        raise RuntimeError("measuring")

    monkeypatch.setattr(machine, "matmul_error", fail)
    speed = SpeedConfig(threads=2, matmul_precision="auto", keep_memory=False)
    with pytest.raises(RuntimeError, match="measuring"), fitted_machine(speed):
        pass
    assert settings_of_torch() == other_settings


def test_a_precision_that_is_named_is_taken_without_measuring_any(monkeypatch):
    monkeypatch.setattr(machine, "matmul_rate", lambda device: pytest.fail("measured"))
    torch.set_float32_matmul_precision("highest")
    for wanted in ("highest", "high", "medium"):
        assert choose_matmul_precision(wanted) == wanted
        assert torch.get_float32_matmul_precision() == "highest"


def test_the_precision_asked_for_is_taken():
    assert [choose_matmul_precision(named) for named in ("high", "medium")] == ["high", "medium"]


def test_a_much_faster_precision_is_taken_that_is_float32(monkeypatch):
    errors = {"highest": 2e-7, "high": 3e-7, "medium": 4e-3}
    rates = {"highest": 1.0, "high": 2.0, "medium": 9.0}
    switch = torch.get_float32_matmul_precision
    monkeypatch.setattr(machine, "matmul_error", lambda device: errors[switch()])
    monkeypatch.setattr(machine, "matmul_rate", lambda device: rates[switch()])
    before = switch()
    assert choose_matmul_precision("auto") == "high"
    assert switch() == before


def test_the_noise_of_a_clock_does_not_choose_how_a_run_rounds(monkeypatch):
    random = Random(0)
    monkeypatch.setattr(machine, "matmul_error", lambda device: 3e-7)
    monkeypatch.setattr(machine, "matmul_rate", lambda device: random.uniform(0.7, 1.0))
    assert {choose_matmul_precision("auto") for _ in range(100)} == {"highest"}


def test_a_run_says_what_it_does_with_the_machine(capsys, tiny):
    with open_run(tiny.override(matmul_precision="high")) as run:
        assert run.config.speed.matmul_precision == "high"
        assert torch.get_float32_matmul_precision() == "high"
    said = capsys.readouterr().out
    assert said.startswith("Matrix products high, relative error ") and "updates eager" in said
    with open_run(tiny.override(out=tiny.run.out / "other"), quiet=True):
        assert not capsys.readouterr().out


def test_a_resumed_run_keeps_the_precision_that_was_fastest_when_it_began(monkeypatch, tiny):
    fastest = ["high"]
    monkeypatch.setattr(machine, "matmul_error", lambda device: 0.0)
    monkeypatch.setattr(
        machine,
        "matmul_rate",
        lambda device: float(torch.get_float32_matmul_precision() == fastest[0]),
    )
    config = tiny.override(matmul_precision="auto")
    train(config, show_progress=False)
    assert read_config(tiny.run.out).speed.matmul_precision == "high"
    fastest[0] = "medium"
    torch.set_float32_matmul_precision("medium")
    continue_run(tiny.run.out, total_steps=70, show_progress=False)
    assert read_config(tiny.run.out).speed.matmul_precision == "high"
    with open_run(config.override(total_steps=80), resume=True):
        assert torch.get_float32_matmul_precision() == "high"


def test_a_rate_is_operations_over_seconds():
    assert 1e8 < matmul_rate(2, 64) < 1e13


@pytest.mark.parametrize(
    ("total_steps", "update_to_data", "worth_it"),
    [(5_600, 1.0, True), (5_400, 1.0, False), (5_400, 2.0, True), (20_000, 0.1, False)],
)
def test_auto_compiles_where_the_planned_updates_pay_for_it(
    monkeypatch, total_steps, update_to_data, worth_it
):
    monkeypatch.setattr(shutil, "which", lambda name: "/a/compiler")
    config = Config.of(total_steps=total_steps, update_to_data=update_to_data)
    assert compiles(config) == worth_it


@pytest.mark.parametrize(
    ("settings", "start"),
    [
        ({"compile": "auto"}, 1_000),
        ({"compile": "auto", "update_to_data": 0.3}, 500 + 1_667),
        ({"compile": "on"}, 500),
        ({"compile": "off"}, None),
        ({"compile": "auto", "total_steps": 5_400}, None),
    ],
    ids=str,
)
def test_a_run_is_seen_to_learn_before_auto_compiles(monkeypatch, settings, start):
    monkeypatch.setattr(shutil, "which", lambda name: "/a/compiler")
    config = Config.of(**{"learning_starts": 500, "total_steps": 40_000} | settings)
    assert compiles_from(config) == start


@pytest.mark.parametrize(("switch", "at_first"), [("auto", False), ("on", True)])
def test_the_step_alone_says_when_a_graph_is_made(tiny, monkeypatch, switch, at_first):
    made = []
    monkeypatch.setattr(shutil, "which", lambda name: "/a/compiler")
    monkeypatch.setattr(learner_module, "compiled", lambda update, **how: made.append(how))
    learner = Learner(tiny.override(compile=switch, total_steps=9_000), 3, 1)
    assert len(made) == at_first
    for step in (0, 519, 520, 521):
        learner.before_step(step, np.zeros((1, 3)), {})
        assert len(made) == (at_first or step >= 520)
    resumed = Learner(tiny.override(compile=switch, total_steps=9_000), 3, 1)
    resumed.before_step(700, np.zeros((1, 3)), {})
    assert len(made) == 2
    within = Learner(tiny.override(compile=switch, total_steps=9_000), 3, 1)
    within.compile_when_due(700)  # cut off within a step, whose action was chosen already
    assert len(made) == 3
    assert {how["fall_back"] for how in made} == {switch == "auto"}


def test_auto_compiles_nothing_without_a_compiler(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert not should_compile(SpeedConfig(), 99_500.0)
    assert should_compile(SpeedConfig(compile="on"), 99_500.0)


def test_an_unknown_device_is_rejected():
    with pytest.raises(ValueError, match="`device` must be cpu or cuda, got 'tpu'"):
        Config.of(device="tpu")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_reported():
    with pytest.raises(ValueError, match="`device` must be one that torch can use here"):
        Config.of(device="cuda")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_everything_lives_on_the_gpu():
    learner = Learner(Config.of(device="cuda", hidden_dim=32), 3, 2)
    for observation, next_observation in torch.randn(300, 2, 3).numpy():
        learner.replay.add(observation, torch.rand(2).numpy(), 0.0, next_observation, False, False)
    metrics = [learner.update() for _ in range(5)][-1]
    assert all(value.isfinite() for value in metrics.values())
    assert {value.device.type for value in learner.agent.state_dict().values()} == {"cuda"}
    assert learner.act(torch.zeros(1, 3).numpy()).shape == (1, 2)
