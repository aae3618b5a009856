import json
from pathlib import Path

import pytest
import torch

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.bonuses.config import BONUS_CONFIGS, RNDConfig
from deep_curiosity.configuration import flat
from deep_curiosity.schedules import Schedule
from deep_curiosity.training.config import (
    IGNORED,
    PRESETS,
    Config,
    check_device,
    config_key,
    merge_config,
)

OUTCOME_BONUSES = [name for name, kind in BONUS_CONFIGS.items() if kind.scores_outcomes]
VALUES = [
    *({"bonus": name} for name in BONUS_CONFIGS),
    *(
        {"bonus": name, "seed": 3, "out": "runs/a", "env_kwargs": {"a": 1}}
        for name in BONUS_CONFIGS
    ),
    {"hunger": 2.5},
    {"hunger": 0},
    {"hunger": "constant:2"},
    {"hunger": "linear:1:10"},
    {"hunger": "exponential:0.1:10"},
    {"hunger": "plateaus:1:2"},
    {"hunger": "conditioned:0.25"},
    {"hunger": "random"},
    {"hunger": "bandit"},
    {"hunger": "battery"},
    {"hunger": "battery:2"},
    {"hunger": "battery:-3"},
    {"hunger": "battery:energy"},
    {"temperature": 0.1},
    {"temperature": "constant:0.05"},
    {"temperature": "linear:0.02:0.002"},
    {"temperature": "exponential:1:0.1"},
    {"temperature": "plateaus:1:0.1"},
    {"features": (0, -1), "bonus_parts": {"information_gain": 1.0}, "bandwidth": 0.3},
    {"frame_stack": 3, "features": (0, -1), "features_of": "window"},
    {"bandwidth": "perplexity", "tune_bonus_weight": "past", "curiosity_coefficient": 0.5},
    {"tune_bonus_weight": 50.0, "marginal_half_life": None},
    {"hindsight": 4},
    {"curiosity_ends": 700, "curiosity_steps": 1, "curiosity_episodic": False},
    {"num_envs": 4, "vectorization": "sync", "soft_backup": False, "target_information_rate": 2.0},
]


@pytest.mark.parametrize("values", VALUES, ids=str)
def test_a_configuration_comes_back_from_json(values):
    config = Config.of(**values)
    plain = json.loads(json.dumps(config.to_json()))
    assert Config.from_json(plain) == config
    assert plain["bonus"] == config.bonus.kind


@pytest.mark.parametrize("values", VALUES, ids=str)
def test_its_changes_are_all_that_makes_a_configuration(values):
    config = Config.of(**values)
    changes = json.loads(json.dumps(config.changes()))
    assert Config.of(**changes) == config
    assert changes.keys() <= values.keys()


def test_the_default_has_no_changes():
    assert Config().changes() == {}
    assert Config.of(bonus="rnd", seed=2, hunger="random").changes() == {
        "bonus": "rnd",
        "seed": 2,
        "hunger": "random",
    }


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("bonus", BONUS_CONFIGS)
def test_a_preset_changes_what_the_bonus_has_of_it(preset, bonus):
    config = Config.of(preset, bonus=bonus)
    expected = {name: value for name, value in PRESETS[preset].items() if name in flat(config)}
    assert {name: flat(config)[name].value for name in expected} == expected
    changed = {} if preset == "fast" else expected
    assert {name: value for name, value in config.changes().items() if name != "bonus"} == changed


def test_a_value_that_is_given_goes_before_the_preset():
    config = Config.of("paper", refresh_interval=7)
    assert config.bonus.refresh_interval == 7
    assert config.bonus.dynamics.members == "all"
    assert config.override(seed=1).bonus.dynamics.members == "all"


def test_presets_are_the_samplings_that_they_are_named_after():
    fast, exact, paper = (Config.of(preset) for preset in ("fast", "exact", "paper"))
    assert fast == Config()
    assert (exact.agent.actor_q, exact.agent.actor_batch_fraction) == ("min", 1.0)
    assert (exact.bonus.refresh_interval, paper.bonus.refresh_interval) == (10, 1)
    assert exact.override(refresh_interval=1) == paper


def test_settings_are_found_by_their_flat_names():
    config = Config.of(env_id="PointMaze", hidden_dim=32, noise_floor=0.1, threads=2, out="a/b")
    assert config.environment.env_id == "PointMaze"
    assert config.agent.hidden_dim == 32
    assert config.bonus.dynamics.noise_floor == 0.1
    assert config.speed.threads == 2
    assert config.run.out == Path("a/b")


def test_no_two_settings_have_one_name():
    for bonus in BONUS_CONFIGS:
        config = Config.of(bonus=bonus)
        groups = (flat(group) for group in vars(config).values())
        assert sum(map(len, groups)) == len(flat(config))


def test_another_bonus_keeps_what_both_have():
    config = Config.of(bonus_weight=0.7, refresh_interval=3, noise_floor=0.2).override(bonus="rnd")
    assert config.bonus == RNDConfig(weight=0.7, refresh_interval=3)
    given = RNDConfig(random_features=8)
    assert Config.of(bonus=given).bonus == given


def test_a_bonus_may_change_together_with_what_does_not_go_with_it():
    config = Config.of(curiosity_discount=0.0)
    assert config.override(bonus="rnd", curiosity_discount=0.9).bonus.kind == "rnd"
    config = Config.of(curiosity_ends=700)
    assert config.override(bonus="none", curiosity_ends=None).bonus.kind == "none"


def test_hunger_and_temperature_are_read_from_their_text():
    config = Config.of(hunger="linear:1:10", temperature="constant:0.05")
    assert config.agent.hunger == Schedule(1.0, 10.0, "linear")
    assert config.agent.temperature == Schedule(0.05, shape="constant")
    assert Config.of(hunger="battery:energy").agent.hunger == ConditionedHunger(
        "battery", entry="energy"
    )
    assert Config.of(hunger=1).agent.hunger == 1.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"total_steps": 0}, "`total_steps` must be at least 1, got 0"),
        (
            {"total_steps": 500},
            r"`total_steps` must be above `learning_starts` \(500\), .* got 500",
        ),
        ({"learning_starts": 20_000}, r"above `learning_starts` \(20000\), .* got 20000"),
        (
            {"exploration": "pink", "policy_mixture_components": 2},
            "`exploration` must be 'policy' for a policy of 2 mixture components, got 'pink'",
        ),
        *(
            (
                {"bonus": name, "curiosity_discount": 0.0},
                f"`curiosity_discount` must be above 0 for the bonus {name}, .* got 0",
            )
            for name in OUTCOME_BONUSES
        ),
        ({"device": "tpu"}, "`device` must be cpu or cuda, got 'tpu'"),
        ({"bonus": "none", "hunger": "random"}, "`hunger` must be .* without a bonus, got random"),
        (
            {"bonus": "none", "hunger": "conditioned:1"},
            "`hunger` must be .* without a bonus, got conditioned:1.0",
        ),
        ({"bonus": "none", "curiosity_discount": 0.5}, "`curiosity_discount` must be left out"),
        ({"bonus": "none", "curiosity_steps": 2}, "`curiosity_steps` must be left out .* got 2"),
        ({"bonus": "none", "curiosity_episodic": False}, "`curiosity_episodic` must be left out"),
        ({"bonus": "none", "curiosity_coefficient": 1.0}, "`curiosity_coefficient` must be left"),
        ({"bonus": "none", "curiosity_ends": 9}, "`curiosity_ends` must be left out .* got 9"),
        ({"curiosity_ends": 20_000}, r"`curiosity_ends` must be below `total_steps` \(20000\)"),
        ({"hindsight": 0}, "`hindsight` must be at least 1, got 0"),
        ({"hindsight": 4, "frame_stack": 3}, "`frame_stack` must be 1 with `hindsight`.* got 3"),
        (
            {"hindsight": 4, "action_repeat": 2},
            "`action_repeat` must be 1 with `hindsight`.* got 2",
        ),
        (
            {"hindsight": 4, "terminate_on_success": True},
            "`terminate_on_success` must be left out with `hindsight`.* got True",
        ),
        (
            {"hindsight": 4, "curiosity_discount": 0.0},
            "`curiosity_discount` must be above 0 with `hindsight`.* got 0",
        ),
        (
            {"hindsight": 4, "curiosity_episodic": False},
            "`curiosity_episodic` must be True with `hindsight`.* got False",
        ),
        ({"features_of": "window"}, r"`features_of` must be left out without .* \[\] and 1"),
        ({"features_of": "window", "frame_stack": 3}, r"`features_of` must be left .* \[\] and 3"),
        ({"features_of": "window", "features": (0,)}, r"`features_of` must be .* \[0\] and 1"),
        ({"vectorization": "sync"}, "`vectorization` must be left out for a single .* got 'sync'"),
        ({"vectorization": "threads"}, "`vectorization` must be one of .*'async', got 'threads'"),
        ({"bonus": "novelty"}, "`bonus` must be one of curiosity, .*none, got 'novelty'"),
        ({"num_envs": 0}, "`num_envs` must be at least 1, got 0"),
        ({"seed": -1}, "`seed` must not be negative, got -1"),
        ({"update_to_data": 0.0}, "`update_to_data` must be positive, got 0.0"),
        ({"update_to_data": float("nan")}, "`update_to_data` must be finite, got nan"),
        ({"discount": 1.0}, "`discount` must be below 1, got 1.0"),
        ({"polyak": 1.5}, "`polyak` must be at most 1, got 1.5"),
        ({"marginal_half_life": 0.0}, "`marginal_half_life` must be positive, got 0.0"),
        ({"hunger": "conditioned:2"}, r"`hunger` must lie in \[0, 1\] where conditioned, got 2.0"),
        ({"hunger": "greed"}, "`hunger` must be a number, a schedule .* got 'greed'"),
        ({"hunger": "linear:1:0"}, "`last` must be finite and positive, got 0.0"),
        ({"hunger": "conditioned:much"}, "`hunger` cannot be read: .*'conditioned:much'"),
        ({"temperature": "slow:1:2"}, "`temperature` cannot be read: `schedule` .* 'slow:1:2'"),
    ],
    ids=str,
)
def test_what_cannot_be_or_would_do_nothing_is_refused_by_name(values, message):
    with pytest.raises(ValueError, match=message):
        Config.of(**values)


IDLE_SWITCHES = {
    "deduplicate": ({"total_steps": 1_000}, "where `compile` is auto and updates are fewer than"),
    "direct_matmul": ({"update_to_data": 0.1}, "where `compile` is auto and updates are fewer"),
    "numpy_policy": ({"exploration": "ou"}, "with `exploration` ou, where torch acts"),
}


@pytest.mark.parametrize("name", IDLE_SWITCHES)
def test_a_switch_that_is_off_in_a_run_where_it_would_do_nothing_is_refused(name):
    values, message = IDLE_SWITCHES[name]
    for config in (Config(), Config.of(**values)):
        with pytest.raises(ValueError, match=f"`{name}` must be left out {message}.* got False"):
            config.override(**values, **{name: False})
    assert not getattr(Config.of(**{name: False}).speed, name)
    with pytest.raises(ValueError, match=r"with 2 `policy_mixture_components`, .* got False"):
        Config.of(policy_mixture_components=2, numpy_policy=False)


@pytest.mark.parametrize("name", IDLE_SWITCHES)
def test_a_run_that_was_begun_with_such_a_switch_goes_on(name):
    values, _ = IDLE_SWITCHES[name]
    own = Config.from_json(Config.of(**values).to_json() | {name: False})
    assert not getattr(own.speed, name)
    assert merge_config(own.override(total_steps=1_100, log_interval=7), own).run.log_interval == 7
    assert getattr(own.override(**{name: True}).speed, name)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"batch_size": 2.5}, "`batch_size` must be int, got 2.5"),
        ({"batch_size": True}, "`batch_size` must be int, got True"),
        ({"env_kwargs": {"a": [1]}}, "`env_kwargs` must be .*dict"),
        ({"curiosity_ends": "late"}, "`curiosity_ends` must be int or None, got 'late'"),
        ({"history": 2}, "`history` is no setting here; there are env_id, .*frame_stack"),
        ({"bonus": "rnd", "noise_floor": 0.1}, "`noise_floor` is no setting .*random_features"),
    ],
    ids=str,
)
def test_a_wrong_type_or_name_is_a_type_error(values, message):
    with pytest.raises(TypeError, match=message):
        Config.of(**values)


def test_a_device_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(
        ValueError, match=r"`device` must be one that torch can use here, got 'cuda"
    ):
        Config.of(device="cuda:1")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    with pytest.raises(ValueError, match=r"one that torch can use here, got 'cuda:2'"):
        Config.of(device="cuda:2")
    assert Config.of(device="cuda:1").speed.device == "cuda:1"


def test_a_run_of_a_device_that_is_not_here_is_read_and_goes_on_with_another(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    own = Config.from_json(Config().to_json() | {"device": "cuda"})
    assert own.speed.device == own.override(seed=1).speed.device == "cuda"
    assert merge_config(own.override(device="cpu"), own).speed.device == "cpu"
    with pytest.raises(ValueError, match=r"`device` must be one that torch can use here, .*cuda'"):
        check_device(own.speed.device)
    with pytest.raises(ValueError, match="`device` must be cpu or cuda, got 'tpu'"):
        Config.from_json(Config().to_json() | {"device": "tpu"})


def test_an_unknown_preset_is_answered_with_those_there_are():
    with pytest.raises(
        ValueError, match=r"`preset` must be one of fast, exact, paper, got 'slow'"
    ):
        Config.of("slow")


@pytest.mark.parametrize("change", [{"batch_size": "many"}, {"batch_size": 0}, {"luck": 1}])
def test_a_file_that_cannot_be_read_is_named(change):
    with pytest.raises(ValueError, match=rf"a/config\.json: `{next(iter(change))}`"):
        Config.from_json(Config().to_json() | change, source="a/config.json")


def test_a_source_of_hunger_that_is_none_is_refused():
    source = object.__new__(ConditionedHunger)
    object.__setattr__(source, "source", "greed")  # as without the type checks of the tests
    with pytest.raises(ValueError, match=r"`source` must be one of .*'battery'.* got 'greed'"):
        source.__post_init__()


def test_where_a_run_lies_is_not_what_makes_it():
    config = Config.of(seed=3)
    moved = config.override(out="elsewhere", matmul_precision="high")
    assert config_key(config.to_json()) == config_key(moved.to_json())
    assert config_key(config.to_json()) != config_key(config.override(seed=4).to_json())
    assert not set(IGNORED) & config_key(config.to_json()).keys()


def test_batches_that_leave_a_model_or_the_actor_too_little_are_refused():
    with pytest.raises(ValueError, match=r"`batch_size` must be at least `num_members` \(5\)"):
        Config.of(batch_size=4, actor_batch_fraction=1.0)
    with pytest.raises(ValueError, match=r"`batch_size` must leave the actor two rows, .* got 8"):
        Config.of(batch_size=8, actor_batch_fraction=0.125)
    Config.of(batch_size=4, actor_batch_fraction=0.5, members="all")
    Config.of(batch_size=1, actor_batch_fraction=1.0, bonus="none")
