"""How command lines are read: options into a dataclass, each with what is said of a wrong word."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("tyro", extra="train")

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

Args = TypeVar("Args")
OF_KEYS = ("--env-kwargs", "--bonus-parts")
"""Options that take keys and values in turn."""


def read_arguments(
    what: Callable[..., Args],
    arguments: Sequence[str] | None = None,
    *,
    description: str | None = None,
    prog: str | None = None,
) -> Args:
    """Read a command line into a dataclass; what cannot be read ends the process.

    Args:
        what: A dataclass, whose comments are the help of its fields.
        arguments: Those of the process when `None`.
        description: Of the command, for its help.
        prog: How the command is called, for its help.

    Raises:
        SystemExit: With status 2, once it is printed what is wrong with which option.
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of range, or an option is given twice.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    _refuse_repeated(given)
    _refuse_repeated_keys(given)
    return tyro.cli(what, args=given, description=description, prog=prog, registry=REGISTRY)


def check_folder(name: str, path: Path) -> None:
    """Reject the path of what cannot become a folder.

    Raises:
        ValueError: Naming the option and the path.
    """
    for each in (path, *path.parents):
        try:
            is_file = each.exists() and not each.is_dir()
        except (OSError, ValueError) as error:  # too long, or with a NUL
            raise ValueError(f"`{name}` must be a folder, got {str(path)!r}: {error}.") from error
        if is_file:
            raise ValueError(f"`{name}` must be a folder, got {path}, where {each} is a file.")


def check_file(name: str, path: Path) -> None:
    """Reject the path of what cannot become a file.

    Raises:
        ValueError: Naming the option and the path.
    """
    check_folder(name, path.parent)
    try:
        is_folder = path.is_dir()
    except (OSError, ValueError) as error:  # too long, or with a NUL
        raise ValueError(f"`{name}` must be a file, got {str(path)!r}: {error}.") from error
    if is_folder:
        raise ValueError(f"`{name}` must be a file, got {path}, which is a folder.")


def _refuse_repeated(arguments: Sequence[str]) -> None:
    """Refuse an option that is given twice, of which the parser would take the last."""
    flags = [each.partition("=")[0].replace("_", "-") for each in arguments if each[:2] == "--"]
    counts = Counter(flag.removeprefix("--").removeprefix("no-") for flag in flags)
    for flag, count in counts.items():
        if count > 1:
            name = flag.replace("-", "_")
            raise ValueError(f"`{name}` must be given once, got --{flag} {count} times.")


def _refuse_repeated_keys(arguments: Sequence[str]) -> None:
    """Refuse a key that is given twice to an option of keys and values."""
    for start, flag in enumerate(arguments):
        if flag.replace("_", "-") in OF_KEYS:
            words = [*takewhile(lambda word: word[:2] != "--", arguments[start + 1 :])]
            twice = [key for key, count in Counter(words[::2]).items() if count > 1]
            if twice:
                name = flag.removeprefix("--").replace("-", "_")
                raise ValueError(f"`{name}` must have every key once, got {twice[0]!r} twice.")


def _read_word(kind: Callable[[str], Any], rule: str, words: list[str]) -> Any:
    """Read a number or a path.

    Raises:
        ValueError: Saying what the word should be.
    """
    (word,) = words
    try:
        if not word or "\0" in word:
            raise ValueError
        return kind(word)
    except ValueError:
        shown = word if len(word) < 60 else f"{word[:60]}..."
        raise ValueError(f"it must be {rule}, got {shown!r}") from None


def _is_of(kind: type, value: Any) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _as_word(value: Any) -> list[str]:
    return [str(value)]


SPECS: dict[Any, PrimitiveConstructorSpec[Any]] = {
    kind: PrimitiveConstructorSpec(
        nargs=1,
        metavar=kind.__name__.upper(),
        instance_from_str=partial(_read_word, kind, rule),
        is_instance=partial(_is_of, kind),
        str_from_instance=_as_word,
    )
    for kind, rule in ((int, "a whole number"), (float, "a number"), (Path, "a path"))
}
REGISTRY = ConstructorRegistry()
"""How words of a command line are read: as `tyro` does, but for what is said of a wrong one."""


@REGISTRY.primitive_rule
def _spec_of(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    return SPECS.get(info.type) if info.type in (int, float, Path) else None
