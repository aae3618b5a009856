"""Rival bonuses, each from its own paper, and a control, all behind the one interface."""

from deep_curiosity.bonuses.baselines.constant import ConstantBonus
from deep_curiosity.bonuses.baselines.disagreement import DisagreementBonus, InformationGainBonus
from deep_curiosity.bonuses.baselines.rnd import RNDBonus
from deep_curiosity.bonuses.baselines.hash_count import HashCountBonus
from deep_curiosity.bonuses.baselines.knn import NearestNeighboursBonus
from deep_curiosity.bonuses.baselines.icm import ICMBonus

__all__ = [
    "ConstantBonus",
    "DisagreementBonus",
    "RNDBonus",
    "HashCountBonus",
    "InformationGainBonus",
    "NearestNeighboursBonus",
    "ICMBonus",
]
