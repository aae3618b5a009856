"""Bonuses: curiosity, and the baselines that it is compared with, behind one contract."""

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.bonuses.registry import BONUSES, make_bonus

__all__ = ["BONUSES", "Bonus", "BonusLearner", "CuriosityBonus", "make_bonus"]
