"""The studies of this project, each a value, run by `deep-curiosity study`; or a user's own."""

import sys
from difflib import get_close_matches
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
        ValueError: If there is no such study, or a file that holds none.
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
    choices = [*known, *LIBRARIES]
    near = get_close_matches(name, choices, n=1)
    nearest = f"; the nearest is {near[0]}" if near else ""
    raise ValueError(
        f"`study` must be a file or one of {', '.join(choices)}, got {name!r}{nearest}."
    )


def _find_own(path: Path, wanted: str) -> tuple[str, Study, Path]:
    studies = _read_own(path)
    name = wanted or (next(iter(studies)) if len(studies) == 1 else "")
    if name not in studies:
        raise ValueError(f"`study` must be one of {', '.join(studies)} in {path}, got {name!r}.")
    return name, studies[name], Path("results")


def _read_own(path: Path) -> dict[str, Study]:
    """`STUDIES` of a file."""
    if not path.is_file():
        raise FileNotFoundError(f"`study` must name a file that exists, got {path}.")
    sys.path.insert(0, str(path.resolve().parent))  # where workers find it too
    try:
        module = import_module(path.stem)
    except SyntaxError as error:
        raise ValueError(f"`study` must be a file of Python, got {path}: {error}.") from error
    if Path(module.__file__ or "").resolve() != path.resolve():
        raise ValueError(
            f"`study` must be a file whose name no other module has, got {path}, which is "
            f"hidden by {module.__file__}."
        )
    studies = getattr(module, "STUDIES", None)
    if not isinstance(studies, dict) or not all(
        isinstance(study, Study) for study in studies.values()
    ):
        raise ValueError(f"`study` must hold STUDIES, each a Study by its name, got {path}.")
    return studies
