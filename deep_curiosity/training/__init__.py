"""Running an agent: the loop, its environments, its records and its checkpoints."""

from deep_curiosity.training.loop import train
from deep_curiosity.training.config import Settings

__all__ = ["Settings", "train"]
