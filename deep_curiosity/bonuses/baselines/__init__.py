"""Baselines, each from its own paper, and a control, all behind the one contract."""

from deep_curiosity.bonuses.baselines.constant import ConstantBonus
from deep_curiosity.bonuses.baselines.disagreement import DisagreementBonus
from deep_curiosity.bonuses.baselines.hash_count import HashCountBonus
from deep_curiosity.bonuses.baselines.icm import ICMBonus
from deep_curiosity.bonuses.baselines.knn import NearestNeighboursBonus
from deep_curiosity.bonuses.baselines.max_info import InformationGainBonus
from deep_curiosity.bonuses.baselines.rnd import RNDBonus

__all__ = [
    "ConstantBonus",
    "DisagreementBonus",
    "HashCountBonus",
    "ICMBonus",
    "InformationGainBonus",
    "NearestNeighboursBonus",
    "RNDBonus",
]
