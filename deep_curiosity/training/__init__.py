"""Running an agent: the loop, its environments, its records and its checkpoints.

Names are imported when they are first used, since settings and records are read without what
training needs; each module that needs it asks for it by itself.
"""

from typing import TYPE_CHECKING

from deep_curiosity.lazy import names_of

if TYPE_CHECKING:
    from deep_curiosity.training.config import Config
    from deep_curiosity.training.loop import continue_run, train

__all__ = ["Config", "continue_run", "train"]

_MODULES = {"Config": "config", "continue_run": "loop", "train": "loop"}

__getattr__ = names_of(__name__, _MODULES)
