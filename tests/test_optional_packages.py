"""What is missing is asked for with the command that installs it, whichever module needs it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tomllib

OF_TRAINING = {"gymnasium", "mujoco", "matplotlib", "tensorboard", "tqdm", "tyro"}
OTHERS = {
    "imageio",
    "onnx",
    "onnxruntime",
    "onnxscript",
    "optuna",
    "pink",
    "safetensors",
    "sb3_contrib",
    "scipy",
    "shimmy",
    "stable_baselines3",
    "tensordict",
    "torchrl",
}
IMPORT_ALL = """
import importlib, json, pkgutil, sys
for name in {missing!r}:
    sys.modules[name] = None  # as if it were not installed
import deep_curiosity
try:
    import deep_curiosity_envs
    packages = [deep_curiosity, deep_curiosity_envs]
    messages = {{}}
except ImportError as error:
    packages = [deep_curiosity]
    messages = {{"deep_curiosity_envs": repr(error)}}
for package in packages:
    skip = lambda name: None
    for each in pkgutil.walk_packages(package.__path__, package.__name__ + ".", onerror=skip):
        if not each.name.endswith("__main__"):
            try:
                importlib.import_module(each.name)
                messages[each.name] = ""
            except ImportError as error:
                messages[each.name] = repr(error)
print(json.dumps(messages))
"""
ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def messages_without(missing):
    """What importing each module says in a process that lacks some packages; empty for nothing."""
    code = IMPORT_ALL.format(missing=sorted(missing))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_without_any_extra_every_module_is_there_or_says_what_to_install():
    messages = messages_without(OF_TRAINING | OTHERS)
    asking = {name for name, message in messages.items() if message}
    for name in asking:
        assert messages[name].startswith("ImportError"), (name, messages[name])
        assert "pip install 'deep-curiosity[" in messages[name], (name, messages[name])
    needless = {name for name in asking if name.split(".")[1:2] in (["bonuses"], ["agent"])}
    assert not needless
    assert {"deep_curiosity_envs", "deep_curiosity.training.loop"} <= asking
    assert "[envs]" in messages["deep_curiosity_envs"]
    assert "[train]" in messages["deep_curiosity.training.loop"]


def test_the_extra_for_training_is_all_that_training_and_the_command_line_need():
    messages = messages_without(OTHERS)
    for name, message in messages.items():
        assert not message or "pip install 'deep-curiosity[" in message, (name, message)
    for part in ("training", "cli", "experiments", "tabular"):
        own = {n: m for n, m in messages.items() if n.startswith(f"deep_curiosity.{part}")}
        assert own
        foreign = {
            f"deep_curiosity.experiments.studies.{name}"
            for name in ("stable_baselines3", "torchrl", "searches")
        } | {f"deep_curiosity.experiments.{name}" for name in ("tuner", "tuner_torture")}
        assert not any(own[name] for name in own.keys() - foreign), own


def test_every_extra_that_is_named_anywhere_exists():
    extras = set(PYPROJECT["project"]["optional-dependencies"])
    sources = [*ROOT.glob("deep_curiosity/**/*.py"), *ROOT.glob("envs/**/*.py")]
    pages = [ROOT / "README.md", *ROOT.glob("docs/**/*.md")]
    text = "".join(path.read_text() for path in (*sources, *pages))
    named = set(re.findall(r"deep-curiosity\[([a-z0-9,]+)\]", text))
    named |= set(re.findall(r'extra="([a-z0-9]+)"', text))
    assert {"train", "sb3", "torchrl"} <= named
    assert {extra for names in named for extra in names.split(",")} <= extras


def test_the_package_itself_is_imported_without_torch():
    code = "import sys, deep_curiosity, deep_curiosity.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_every_public_name_is_there():
    import deep_curiosity

    assert set(deep_curiosity._MODULES) == set(deep_curiosity.__all__)
    for name in deep_curiosity.__all__:
        assert getattr(deep_curiosity, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'curiosity_of_another'"):
        deep_curiosity.curiosity_of_another  # noqa: B018
