"""Running an agent: the loop, its environments, its records and its checkpoints."""

from deep_curiosity.training.config import Config
from deep_curiosity.training.loop import continue_run, train

__all__ = ["Config", "continue_run", "train"]
