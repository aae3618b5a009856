import re
from itertools import chain
from pathlib import Path

import pytest
import torch

from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import as_plain, flat
from deep_curiosity.training import Config, train
from deep_curiosity.training.command_line import COMMON
from deep_curiosity.training.log import read_progress

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
OF_THE_COMMAND_LINE = {
    "resume": "None",
    "bonus": "curiosity",
    "preset": "fast",
    "settings": "None",
    "stop_when_solved": "None",
    "new_episode": "False",
}
OF_OTHER_COMMANDS = {
    "help", "help-all",
    "episodes", "video",  # of evaluate.py
    "only", "repeats", "steps",  # of benchmark.py
    "logdir",  # of tensorboard
}  # fmt: skip
OF_EPISODES = {"episode/return", "episode/length"}


def flag(name):
    return name.replace("_", "-")


def default_of(name):
    if name in OF_THE_COMMAND_LINE:
        return OF_THE_COMMAND_LINE[name]
    value = as_plain(flat(Config())[name].value)
    return "" if value in ({}, []) else value


@pytest.mark.parametrize("name", [*COMMON, *OF_THE_COMMAND_LINE])
def test_every_common_option_is_listed_with_its_default(name):
    default = default_of(name)
    shown = "" if default == "" else f"`{default}`"
    assert f"| `--{flag(name)}` | {shown} |" in README


def test_no_other_option_is_listed_and_the_order_is_that_of_the_help():
    listed = re.findall(r"^\| `--([a-z-]+)` \|", README, flags=re.MULTILINE)
    assert listed == [flag(name) for name in (*COMMON, *OF_THE_COMMAND_LINE)]


def test_no_flag_is_named_that_does_not_exist():
    settings = chain(*(flat(Config.of(bonus=kind)) for kind in BONUS_CONFIGS))
    known = {flag(name) for name in (*settings, *OF_THE_COMMAND_LINE)} | OF_OTHER_COMMANDS
    named = set(re.findall(r"--([a-z][a-z-]+)", README))
    assert {name.removeprefix("no-") for name in named} <= known


def test_every_logged_tag_is_explained_and_no_other(tiny):
    pendulum = tiny.override(prior="learned", tune_bonus_weight="past")
    runs = [
        pendulum,
        pendulum.override(env_id="PointMaze", env_kwargs={}),
        tiny.override(bonus="rnd"),
    ]
    logged = set(OF_EPISODES)
    for number, config in enumerate(runs):
        config = config.override(out=tiny.run.out / str(number))
        train(config, show_progress=False)
        logged |= set(read_progress(config.run.out)[0]) - {"step"}
    table = README.partition("| tag | formula |")[2].partition("\n\n")[0]
    cells = [row.split(" | ")[0] for row in table.splitlines()[2:]]
    assert {tag for cell in cells for tag in re.findall(r"`([^`]+)`", cell)} == logged


def test_every_file_that_is_linked_is_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)", README)
    assert not [link for link in links if not (ROOT / link).exists()]


def test_the_hunger_of_the_caller_is_followed_as_written(tiny):
    code = re.search(r"```python\n(from deep_curiosity.training import.*?)```", README, re.S)
    written = code.group(1).replace("Config.of(", "tiny.override(env_kwargs={}, ")
    exec(written, {"tiny": tiny})
    hungers = [float(row["agent/hunger"]) for row in read_progress(tiny.run.out)]
    assert 0 < hungers[0] < hungers[1] < 1  # the battery drains


def test_a_policy_is_used_and_exported_as_written(tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    train(tiny.override(env_id="PointMaze", out="runs/first"), show_progress=False)
    code = re.search(r"```python\n(import deep_curiosity as dc\n.*?)```", README, re.S)
    names = {}
    exec(code.group(1), names)
    assert names["action"].shape == (2,)
    assert (tmp_path / "exported/maze.pt2").exists()


def test_several_environments_are_made_as_written():
    code = re.search(r"```python\n(import gymnasium\n.*?)```", README, re.S)
    names = {}
    exec(code.group(1), names)
    assert names["envs"].num_envs == 64
    names["envs"].close()


def test_the_five_lines_run_as_written():
    first = "import torch\nfrom deep_curiosity import CuriosityBonus"
    code = re.search(rf"```python\n({first}.*?)```", README, re.S)
    batch = 32
    names = {
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
