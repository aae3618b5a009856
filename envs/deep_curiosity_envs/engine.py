"""MuJoCo, without a renderer where the one that `MUJOCO_GL` names is missing."""

import os
import warnings
from importlib import import_module

SETTING = "MUJOCO_GL"


def load_engine() -> None:
    """Import MuJoCo, also where its renderer is missing: training needs no picture.

    MuJoCo cannot be imported where `MUJOCO_GL` names a library that PyOpenGL does not find. The
    renderer is then disabled, with a warning; rendering raises an error of its own.

    Raises:
        ImportError: If MuJoCo itself is missing.
    """
    try:
        import_module("mujoco")
    except AttributeError as error:  # raised by PyOpenGL for a missing library
        requested = os.environ.get(SETTING)
        os.environ[SETTING] = "disable"
        import_module("mujoco")
        warnings.warn(
            f"`{SETTING}` must name an OpenGL library that is installed, got {requested!r} "
            f"({error}): nothing can be drawn.",
            stacklevel=2,
        )
