import json

import pytest
import torch

import deep_curiosity as dc
from deep_curiosity.cli import main
from deep_curiosity.speed.config import SpeedConfig
from deep_curiosity.training import Config, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.log import CONFIG, read_config, write_json


@pytest.fixture
def of_a_gpu(tiny, monkeypatch):
    """Folder of a run whose settings name a GPU, where there is none."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    train(tiny, show_progress=False)
    path = tiny.run.out / CONFIG
    write_json(path, json.loads(path.read_text()) | {"device": "cuda"})
    return tiny.run.out


def test_a_run_of_a_gpu_is_played_where_there_is_none(of_a_gpu, capsys):
    assert main(["evaluate", str(of_a_gpu), "--episodes", "1"]) == 0
    assert "return" in capsys.readouterr().out


def test_a_run_of_a_gpu_goes_on_where_there_is_none_on_another_device(of_a_gpu, capsys):
    resumed = ["train", "--resume", str(of_a_gpu), "--total-steps"]
    assert main([*resumed, "65", "--device", "cpu"]) == 0
    assert "`device` is cpu, it was cuda" in capsys.readouterr().out
    assert read_config(of_a_gpu).speed.device == "cpu"


def test_the_same_in_python(of_a_gpu):
    run = dc.continue_run(of_a_gpu, total_steps=65, device="cpu", show_progress=False)
    assert run.summary["total_steps"] == 65
    assert len(load_checkpoint(of_a_gpu)["learner"]["replay"]["rows"]) == 65


def test_it_does_not_go_on_by_itself_where_its_device_is_missing(of_a_gpu):
    with pytest.raises(ValueError, match=r"`device` must be one that torch can use here, .*cuda'"):
        dc.continue_run(of_a_gpu, show_progress=False)


def test_a_run_is_not_begun_on_a_device_that_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    config = Config(speed=SpeedConfig(device="cuda")).override(out=tmp_path / "run")
    with pytest.raises(ValueError, match=r"`device` must be one that torch can use here, .*cuda'"):
        train(config, show_progress=False)
    assert not config.run.out.exists()
