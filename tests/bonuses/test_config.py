"""One set of defaults: what a config says is what the class does by itself."""

import inspect
from dataclasses import MISSING, fields

import pytest

from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.bonuses.config import (
    BONUS_CONFIGS,
    BaselineConfig,
    CuriosityConfig,
    DynamicsConfig,
    MarginalConfig,
    bonus_config,
)
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble
from deep_curiosity.bonuses.marginal import NextStateMarginal
from deep_curiosity.configuration import override
from deep_curiosity.replay import ReplayBuffer

BASELINES = [kind for kind in BONUS_CONFIGS.values() if issubclass(kind, BaselineConfig)]
OF_THE_LEARNER = {"model_learning_rate"}  # no argument of a bonus, which has no optimiser
PAIRS = {
    "dynamics": (
        DynamicsConfig,
        DynamicsEnsemble,
        {field.name for field in fields(DynamicsConfig)},
    ),
    "marginal": (MarginalConfig, NextStateMarginal, {"components", "bandwidth"}),
    "curiosity": (CuriosityConfig, CuriosityBonus, {"weight", "refresh_interval"}),
} | {
    kind.kind: (kind, kind.bonus_class, {field.name for field in fields(kind)} - OF_THE_LEARNER)
    for kind in BASELINES
}


@pytest.mark.parametrize("name", PAIRS)
def test_the_default_of_a_setting_is_the_default_of_the_class(name):
    config, kind, names = PAIRS[name]
    parameters = inspect.signature(kind.__init__).parameters
    defaults = {field.name: field.default for field in fields(config) if field.name in names}
    assert defaults.keys() == names
    assert MISSING not in defaults.values()
    assert defaults == {each: parameters[each].default for each in names}


def test_every_baseline_is_among_the_pairs():
    assert len(BASELINES) == 6
    assert set(BONUS_CONFIGS) == {*PAIRS, "constant", "none"} - {"dynamics", "marginal"}


@pytest.mark.parametrize("name", BONUS_CONFIGS)
def test_a_config_knows_whether_its_bonus_scores_outcomes(name):
    config = bonus_config(name)
    bonus = config.make(3, 2, (8,))
    assert config.scores_outcomes is (bonus is not None and bonus.scores_outcomes)


@pytest.mark.parametrize("name", BONUS_CONFIGS)
def test_an_optimiser_is_made_where_something_learns(name):
    config = bonus_config(name)
    bonus = config.make(3, 2, (8,))
    optimizer = config.make_optimizer(bonus)
    learns = bonus is not None and any(each.requires_grad for each in bonus.parameters())
    assert (optimizer is not None) is learns
    if learns:
        assert optimizer.learning_rate == config.model_learning_rate


def test_the_constant_is_its_weight():
    bonus = bonus_config("constant").make(3, 2, (8,))
    assert isinstance(bonus, ConstantBonus) and bonus.value.item() == pytest.approx(0.1)


def test_curiosity_is_about_given_entries_unless_others_were_chosen():
    assert CuriosityConfig().about((0, 1)).features == (0, 1)
    assert CuriosityConfig(features=(2,)).about((0, 1)).features == (2,)
    assert bonus_config("rnd").about((0, 1)) == bonus_config("rnd")


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_half_life_that_is_not_positive_is_rejected(value):
    with pytest.raises(ValueError, match="`marginal_half_life` must be positive"):
        MarginalConfig(half_life=value)


def test_visited_states_fade_by_half_with_so_many_episodes():
    replay = ReplayBuffer(1_000, 1, 1)
    for number in range(1_000):  # episodes of 10
        replay.add(float(number), 0.0, 0.0, float(number), False, number % 10 == 9)
    config = override(CuriosityConfig(), marginal_half_life=5.0)
    age = 999 - config.sample_visited(replay, 20_000).observation
    assert (age < 50).float().mean().item() == pytest.approx(0.5, abs=0.02)
    assert override(config, marginal_half_life=None).sample_visited(replay, 9) is None


def test_visits_are_counted_and_not_draws_from_replay():
    replay = ReplayBuffer(30, 1, 1)
    for number in range(50):
        replay.add(float(number), 0.0, 0.0, float(number), False, False)

    def counted():
        return [*bonus_config("hash-count").sample_visited(replay, 256).observation.flatten()]

    assert counted() == [*range(20, 50)]  # what is held
    assert counted() == []
    for number in range(50, 57):
        replay.add(float(number), 0.0, 0.0, float(number), False, False)
    again = ReplayBuffer(30, 1, 1)
    again.load_state_dict(replay.state_dict())
    assert counted() == [*range(50, 57)]
    replay = again
    assert counted() == [*range(50, 57)]


def test_an_unknown_kind_is_rejected():
    with pytest.raises(ValueError, match=r"`bonus` must be one of curiosity, .*, got 'luck'"):
        bonus_config("luck")


@pytest.mark.parametrize("kind", ["nearest-neighbours", "hash-count"])
def test_a_learning_rate_of_networks_that_there_are_not_is_refused(kind):
    with pytest.raises(ValueError, match=f"`model_learning_rate` must be left out with {kind}"):
        override(bonus_config(kind), model_learning_rate=0.9)


def test_so_few_components_have_no_such_perplexity():
    with pytest.raises(ValueError, match="`components` must be above 8 where `bandwidth` is perp"):
        MarginalConfig(bandwidth="perplexity", components=8)
    MarginalConfig(bandwidth="perplexity", components=9)
