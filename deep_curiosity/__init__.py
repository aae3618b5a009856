"""Predictive-information curiosity for continuous control, after Still & Precup (2012)."""

from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.transitions import Transition

__version__ = "0.1.0"
