"""Running an agent: the loop, its environments, its records and its checkpoints.

Names are imported when they are first used, since settings and records are read without what
training needs; each module that needs it asks for it by itself.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deep_curiosity.training.config import Config
    from deep_curiosity.training.loop import continue_run, train

__all__ = ["Config", "continue_run", "train"]

_MODULES = {"Config": "config", "continue_run": "loop", "train": "loop"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
