import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import tomllib

from deep_curiosity import __version__, cli
from deep_curiosity.cli import COMMANDS, main

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]], ids=str)
def test_the_help_lists_every_command(arguments, capsys):
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    for name, command in COMMANDS.items():
        assert f"  {name}" in printed
        assert command.about in printed


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_says_how_it_is_called_and_what_its_options_are(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    assert stopped.value.code == 0
    printed = capsys.readouterr().out
    assert f"usage: deep-curiosity {name}" in printed
    about = (import_module(COMMANDS[name].module).__doc__ or "").split()[:3]
    assert " ".join(about) in printed


def test_a_command_that_does_not_exist_is_answered_with_the_nearest(refusal):
    answer = refusal("trian")
    assert answer.startswith("error: `command` must be one of train, ")
    assert "got 'trian'; did you mean train?" in answer
    assert answer.count("\n") == 1


def test_the_version_is_printed_and_is_the_one_that_is_cited(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"{__version__}\n"
    assert f"version: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {__version__}" in (ROOT / "CHANGELOG.md").read_text()


ERRORS = {
    "mistake": ValueError("`x` must be 1, got 2."),
    "interruption": KeyboardInterrupt(),
    "fault": ZeroDivisionError(),
}


class Raising:
    @staticmethod
    def main(arguments):
        raise ERRORS[arguments[0]]


def test_a_mistake_is_one_line_and_an_interruption_none(monkeypatch, capsys, refusal):
    monkeypatch.setattr(cli, "import_module", lambda name: Raising)
    assert refusal("train", "mistake") == "error: `x` must be 1, got 2.\n"
    with pytest.raises(SystemExit) as stopped:
        main(["train", "interruption"])
    assert stopped.value.code == 130
    assert capsys.readouterr().err == ""
    with pytest.raises(ZeroDivisionError):
        main(["train", "fault"])


def test_a_command_whose_extra_is_missing_says_what_to_install():
    code = (
        "import sys; sys.modules['tyro'] = None; from deep_curiosity.cli import main; "
        "sys.exit(main(['train']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "error: tyro is missing: pip install 'deep-curiosity[train]'\n"


def test_the_installed_program_is_this_one():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    module, _, function = project["scripts"]["deep-curiosity"].partition(":")
    assert getattr(import_module(module), function) is main
    done = subprocess.run(
        [sys.executable, "-m", "deep_curiosity", "--version"], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (0, f"{__version__}\n")
