import pytest
import torch

from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.bonuses.registry import BONUSES, make_bonus
from deep_curiosity.transitions import Transition


def transition(batch=32):
    flag = torch.zeros(batch, dtype=torch.bool)
    observation = torch.randn(batch, 3)
    action = torch.rand(batch, 2) * 2 - 1
    return Transition(observation, action, torch.randn(batch), observation + 0.1, flag, flag)


@pytest.mark.parametrize("name", BONUSES)
def test_every_bonus_learns_with_the_defaults_of_the_trainer(name):
    learner = BonusLearner(make_bonus(name, 3, 2))
    for _ in range(2):
        learner.learn(transition())
    assert learner.compute(transition()).isfinite().all()


def test_an_unknown_name_is_rejected_with_the_known_ones():
    with pytest.raises(ValueError, match=r"`bonus` must be one of curiosity, .*, got 'luck'"):
        make_bonus("luck", 3, 2)


@pytest.mark.parametrize("name", ["none", "constant"])
def test_what_is_no_bonus_to_compare_is_not_made_by_name(name):
    assert name in BONUS_CONFIGS
    with pytest.raises(ValueError, match=f"`bonus` must be one of .*, got '{name}'"):
        make_bonus(name, 3, 2)


@pytest.mark.parametrize("name", BONUSES)
def test_an_unknown_setting_is_rejected_with_the_known_ones(name):
    with pytest.raises(TypeError, match=r"`luck` is no setting here; there are .*bonus_weight"):
        make_bonus(name, 3, 2, luck=1.0)


def test_features_are_a_function_for_curiosity_alone():
    bonus = make_bonus("curiosity", 3, 2, features=lambda x: x[:, :1], hidden_dims=(8,))
    assert bonus.dynamics.predicted_dim == 1
    with pytest.raises(TypeError, match="`features` is no setting here; there are bonus_weight"):
        make_bonus("rnd", 3, 2, features=lambda x: x[:, :1])
