import pytest
import torch

from deep_curiosity.bonuses import BonusLearner
from deep_curiosity.bonuses.config import bonus_config
from deep_curiosity.bonuses.registry import BONUSES, OF_THE_LOOP, make_bonus
from deep_curiosity.configuration import flat
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


@pytest.mark.parametrize(
    ("name", "setting", "instead"),
    [
        ("curiosity", "model_learning_rate", "give `learning_rate` to the BonusLearner"),
        ("rnd", "model_learning_rate", "give `learning_rate` to the BonusLearner"),
        ("curiosity", "marginal_half_life", "show `observe` what was visited of late"),
    ],
)
def test_settings_that_only_the_trainer_reads_are_refused(name, setting, instead):
    message = f"`{setting}` must be left out, got 0.001: only the trainer reads it; {instead}"
    with pytest.raises(TypeError, match=message):
        make_bonus(name, 3, 2, **{setting: 1e-3})
    with pytest.raises(TypeError) as caught:
        make_bonus(name, 3, 2, luck=1)
    assert setting not in str(caught.value)


def test_the_settings_that_only_the_trainer_reads_are_there():
    assert {name for kind in BONUSES for name in flat(bonus_config(kind))} >= set(OF_THE_LOOP)


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


def test_what_only_the_trainer_reads_of_features_is_refused():
    with pytest.raises(TypeError, match="`features_of` must be left out, got 'window'"):
        make_bonus("curiosity", 3, 1, features_of="window")
