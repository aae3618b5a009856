"""Rival bonuses, each from its own paper, and a control, all behind the one interface."""

from deep_curiosity.bonuses.baselines.constant import ConstantBonus
from deep_curiosity.bonuses.baselines.disagreement import DisagreementBonus, InformationGainBonus
from deep_curiosity.bonuses.baselines.rnd import DistillationBonus
from deep_curiosity.bonuses.baselines.hash_count import HashCountBonus
from deep_curiosity.bonuses.baselines.knn import NearestNeighboursBonus
from deep_curiosity.bonuses.baselines.icm import PredictionErrorBonus

__all__ = [
    "ConstantBonus",
    "DisagreementBonus",
    "DistillationBonus",
    "HashCountBonus",
    "InformationGainBonus",
    "NearestNeighboursBonus",
    "PredictionErrorBonus",
]
