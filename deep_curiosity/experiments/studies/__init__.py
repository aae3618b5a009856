"""The studies of this project, each a value, run by `deep-curiosity study`; or a user's own."""

import sys
from importlib import import_module
from pathlib import Path

from deep_curiosity.experiments.study import Study

FOLDERS = {
    "development": Path("docs/development"),
    "comparisons": Path("docs/study"),
    "sweeps": Path("docs/sweeps"),
    "illustrations": Path("docs/study"),
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
        ValueError: If there is no such study.
    """
    file, _, wanted = name.partition(":")
    if file.endswith(".py"):
        return _find_own(Path(file), wanted)
    if name in LIBRARIES:
        return name, import_module(f"{__name__}.{name}").STUDIES[name], Path("docs/study")
    known: list[str] = []
    for module, folder in FOLDERS.items():
        studies = import_module(f"{__name__}.{module}").STUDIES
        if name in studies:
            return name, studies[name], folder
        known += studies
    choices = ", ".join((*known, *LIBRARIES))
    raise ValueError(f"`study` must be a file or one of {choices}, got {name!r}.")


def _find_own(path: Path, wanted: str) -> tuple[str, Study, Path]:
    if not path.exists():
        raise FileNotFoundError(f"`study` must name a file that exists, got {path}.")
    sys.path.insert(0, str(path.resolve().parent))  # where workers find it too
    studies = import_module(path.stem).STUDIES
    name = wanted or (next(iter(studies)) if len(studies) == 1 else "")
    if name not in studies:
        raise ValueError(f"`study` must be one of {', '.join(studies)} in {path}, got {name!r}.")
    return name, studies[name], Path("results")
