"""The studies of this project, each a value, run by `deep-curiosity study`; or a user's own."""

import sys
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from deep_curiosity.configuration import from_home
from deep_curiosity.experiments.engines.base import send_along
from deep_curiosity.experiments.search import Search
from deep_curiosity.experiments.study import Study, can_be_folder
from deep_curiosity.requirements import require

FOLDERS = {
    "development": Path("docs/development"),
    "comparisons": Path("docs/study"),
    "sweeps": Path("docs/sweeps"),
    "illustrations": Path("docs/study"),
    "results": Path("docs/results"),
}
"""Module of each group of studies, to the folder of its tables."""
LIBRARIES = ("stable_baselines3", "torchrl")
"""Studies of agents of other libraries, each in a module of its name."""


def find_study(name: str) -> tuple[str, Study, Path]:
    """A study by its name, or the one in a file of the user's own.

    Args:
        name: Such as `sparse`, `rate`; or `FILE.py`, whose `STUDIES` has one; or `FILE.py:NAME`.

    Returns:
        Its name, the study, and the folder of its tables.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the library whose agents are studied is missing.
        ValueError: If there is no such study, or a file that holds none.
    """
    file, wanted = _split(name)
    if file.endswith(".py"):
        return _find_own(from_home(Path(file)), wanted)
    if name in LIBRARIES:
        return name, import_module(f"{__name__}.{name}").STUDIES[name], Path("docs/study")
    known: list[str] = []
    for module, folder in FOLDERS.items():
        studies = import_module(f"{__name__}.{module}").STUDIES
        if name in studies:
            return name, studies[name], folder
        known += studies
    choices = [*known, *LIBRARIES]
    near = get_close_matches(name, choices, n=1)
    nearest = f"; the nearest is {near[0]}" if near else ""
    raise ValueError(
        f"`study` must be a file or one of {', '.join(choices)}, got {name!r}{nearest}."
    )


def _split(name: str) -> tuple[str, str]:
    """File and entry of `FILE.py:NAME`, whatever colons the path has; no entry without one."""
    before, mark, wanted = name.rpartition(".py:")
    return (f"{before}.py", wanted) if mark else (name, "")


def _find_own(path: Path, wanted: str) -> tuple[str, Study, Path]:
    name, study = load_own(path, "STUDIES", wanted)
    return name, study, Path("results")


def load_own(path: Path, table: str, wanted: str) -> tuple[str, Any]:
    """An entry of a table in a file of the user's own, whose code then travels to all workers.

    Args:
        path: Of the file.
        table: Name of the dictionary there, STUDIES or SEARCHES.
        wanted: Key of the entry; the only one when empty.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, or has no such entry.
    """
    before = sys.path.copy()
    try:
        return _load_entry(path, table, wanted)
    except BaseException:
        sys.path[:] = before  # a file beside it may hide a module that a new process needs
        raise


def _load_entry(path: Path, table: str, wanted: str) -> tuple[str, Any]:
    name_of, kind = {"STUDIES": ("study", Study), "SEARCHES": ("search", Search)}[table]
    module = _load_module(path, name_of)
    entries = getattr(module, table, None)
    if not (
        isinstance(entries, dict)
        and entries
        and all(isinstance(entry, kind) for entry in entries.values())
    ):
        raise ValueError(
            f"`{name_of}` must hold {table}, each a {kind.__name__} by its name, got {path}."
        )
    if wrong := [name for name in entries if not can_be_folder(name)]:
        raise ValueError(
            f"`{name_of}` must hold {table} by names that folders can have, got {wrong[0]!r} in "
            f"{path}."
        )
    name = wanted or (next(iter(entries)) if len(entries) == 1 else "")
    if name not in entries:
        raise ValueError(
            f"`{name_of}` must be one of {', '.join(entries)} in {path}, got {name!r}."
        )
    return name, entries[name]


def _load_module(path: Path, name: str) -> ModuleType:
    """Import a file of the user's own."""
    if not path.is_file():
        raise FileNotFoundError(f"`{name}` must name a file that exists, got {path}.")
    if "." in path.stem:
        raise ValueError(f"`{name}` must be a file whose name has no point but .py, got {path}.")
    sys.path.insert(0, str(path.resolve().parent))  # for what it imports itself
    try:
        module = import_module(path.stem)
    except SyntaxError as error:
        raise ValueError(f"`{name}` must be a file of Python, got {path}: {error}.") from error
    if Path(module.__file__ or "").resolve() != path.resolve():
        raise ValueError(
            f"`{name}` must be a file whose name no other module has, got {path}, which is "
            f"hidden by {module.__file__}."
        )
    send_along(module)
    return module


def find_search(name: str) -> tuple[str, Search]:
    """A search for settings by its name, or the one in a file of the user's own.

    Args:
        name: Such as `agent`; or `FILE.py`, whose `SEARCHES` has one; or `FILE.py:NAME`.

    Returns:
        Its name, and the search.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If Optuna is missing, with the command that installs it.
        ValueError: If there is no such search.
    """
    require("optuna", extra="tune")
    file, wanted = _split(name)
    if file.endswith(".py"):
        return load_own(from_home(Path(file)), "SEARCHES", wanted)
    searches = import_module(f"{__name__}.searches").SEARCHES
    if name not in searches:
        choices = ", ".join(searches)
        raise ValueError(f"`search` must be a file or one of {choices}, got {name!r}.")
    return name, searches[name]
