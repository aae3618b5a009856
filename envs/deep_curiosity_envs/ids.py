"""Tasks by the names that users give them, found by the ids under which Gymnasium knows them."""

import difflib
import importlib
import warnings

import gymnasium

from deep_curiosity.requirements import require

ROBOTICS_PREFIXES = (
    "PointMaze_",
    "AntMaze_",
    "Adroit",
    "Fetch",
    "HandReach",
    "HandManipulate",
    "FrankaKitchen",
)
"""Names of the tasks of gymnasium-robotics begin so."""


def registered_id(env_id: str) -> str:
    """Id by which gymnasium knows a task of this package or another.

    Raises:
        ValueError: If it is no text, it knows none of this name, or the module of
            `module:Task-v0` is missing.
        ImportError: If a task is wanted without its extra.
    """
    if not isinstance(env_id, str):
        raise ValueError(f"`env_id` must be text, the name of a task, got {env_id!r}.")
    module, _, name = env_id.rpartition(":")
    if module:
        _import_tasks(module, env_id)
    elif name.startswith("dm_control/"):
        require("shimmy", extra="dmc")
        with warnings.catch_warnings():  # packages that it imports have filters of their own
            warnings.filterwarnings("ignore", module="glfw")  # of a display that nobody wants
            importlib.import_module("shimmy")  # which registers them
    known = list(gymnasium.registry)
    for candidate in (name, f"deep_curiosity/{name}", f"deep_curiosity/{name}-v0"):
        if candidate in known:
            return candidate
    if not module and name.startswith(ROBOTICS_PREFIXES):
        require("gymnasium_robotics", extra="robotics")
        return registered_id(f"gymnasium_robotics:{name}")
    nearest = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or known[-3:]
    choices = ", ".join(f"{module}:{each}" if module else each for each in nearest)
    ours = ", ".join(each for each in known if each.startswith("deep_curiosity/"))
    own = "" if module else f" Tasks of this package: {ours}."
    raise ValueError(f"`env_id` must be a registered id such as {choices}; got {env_id!r}.{own}")


def _import_tasks(module: str, env_id: str) -> None:
    """Import a module, which registers its tasks."""
    if not all(part.isidentifier() for part in module.split(".")):
        raise ValueError(
            "`env_id` must name a module as an import does, such as package.module:Task-v0, "
            f"got {env_id!r}."
        )
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"`env_id` must name a module that can be imported (is its folder in PYTHONPATH?), "
            f"got {env_id!r}: {error}."
        ) from error
