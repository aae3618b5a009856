"""Running an agent: the loop, its environments, its records and its checkpoints."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from deep_curiosity.training.config import Config
from deep_curiosity.training.loop import continue_run, train

__all__ = ["Config", "continue_run", "train"]
