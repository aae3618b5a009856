import math

import numpy as np
import pytest

from deep_curiosity.agent.config import AgentConfig, ConditionedHunger
from deep_curiosity.configuration import override
from deep_curiosity.schedules import Schedule


@pytest.mark.parametrize(
    ("text", "hunger"),
    [
        ("conditioned:0.5", ConditionedHunger("fixed", 0.5)),
        ("conditioned:0", ConditionedHunger("fixed", 0.0)),
        ("random", ConditionedHunger("random")),
        ("bandit", ConditionedHunger("bandit")),
        ("battery", ConditionedHunger("battery", entry=-1)),
        ("battery:2", ConditionedHunger("battery", entry=2)),
        ("battery:-3", ConditionedHunger("battery", entry=-3)),
        ("battery:charge", ConditionedHunger("battery", entry="charge")),
        ("battery:--3", ConditionedHunger("battery", entry="--3")),
    ],
)
def test_a_conditioned_hunger_is_read_from_text_and_written_so(text, hunger):
    assert ConditionedHunger.parse(text) == hunger
    assert ConditionedHunger.parse(str(hunger)) == hunger


@pytest.mark.parametrize(
    "text",
    ["", "greedy", "fixed", "random:1", "bandit:", "linear:1", "conditioned", "conditioned:much"],
)
def test_text_that_is_no_hunger_is_refused_with_the_forms(text):
    with pytest.raises(ValueError, match=f"`hunger` must be a number, a schedule.*got '{text}'"):
        ConditionedHunger.parse(text)


@pytest.mark.parametrize("text", ["greedy", "linear:1", "linear:-1:2", "randm"])
def test_an_agent_with_a_hunger_that_cannot_be_read_is_refused(text):
    with pytest.raises(ValueError, match=f"`hunger` cannot be read.*got '{text}'"):
        override(AgentConfig(), hunger=text)


@pytest.mark.parametrize("value", [-0.1, 1.5, math.nan])
def test_a_conditioned_hunger_outside_its_range_is_refused(value):
    rule = rf"`hunger` must lie in \[0, 1\] where conditioned, got {value}"
    with pytest.raises(ValueError, match=rule):
        ConditionedHunger(value=value)
    with pytest.raises(ValueError, match=rule):
        ConditionedHunger.parse(f"conditioned:{value}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"source": "random", "value": 0.3}, "`value` must be left out .* 'random', got 0.3"),
        ({"source": "bandit", "entry": 2}, "`entry` must be left out .* 'bandit', got 2"),
        ({"source": "battery", "entry": "3"}, "`entry` must be a name or a number, got '3'"),
        ({"source": "battery", "entry": ""}, "`entry` must be a name or a number, got ''"),
    ],
)
def test_what_a_conditioned_hunger_would_not_be_read_back_with_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ConditionedHunger(**arguments)


def test_a_conditioned_hunger_of_numpy_is_written_as_a_number():
    hunger = ConditionedHunger(value=np.float64(0.5))
    assert ConditionedHunger.parse(str(hunger)) == hunger


def test_an_unknown_source_of_hunger_is_refused():
    with pytest.raises((ValueError, TypeError), match="source"):
        ConditionedHunger("greed")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"discount": 1.0}, "`discount` must be below 1, got 1.0"),
        ({"discount": -0.1}, "`discount` must not be negative, got -0.1"),
        ({"curiosity_discount": 1.1}, "`curiosity_discount` must be below 1, got 1.1"),
        ({"hidden_dim": 0}, "`hidden_dim` must be at least 1, got 0"),
        ({"reward_steps": 0}, "`reward_steps` must be at least 1, got 0"),
        ({"curiosity_steps": 0}, "`curiosity_steps` must be at least 1, got 0"),
        ({"curiosity_ends": 0}, "`curiosity_ends` must be at least 1, got 0"),
        ({"policy_mixture_components": 0}, "`policy_mixture_components` must be at least 1"),
        ({"hunger": -1.0}, "`hunger` must not be negative, got -1.0"),
        ({"hunger": math.inf}, "`hunger` must be finite, got inf"),
        ({"temperature": 0.0}, "`temperature` must be positive, got 0.0"),
        ({"temperature": "constant:-1"}, "`temperature` cannot be read.*positive, got -1.0"),
        ({"target_information_rate": math.nan}, "`target_information_rate` must be finite"),
        ({"learning_rate": 0.0}, "`learning_rate` must be positive, got 0.0"),
        (
            {"target_information_rate": 1e300},
            "`target_information_rate` must be at most 1000000.0",
        ),
        ({"polyak": 1.5}, "`polyak` must be at most 1, got 1.5"),
        ({"curiosity_coefficient": -1.0}, "`curiosity_coefficient` must not be negative, got -1"),
        ({"curiosity_coefficient": "much"}, "`curiosity_coefficient` must be .*'adaptive', got"),
        ({"prior": "habit"}, "`prior` must be one of 'uniform', 'learned' or None, got"),
        ({"actor_q": "max"}, "`actor_q` must be one of 'alternate' or 'min', got 'max'"),
        ({"actor_batch_fraction": 1.5}, "`actor_batch_fraction` must be at most 1, got 1.5"),
        ({"actor_batch_fraction": 0.4}, "`actor_batch_fraction` must be one over a whole.*0.4"),
        (
            {"temperature": "constant:1", "target_information_rate": 2.0},
            "`target_information_rate` must be left out .*got 2.0 with `temperature` constant:1.0",
        ),
        (
            {"hunger": "random", "curiosity_coefficient": 1.0},
            "`curiosity_coefficient` must be 'adaptive' where .* conditioned .*, got 1.0",
        ),
        (
            {"curiosity_discount": 0.0, "curiosity_steps": 2},
            "`curiosity_discount` must be above 0",
        ),
        (
            {"curiosity_discount": 0.0, "curiosity_episodic": False},
            "`curiosity_discount` must be above 0 .*, got 0",
        ),
    ],
)
def test_what_cannot_be_or_would_do_nothing_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        override(AgentConfig(), **settings)


@pytest.mark.parametrize(
    ("hunger", "is_conditioned"),
    [(2.0, False), ("linear:1:10", False), ("random", True), ("conditioned:0.5", True)],
)
def test_an_agent_is_conditioned_where_its_hunger_says_so(hunger, is_conditioned):
    assert override(AgentConfig(), hunger=hunger).is_conditioned == is_conditioned


@pytest.mark.parametrize(
    ("temperature", "tuned"), [(0.1, True), ("constant:0.1", False), ("plateaus:1:0.01", False)]
)
def test_a_temperature_is_tuned_where_it_is_a_number(temperature, tuned):
    config = override(AgentConfig(), temperature=temperature)
    assert config.tunes_temperature == tuned
    assert isinstance(config.temperature, float if tuned else Schedule)


@pytest.mark.parametrize("stride", [1, 2, 3, 7, 49, 100])
def test_the_stride_is_one_over_the_fraction(stride):
    assert override(AgentConfig(), actor_batch_fraction=1 / stride).actor_stride == stride
