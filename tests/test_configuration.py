import math
from collections import Counter
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import pytest

from deep_curiosity.bonuses.config import BONUS_CONFIGS, bonus_config
from deep_curiosity.configuration import Group, as_plain, changes, flat, override, setting
from deep_curiosity.schedules import Schedule
from deep_curiosity.training import Config


@dataclass(frozen=True)
class Engine(Group):
    """A group inside another."""

    power: float = setting(100.0, above=0)
    kind: Literal["diesel", "petrol"] = "diesel"
    wear: float = setting(0.5, name="engine_wear", at_least=0, below=1)


@dataclass(frozen=True)
class Car(Group):
    """A configuration with every kind of value."""

    doors: int = 4
    seed: int = setting(0, at_least=0)
    length: float | None = None
    heated: bool = False
    manual: Path = Path("manual")
    speed: float | Schedule = setting(1.0, above=0)
    share: float = setting(0.5, above=0, at_most=1)
    gears: tuple[int, ...] = (1, 2)
    prices: dict[str, float] = setting({})
    width: float | Literal["narrow", "wide"] = "wide"
    engine: Engine = field(default_factory=Engine)


def test_any_setting_is_overridden_by_its_flat_name_and_the_rest_stays():
    car = override(Car(), doors=2, power=50.0, engine_wear=0.25)
    assert (car.doors, car.engine.power, car.engine.wear) == (2, 50.0, 0.25)
    assert car == Car(doors=2, engine=Engine(50.0, "diesel", 0.25))
    assert Car().doors == 4 and Car().engine.power == 100


def test_settings_of_one_group_that_need_each_other_are_set_at_once():
    @dataclass(frozen=True)
    class Span(Group):
        low: float = 0.0
        high: float = 1.0

        def __post_init__(self):
            super().__post_init__()
            if self.low >= self.high:
                raise ValueError(f"`low` must be below `high`, got {self.low}.")

    assert override(Span(), low=5.0, high=6.0) == Span(5.0, 6.0)


def test_an_unknown_name_is_refused_with_the_names_that_are_known():
    with pytest.raises(
        TypeError, match=r"`colour` is no setting here; there are doors.*power"
    ) as error:
        override(Car(), colour="red")
    assert all(name in str(error.value) for name in flat(Car()))
    with pytest.raises(TypeError, match="`wear` is no setting here"):  # it is `engine_wear`
        override(Car(), wear=0.1)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("doors", "4", "`doors` must be int, got '4'"),
        ("doors", 4.0, "`doors` must be int, got 4.0"),
        ("doors", True, "`doors` must be int, got True"),
        ("doors", None, "`doors` must be int, got None"),
        ("length", "long", "`length` must be float or None, got 'long'"),
        ("length", True, "`length` must be float or None, got True"),
        ("heated", 1, "`heated` must be bool, got 1"),
        ("manual", 3, "`manual` must be Path, got 3"),
        ("speed", [1.0], r"`speed` must be float or Schedule, got \[1.0\]"),
        ("gears", [1, "two"], r"`gears` must be tuple\[int, \.\.\.\], got \[1, 'two'\]"),
        ("gears", 3, r"`gears` must be tuple\[int, \.\.\.\], got 3"),
        ("prices", {"a": "b"}, r"`prices` must be dict\[str, float\], got \{'a': 'b'\}"),
        ("prices", [1], r"`prices` must be dict\[str, float\], got \[1\]"),
        ("power", "strong", "`power` must be float, got 'strong'"),
        ("kind", 3, "`kind` must be 'diesel' or 'petrol', got 3"),
    ],
)
def test_a_value_of_the_wrong_type_is_refused_by_name_type_and_value(name, value, message):
    with pytest.raises(TypeError, match=message):
        override(Car(), **{name: value})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("doors", 0, "`doors` must be at least 1, got 0"),
        ("seed", -1, "`seed` must not be negative, got -1"),
        ("length", math.nan, "`length` must be finite, got nan"),
        ("length", math.inf, "`length` must be finite, got inf"),
        ("speed", 0.0, "`speed` must be positive, got 0.0"),
        ("speed", "linear:0:1", "`speed` cannot be read: .*`first` must be .*positive, got 0.0"),
        ("speed", "fast", "`speed` cannot be read: .*shape:first:last.*got 'fast'"),
        ("share", 0.0, "`share` must be positive, got 0.0"),
        ("share", 1.5, "`share` must be at most 1, got 1.5"),
        ("power", -1.0, "`power` must be positive, got -1.0"),
        ("kind", "steam", "`kind` must be one of 'diesel' or 'petrol', got 'steam'"),
        ("width", "thin", "`width` must be one of float, 'narrow' or 'wide', got 'thin'"),
        ("engine_wear", 1.0, "`engine_wear` must be below 1, got 1.0"),
        ("engine_wear", -0.5, "`engine_wear` must not be negative, got -0.5"),
    ],
)
def test_a_value_out_of_range_is_refused_by_name_rule_and_value(name, value, message):
    with pytest.raises(ValueError, match=message):
        override(Car(), **{name: value})


def test_a_group_made_directly_refuses_what_override_refuses():
    with pytest.raises(ValueError, match="`doors` must be at least 1, got 0"):
        Car(doors=0)
    with pytest.raises(ValueError, match=r"`engine_wear` must be below 1, got 2\.0"):
        Engine(wear=2.0)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("manual", "folder/file", Path("folder/file")),
        ("speed", "linear:1:10", Schedule(1.0, 10.0, "linear")),
        ("speed", "constant:2", Schedule(2.0, None, "constant")),
        ("speed", 3, 3.0),
        ("length", 5, 5.0),
        ("gears", [3, 4], (3, 4)),
        ("gears", range(3), (0, 1, 2)),
        ("prices", {"wheel": 80}, {"wheel": 80.0}),
        ("width", 2, 2.0),
        ("width", "narrow", "narrow"),
    ],
)
def test_text_lists_and_whole_numbers_are_brought_to_the_type(name, value, expected):
    found = flat(override(Car(), **{name: value}))[name].value
    assert found == expected and type(found) is type(expected)


def test_what_is_written_plainly_is_read_back():
    car = override(Car(), speed="exponential:1:0.1", manual="a/b", gears=[5], prices={"a": 1})
    plain = {name: as_plain(own.value) for name, own in flat(car).items()}
    assert plain["speed"] == "exponential:1.0:0.1" and plain["manual"] == "a/b"
    assert override(Car(), **plain) == car


def test_changes_are_what_differs():
    assert changes(Car(), Car()) == {}
    assert changes(override(Car(), doors=2, power=1.0), Car()) == {"doors": 2, "power": 1.0}


def test_defaults_are_not_shared():
    car = Car()
    car.prices["wheel"] = 80.0
    assert Car().prices == {}


def names_in(group):
    """Flat names of all settings, one for each place where one stands."""
    for each in fields(group):
        value = getattr(group, each.name)
        if isinstance(value, Group):
            yield from names_in(value)
        else:
            yield each.metadata.get("name", each.name)


@pytest.mark.parametrize("kind", BONUS_CONFIGS)
def test_flat_names_are_unique_whatever_the_bonus(kind):
    config = Config(bonus=bonus_config(kind))
    repeated = [name for name, number in Counter(names_in(config)).items() if number > 1]
    assert repeated == []
    assert set(flat(config)) == set(names_in(config))
    assert "bonus" not in flat(config)  # which `Config.of` takes for the kind of bonus


@pytest.mark.parametrize("kind", BONUS_CONFIGS)
def test_every_default_is_read_back_from_its_plain_form(kind):
    config = Config.of(bonus=kind)
    assert Config.from_json(config.to_json()) == config


def test_paths_begin_at_the_home_folder_wherever_they_stand(monkeypatch):
    @dataclass(frozen=True)
    class Places(Group):
        one: Path = Path("one")
        all: tuple[Path, ...] = ()

    monkeypatch.setenv("HOME", "/home/ada")
    expected = (Path("/home/ada/runs"), Path("runs"))
    given = (Path("~/runs"), Path("runs"))
    assert Places(all=given).all == override(Places(), all=list(given)).all == expected
    assert Places(Path("~/runs")).one == Places("~/runs").one == expected[0]
    unknown = Path("~nobody-of-this-name/runs")
    assert Places(unknown, (unknown,)) == Places(str(unknown), (unknown,))
    assert Places(unknown).one == unknown
