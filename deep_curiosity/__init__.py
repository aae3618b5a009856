"""Predictive-information curiosity for continuous control, after Still & Precup (2012).

`Config` and `train` need the extra `scripts`, and are imported where they are used.
"""

from typing import Any

from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.bonuses import Bonus, CuriosityBonus, make_bonus
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.transitions import Transition

__version__ = "0.1.0"

__all__ = [
    "Bonus",
    "Config",
    "CuriosityBonus",
    "CuriousSAC",
    "ReplayBuffer",
    "Transition",
    "continue_run",
    "make_bonus",
    "train",
]


def __getattr__(name: str) -> Any:
    """Import what trains on request: it needs gymnasium and MuJoCo, the bonus does not."""
    if name in ("Config", "continue_run", "train"):
        from deep_curiosity import training

        return getattr(training, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
