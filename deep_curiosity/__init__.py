"""Predictive-information curiosity for continuous control, after Still & Precup (2012).

Every name is imported when it is first used: the bonus and what was learned need torch, and what
trains needs besides what `pip install 'deep-curiosity[train]'` brings.
"""

from typing import TYPE_CHECKING

from deep_curiosity.lazy import names_of

if TYPE_CHECKING:
    from deep_curiosity.agent.sac import CuriousSAC
    from deep_curiosity.bonuses import Bonus, CuriosityBonus, make_bonus
    from deep_curiosity.replay import ReplayBuffer
    from deep_curiosity.trained.export import export
    from deep_curiosity.trained.model import load_bonus, load_model
    from deep_curiosity.trained.policy import load
    from deep_curiosity.trained.run import continue_run, train
    from deep_curiosity.training import Config
    from deep_curiosity.transitions import Transition

__version__ = "0.2.0"

__all__ = [
    "Bonus",
    "Config",
    "CuriosityBonus",
    "CuriousSAC",
    "ReplayBuffer",
    "Transition",
    "continue_run",
    "export",
    "load",
    "load_bonus",
    "load_model",
    "make_bonus",
    "train",
]

_MODULES = {
    "Bonus": "bonuses",
    "Config": "training",
    "CuriosityBonus": "bonuses",
    "CuriousSAC": "agent.sac",
    "ReplayBuffer": "replay",
    "Transition": "transitions",
    "continue_run": "trained.run",
    "export": "trained.export",
    "load": "trained.policy",
    "load_bonus": "trained.model",
    "load_model": "trained.model",
    "make_bonus": "bonuses",
    "train": "trained.run",
}
"""Module within the package that has each name."""

__getattr__ = names_of(__name__, _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
