"""What an adapter asks of its library: that it is there, in a version that was tested."""

import re
import warnings
from importlib import import_module
from importlib.metadata import version


def require(package: str, extra: str) -> None:
    """Import a package, or say how to install it.

    Args:
        package: Its import name.
        extra: The extra of `deep-curiosity` that brings it.

    Raises:
        ImportError: With the command that installs it, if it is missing.
    """
    try:
        import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:  # it is there, and misses something itself
            raise
        raise ImportError(
            f"this adapter needs {package}: pip install 'deep-curiosity[{extra}]'"
        ) from error


def warn_if_untested(package: str, lowest: str, below: str) -> None:
    """Warn where the installed version is not among those tested, `lowest <= version < below`.

    Args:
        package: Its import name.
        lowest: First version that was tested.
        below: First version above those that were.
    """
    installed = version(package.replace("_", "-"))
    if not _release(lowest) <= _release(installed) < _release(below):
        warnings.warn(
            f"{package} {installed} is untested here: tested are {lowest} <= version < {below}.",
            stacklevel=3,
        )


def _release(text: str) -> tuple[int, ...]:
    """Numbers of a version: `2.9.0a1` is `(2, 9, 0)`."""
    match = re.match(r"\d+(\.\d+)*", text)
    assert match is not None, f"no version: {text}"
    return tuple(int(number) for number in match.group().split("."))
