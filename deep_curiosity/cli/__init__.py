"""The command line, `deep-curiosity COMMAND`: every command is a module, loaded when asked for."""

import difflib
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple

from deep_curiosity import __version__

PROGRAM = "deep-curiosity"
MISTAKES = (ImportError, OSError, RuntimeError, TypeError, ValueError)
"""Errors that are answered in one line."""


class Command(NamedTuple):
    """A command of the program.

    Args:
        module: Its module, whose `main(arguments)` gives an exit status.
        about: What it does, for the help.
    """

    module: str
    about: str


COMMANDS = {
    "train": Command("deep_curiosity.cli.train", "train an agent on a task, or continue a run"),
    "evaluate": Command("deep_curiosity.cli.evaluate", "play a run; --video films an episode"),
    "plot": Command("deep_curiosity.cli.plot", "learning curves of many runs, PNG and HTML"),
    "study": Command("deep_curiosity.cli.study", "tasks x agents x seeds, with statistics"),
    "export": Command("deep_curiosity.cli.export", "write a policy as ONNX, .pt2 or safetensors"),
    "check": Command("deep_curiosity.cli.check", "whether the bonus works on your environment"),
    "demo": Command("deep_curiosity.cli.demo", "play an agent that comes with the package"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The name of the command and what it is given; those of the process when `None`.

    Returns:
        Exit status: 0 where all went well, 1 after an error, 2 for a command that does not exist,
        130 after Ctrl-C.
    """
    if "" not in sys.path:
        sys.path.insert(0, "")  # so that a module of the user's is found here, as `python -m` does
    name, *given = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]
    if name in ("-h", "--help", "--version"):
        print(__version__ if name == "--version" else usage())
        return 0
    if name not in COMMANDS:
        nearest = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"; did you mean {nearest[0]}?" if nearest else "."
        print(
            f"error: `command` must be one of {', '.join(COMMANDS)}, got {name!r}{hint}",
            file=sys.stderr,
        )
        return 2
    return _run(COMMANDS[name].module, given)


def usage() -> str:
    """The help of the program: its commands, a line each."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.about}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            f"usage: {PROGRAM} COMMAND ...",
            "",
            "Curiosity for continuous control. Commands:",
            *lines,
            "",
            f"{PROGRAM} COMMAND --help lists the options of a command.",
        ]
    )


def _run(module: str, arguments: Sequence[str]) -> int:
    """Run the command of a module; a mistake of its user is an answer, not a traceback."""
    try:
        return int(import_module(module).main(arguments))
    except MISTAKES as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
