"""The command line, `deep-curiosity COMMAND`: every command is a module, loaded when asked for."""

import difflib
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import NamedTuple

from deep_curiosity import __version__

PROGRAM = "deep-curiosity"
MISTAKE = 2  # exit status where the user can mend what is wrong, as of the parser itself
INTERRUPTED = 130  # as of a shell's command that Ctrl-C has ended
NAMED = re.compile(r"`[^`\n]+`")  # how messages name the argument that they are about


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
    "tune": Command("deep_curiosity.cli.tune", "choose settings by trials of tasks x seeds"),
    "export": Command("deep_curiosity.cli.export", "write a policy as ONNX, .pt2 or safetensors"),
    "check": Command("deep_curiosity.cli.check", "whether the bonus works on your environment"),
    "demo": Command("deep_curiosity.cli.demo", "play an agent that comes with the package"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The name of the command and what it is given; those of the process when `None`.

    Returns:
        Exit status: 0 where all went well, 1 where something that was tried failed, and of `train`
        130 or 143 where Ctrl-C or SIGTERM stopped the run, which is saved.

    Raises:
        SystemExit: With status 2 after a mistake of the user, which is answered in one line, and
            130 after Ctrl-C; also where SIGTERM stopped a study or a search, which goes on later.
    """
    if "" not in sys.path:
        sys.path.insert(0, "")  # so that a module of the user's is found here, as `python -m` does
    name, *given = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]
    if name in ("-h", "--help", "--version"):
        print(__version__ if name == "--version" else usage())
        return 0
    with answering():
        return int(import_module(_find(name).module).main(given))


def _find(name: str) -> Command:
    if name not in COMMANDS:
        nearest = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"; did you mean {nearest[0]}?" if nearest else "."
        raise ValueError(f"`command` must be one of {', '.join(COMMANDS)}, got {name!r}{hint}")
    return COMMANDS[name]


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


@contextmanager
def answering() -> Iterator[None]:
    """End the process with one line about a mistake of the user; a bug keeps its traceback.

    Raises:
        SystemExit: With status 2 where the error says what to change, 130 on Ctrl-C, or on what
            a command treats like it.
    """
    try:
        yield
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception as error:
        if not is_answer(error):
            raise
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(MISTAKE)


def is_answer(error: Exception) -> bool:
    """Whether an error says what to change: it is about the machine, or names an argument."""
    if isinstance(error, ImportError | OSError) or type(error).__module__ == "gymnasium.error":
        return True
    kinds = ArithmeticError | RuntimeError | TypeError | ValueError
    return isinstance(error, kinds) and NAMED.search(str(error)) is not None
