import re
from dataclasses import MISSING, fields, replace
from pathlib import Path

import pytest
import torch

from deep_curiosity.training import Settings, train
from deep_curiosity.training.log import read_progress

README = (Path(__file__).parents[1] / "README.md").read_text()


@pytest.mark.parametrize("setting", fields(Settings), ids=lambda setting: setting.name)
def test_every_option_is_told_with_its_default(setting):
    option = setting.name.replace("_", "-")
    default = "" if setting.default is MISSING else f"`{setting.default}`"
    assert f"| `--{option}` | {default} |" in README


def test_no_option_is_told_that_does_not_exist():
    told = re.findall(r"^\| `--([a-z-]+)` \|", README, flags=re.MULTILINE)
    assert sorted(told) == sorted(setting.name.replace("_", "-") for setting in fields(Settings))


def test_every_logged_tag_is_told(tiny):
    for number, env_id in enumerate(["PointMaze", "PendulumSwingup"]):
        run = Settings(**vars(tiny) | {"env_id": env_id, "env_kwargs": {}, "prior": "learned"})
        run = Settings(**vars(run) | {"out": tiny.out / str(number)})
        train(run, show_progress=False)
        for tag in list(read_progress(run.out)[0])[1:]:
            assert f"`{tag}`" in README


def test_the_hunger_of_the_caller_is_followed_as_written(tiny):
    code = re.search(r"```python\n(from deep_curiosity.training import.*?)```", README, re.S)
    written = code.group(1).replace("Settings(env_id", "settings_of(env_id")
    names = {"settings_of": lambda **chosen: replace(tiny, env_kwargs={}, **chosen)}
    exec(written, names)
    hungers = [float(row["agent/hunger"]) for row in read_progress(tiny.out)]
    assert 0 < hungers[0] < hungers[1] < 1  # the battery drains


def test_the_five_lines_run_as_written():
    code = re.search(r"```python\n(from deep_curiosity import CuriosityBonus.*?)```", README, re.S)
    batch = 32
    names = {
        "torch": torch,
        "observation_dim": 3,
        "action_dim": 2,
        "observation": torch.randn(batch, 3),
        "action": torch.rand(batch, 2) * 2 - 1,
        "reward": torch.zeros(batch),
        "next_observation": torch.randn(batch, 3),
        "terminated": torch.zeros(batch, dtype=torch.bool),
        "truncated": torch.zeros(batch, dtype=torch.bool),
        "policy": lambda observation: torch.zeros(observation.shape[0], 2),
    }
    exec(code.group(1), names)
    assert names["reward"].shape == (batch,)
    assert names["reward"].std() > 0
