import shutil
from dataclasses import replace

import pytest
import torch

from deep_curiosity import precision
from deep_curiosity.speed.precision import FLOAT32_ERROR, matmul_error, matmul_is_float32
from deep_curiosity.training import Settings, machine, train
from deep_curiosity.training.learner import Learner
from deep_curiosity.speed.machine import (
    choose_matmul_precision,
    matmul_rate,
    prepare_machine,
    should_compile,
)
from deep_curiosity.training.log import read_settings


def test_the_highest_precision_is_float32():
    torch.set_float32_matmul_precision("highest")
    assert matmul_is_float32() and 0 < matmul_error() < 1e-6


def test_the_precision_asked_for_is_taken():
    assert [choose_matmul_precision(asked) for asked in ("high", "medium")] == ["high", "medium"]


def test_the_fastest_precision_is_taken_that_is_float32(monkeypatch):
    errors = {"highest": 2e-7, "high": 3e-7, "medium": 4e-3}
    rates = {"highest": 1.0, "high": 2.0, "medium": 9.0}
    switch = torch.get_float32_matmul_precision
    monkeypatch.setattr(machine, "matmul_error", lambda device: errors[switch()])
    monkeypatch.setattr(machine, "matmul_rate", lambda device: rates[switch()])
    before = switch()
    assert choose_matmul_precision("auto") == "high"
    assert switch() == before


def test_products_that_are_not_float32_are_noticed(monkeypatch):
    monkeypatch.setattr(precision, "_measured_error", lambda switch, device: 10 * FLOAT32_ERROR)
    assert not matmul_is_float32()


def test_a_run_says_what_it_does_with_the_machine(capsys):
    assert prepare_machine(Settings(matmul_precision="high", total_steps=100)) == "high"
    said = capsys.readouterr().out
    assert said.startswith("Matrix products high, relative error ") and "updates eager" in said
    assert torch.get_float32_matmul_precision() == "high"


def test_a_resumed_run_keeps_the_precision_that_was_fastest_when_it_began(monkeypatch, tiny):
    fastest = ["high"]
    monkeypatch.setattr(machine, "matmul_error", lambda device: 0.0)
    monkeypatch.setattr(
        machine,
        "matmul_rate",
        lambda device: float(torch.get_float32_matmul_precision() == fastest[0]),
    )
    train(replace(tiny, matmul_precision="auto"), show_progress=False)
    assert read_settings(tiny.out).matmul_precision == "high"
    fastest[0] = "medium"
    torch.set_float32_matmul_precision("medium")
    train(Settings(resume=tiny.out, total_steps=70), show_progress=False)
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
    settings = Settings(total_steps=total_steps, update_to_data=update_to_data)
    assert should_compile(settings) == worth_it


def test_auto_compiles_nothing_without_a_compiler(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert not should_compile(Settings(total_steps=100_000))
    assert should_compile(Settings(total_steps=100_000, compile="on"))


def test_an_unknown_device_is_rejected():
    with pytest.raises(ValueError, match="`device` must be cpu or cuda, got 'tpu'"):
        Settings(device="tpu")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_told():
    with pytest.raises(ValueError, match="`device` must be one that torch can use here"):
        Settings(device="cuda")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_everything_lives_on_the_gpu():
    learner = Learner(Settings(device="cuda", hidden_dim=32), 3, 2)
    for observation, next_observation in torch.randn(300, 2, 3).numpy():
        learner.replay.add(observation, torch.rand(2).numpy(), 0.0, next_observation, False, False)
    metrics = [learner.update() for _ in range(5)][-1]
    assert all(value.isfinite() for value in metrics.values())
    assert {value.device.type for value in learner.agent.state_dict().values()} == {"cuda"}
    assert learner.act(torch.zeros(3).numpy()).shape == (2,)
