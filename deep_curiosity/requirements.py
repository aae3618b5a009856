"""What optional parts ask of other packages: that they are there, in a version that was tested."""

import re
import warnings
from importlib.metadata import version
from importlib.util import find_spec


def require(*packages: str, extra: str) -> None:
    """Say how to install packages where one is missing; nothing is imported.

    Args:
        *packages: Their import names.
        extra: The extra of `deep-curiosity` that brings them.

    Raises:
        ImportError: With the command that installs them, if one is missing.
    """
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        are = "is" if len(missing) == 1 else "are"
        raise ImportError(
            f"{', '.join(missing)} {are} missing: pip install 'deep-curiosity[{extra}]'",
            name=missing[0],
        )


def require_training() -> None:
    """Say how to install what training needs, where something of it is missing.

    Raises:
        ImportError: With the command that installs it.
    """
    require("gymnasium", "mujoco", "matplotlib", "tensorboard", "tqdm", "tyro", extra="train")


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
