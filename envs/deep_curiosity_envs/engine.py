"""MuJoCo, without a renderer where the one that `MUJOCO_GL` names is missing."""

import os
import warnings
from importlib import import_module

SETTING = "MUJOCO_GL"


def load_engine() -> None:
    """Import MuJoCo; to draw nothing is no reason to train nothing.

    MuJoCo fails as a whole where `MUJOCO_GL` names a library that PyOpenGL looks for in vain. It
    is then told, with a warning, to do without one; who asks for a picture is told so again.

    Raises:
        ImportError: If MuJoCo itself is missing.
    """
    try:
        import_module("mujoco")
    except AttributeError as error:  # of the library that PyOpenGL has not found
        asked = os.environ.get(SETTING)
        os.environ[SETTING] = "disable"
        import_module("mujoco")
        warnings.warn(
            f"`{SETTING}` must name an OpenGL library that is installed, got {asked!r} "
            f"({error}): nothing can be drawn.",
            stacklevel=2,
        )
