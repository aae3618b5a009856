import pytest

from deep_curiosity.agent.config import AgentConfig, ConditionedHunger
from deep_curiosity.configuration import override
from deep_curiosity.schedules import Schedule


def agent_config(**values):
    return override(AgentConfig(), **values)


@pytest.mark.parametrize(
    ("text", "hunger"),
    [
        ("linear:1:10", Schedule(1.0, 10.0, "linear")),
        ("random", ConditionedHunger("random")),
        ("bandit", ConditionedHunger("bandit")),
        ("battery", ConditionedHunger("battery")),
        ("battery:2", ConditionedHunger("battery", entry=2)),
        ("battery:-3", ConditionedHunger("battery", entry=-3)),
        ("battery:charge", ConditionedHunger("battery", entry="charge")),
        ("conditioned:0.5", ConditionedHunger("fixed", 0.5)),
    ],
)
def test_hunger_is_read_from_text_and_written_as_such(text, hunger):
    assert agent_config(hunger=text).hunger == hunger
    assert agent_config(hunger=str(hunger)).hunger == hunger


@pytest.mark.parametrize(
    "text", ["", "greedy", "conditioned", "conditioned:much", "random:1", "bandit:1"]
)
def test_a_hunger_that_cannot_be_read_is_refused(text):
    with pytest.raises(ValueError, match="`hunger` must be a number, a schedule such as linear"):
        agent_config(hunger=text)


def test_a_conditioned_hunger_lies_between_zero_and_one():
    with pytest.raises(ValueError, match=r"`hunger` must lie in \[0, 1\].*got 2.0"):
        ConditionedHunger(value=2.0)
    with pytest.raises(ValueError, match=r"`hunger` must .*conditioned:2"):
        agent_config(hunger="conditioned:2")


def test_only_a_conditioned_hunger_conditions_the_agent():
    assert agent_config(hunger="bandit").is_conditioned
    assert not agent_config(hunger="linear:1:10").is_conditioned
    assert not agent_config(hunger=0.5).is_conditioned


def test_a_number_is_the_start_of_a_tuned_temperature_and_a_schedule_is_not_tuned():
    assert agent_config(temperature=0.5).tunes_temperature
    assert not agent_config(temperature="constant:0.5").tunes_temperature
    assert not agent_config(temperature="plateaus:1:0.1").tunes_temperature


@pytest.mark.parametrize(("fraction", "stride"), [(1.0, 1), (0.5, 2), (1 / 3, 3), (0.1, 10)])
def test_a_fraction_of_a_batch_is_one_row_in_so_many(fraction, stride):
    assert agent_config(actor_batch_fraction=fraction).actor_stride == stride


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"actor_batch_fraction": 0.4}, "`actor_batch_fraction` must be one over a whole .* 0.4"),
        (
            {"target_information_rate": 1.0, "temperature": "constant:0.1"},
            "`target_information_rate` must be left out .*, got 1.0 with .*constant:0.1",
        ),
        (
            {"curiosity_coefficient": 1.0, "hunger": "bandit"},
            "`curiosity_coefficient` must be 'adaptive' .*, got 1.0",
        ),
        (
            {"curiosity_discount": 0.0, "curiosity_steps": 3},
            "`curiosity_discount` must be above 0 where .*, got 0",
        ),
        (
            {"curiosity_discount": 0.0, "curiosity_episodic": False},
            "`curiosity_discount` must be above 0 where .*, got 0",
        ),
    ],
)
def test_what_cannot_be_or_would_do_nothing_is_refused(values, message):
    with pytest.raises(ValueError, match=message):
        agent_config(**values)
