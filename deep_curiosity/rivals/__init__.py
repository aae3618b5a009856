"""Rival bonuses, each from its own paper, and a control, all behind the one interface."""

from deep_curiosity.rivals.constant import ConstantBonus
from deep_curiosity.rivals.disagreement import DisagreementBonus, InformationGainBonus
from deep_curiosity.rivals.distillation import DistillationBonus
from deep_curiosity.rivals.hash_count import HashCountBonus
from deep_curiosity.rivals.nearest_neighbours import NearestNeighboursBonus
from deep_curiosity.rivals.prediction_error import PredictionErrorBonus

__all__ = [
    "ConstantBonus",
    "DisagreementBonus",
    "DistillationBonus",
    "HashCountBonus",
    "InformationGainBonus",
    "NearestNeighboursBonus",
    "PredictionErrorBonus",
]
