import pytest
import torch

from deep_curiosity.bonuses import BonusLearner
from deep_curiosity.bonuses.registry import BONUSES, make_bonus
from deep_curiosity.transitions import Transition


def transition(batch=32):
    flag = torch.zeros(batch, dtype=torch.bool)
    observation = torch.randn(batch, 3)
    action = torch.rand(batch, 2) * 2 - 1
    return Transition(observation, action, torch.randn(batch), observation + 0.1, flag, flag)


@pytest.mark.parametrize("name", BONUSES)
def test_every_bonus_learns_with_its_defaults(name):
    learner = BonusLearner(make_bonus(name, 3, 2))
    for _ in range(2):
        learner.learn(transition())
    assert learner.compute(transition()).isfinite().all()


def test_an_error_about_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"`bonus` must be one of curiosity, .*, got 'luck'"):
        make_bonus("luck", 3, 2)


@pytest.mark.parametrize("name", BONUSES)
def test_an_error_about_an_unknown_setting_lists_the_known_ones(name):
    with pytest.raises(TypeError, match=r"`luck` is no setting here; there are .*bonus_weight"):
        make_bonus(name, 3, 2, luck=1)


def test_settings_are_given_by_their_flat_names():
    bonus = make_bonus("curiosity", 3, 2, bonus_weight=0.3, num_members=2, components=8)
    assert bonus.standardization.weight == 0.3
    assert bonus.dynamics.num_members == 2
    assert len(bonus.marginal.loc) == 8


def test_features_of_curiosity_may_be_entries_or_a_function():
    entries = make_bonus("curiosity", 3, 2, features=(0, -1))
    function = make_bonus("curiosity", 3, 2, features=lambda observation: observation[:, :2])
    assert entries.entries == [0, 2] and entries.dynamics.predicted_dim == 3
    assert function.entries is None and function.dynamics.predicted_dim == 2


def test_features_of_other_bonuses_are_no_setting():
    with pytest.raises(
        TypeError, match=r"`features` is no setting here, .*; there are bonus_weight"
    ):
        make_bonus("rnd", 3, 2, features=lambda observation: observation[:, :2])
