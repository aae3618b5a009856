"""Configurations: nested dataclasses whose settings have one flat name each.

A configuration is passed whole to what it configures. `override` changes any of its settings by
name, wherever in the nest it stands, and `flat` lists them all: command lines, files and studies
speak of settings by these names alone.
"""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

Nest = TypeVar("Nest", bound="Group")
MOST_STEPS = 10**12  # longer than a year at thirty thousand steps a second
MOST_SEED = 2**32 - 1  # what NumPy, torch and the tasks all take
LEAST_LEARNING_RATE = 1e-9  # Adam moves a weight by it, and float32 would round less away
MOST_BY_DEFAULT = 10**6  # of a count, where no setting says otherwise


class Group:
    """Base of the dataclasses that make up a configuration: every value is checked and coerced.

    Whole numbers must be from 1 to a million and others finite, unless `setting(...)` says
    otherwise; numbers in lists and mappings are held to its range alone.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of range.
    """

    def __post_init__(self) -> None:
        """Bring every value to its type, or reject it."""
        hints = _hints(type(self))  # type: ignore[arg-type]  # classes are hashable
        assert is_dataclass(self)
        for field in fields(self):
            name = field.metadata.get("name", field.name)
            value = coerce(name, hints[field.name], getattr(self, field.name))
            _check_value(name, value, field.metadata)
            object.__setattr__(self, field.name, value)


def setting(default: Any, **metadata: Any) -> Any:
    """A field of a group, with what its name and annotation do not say.

    Args:
        default: Its default.
        **metadata: `name`, its flat name where that differs from the field's; `at_least`,
            `above`, `below`, `at_most`, its range.
    """
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Setting:
    """One setting of a configuration: where it stands, and what it may be."""

    owner: type
    field: str
    path: tuple[str, ...]
    annotation: Any
    value: Any


def flat(config: Group, path: tuple[str, ...] = ()) -> dict[str, Setting]:
    """All settings of a configuration by their flat names, groups in their order."""
    settings: dict[str, Setting] = {}
    assert is_dataclass(config)
    for field in fields(config):
        value, here = getattr(config, field.name), (*path, field.name)
        if isinstance(value, Group):
            settings |= flat(value, here)
        else:
            name = field.metadata.get("name", field.name)
            hint = _hints(type(config))[field.name]
            settings[name] = Setting(type(config), field.name, here, hint, value)
    return settings


def override(config: Nest, **values: Any) -> Nest:
    """The same configuration with some settings changed.

    Args:
        config: What is changed.
        **values: New values, by flat name.

    Raises:
        TypeError: If there is no such setting, or a value has the wrong type.
        ValueError: If a value is out of range.
    """
    known = flat(config)
    for name in values:
        if name not in known:
            raise unknown_setting(name, known)
    by_path = {
        known[name].path: coerce(name, known[name].annotation, value)
        for name, value in values.items()
    }
    return _replaced(config, by_path)


def unknown_setting(name: str, known: Iterable[str]) -> TypeError:
    """The error about a name that is none, with those that are meant or could have been."""
    known = list(known)
    near = difflib.get_close_matches(name, known)
    nearest = f", the nearest is {', '.join(near)}" if near else ""
    return TypeError(f"`{name}` is no setting here{nearest}; there are {', '.join(known)}.")


def changes(config: Group, default: Group) -> dict[str, Any]:
    """Settings whose value differs from another configuration's, or that it does not have."""
    others = flat(default)
    return {
        name: own.value
        for name, own in flat(config).items()
        if name not in others or others[name].value != own.value
    }


def as_plain(value: Any) -> Any:
    """A value of a setting as JSON knows it."""
    if isinstance(value, dict | int | float | str | None):
        return value
    return list(value) if isinstance(value, tuple) else str(value)


def coerce(name: str, annotation: Any, value: Any) -> Any:
    """Bring a value to the type of its annotation, or reject it.

    Text is taken for paths and for values that can be parsed, whole numbers for real ones; a path
    may begin at the home folder.

    Raises:
        TypeError: Naming the setting, its type and the value.
        ValueError: If the value is none of those that are allowed.
    """
    options = get_args(annotation) if _is_union(annotation) else (annotation,)
    for option in options:
        if _is_of(option, value):
            return _at_home(value)
    problems: list[str] = []
    for option in options:
        try:
            converted = _convert(option, value)
        except ValueError as error:  # text that this type cannot read; another may
            problems.append(str(error))
            continue
        if converted is not None:
            return converted
    if problems:
        raise ValueError(f"`{name}` cannot be read: {' '.join(problems)}")
    choices = [get_args(option) for option in options if get_origin(option) is Literal]
    if choices and isinstance(value, str):
        raise ValueError(f"`{name}` must be one of {_shown(options)}, got {value!r}.")
    raise TypeError(f"`{name}` must be {_shown(options)}, got {value!r}.")


def _replaced(config: Nest, by_path: Mapping[tuple[str, ...], Any]) -> Nest:
    """The same group with values in their places, each group made anew at most once."""
    own: dict[str, Any] = {path[0]: value for path, value in by_path.items() if len(path) == 1}
    for name in dict.fromkeys(path[0] for path in by_path if len(path) > 1):
        below = {path[1:]: value for path, value in by_path.items() if path[0] == name}
        own[name] = _replaced(getattr(config, name), below)
    return replace(config, **own)  # type: ignore[type-var]  # every group is a dataclass


@cache
def _hints(group: Any) -> dict[str, Any]:
    return typing.get_type_hints(group)


def _is_union(annotation: Any) -> bool:
    return get_origin(annotation) in (Union, types.UnionType)


def _is_of(option: Any, value: Any) -> bool:
    """Whether a value is of a type as it stands."""
    origin, args = get_origin(option), get_args(option)
    if option is None or option is type(None):
        return value is None
    if _is_union(option):
        return any(_is_of(each, value) for each in args)
    if origin is Literal:
        return isinstance(value, str) and value in args
    if origin is tuple:
        return isinstance(value, tuple) and all(_is_of(args[0], entry) for entry in value)
    if origin in (dict, Mapping):
        return isinstance(value, dict) and all(
            _is_of(args[0], key) and _is_of(args[1], entry) for key, entry in value.items()
        )
    if option is Any:
        return True
    if isinstance(value, bool):  # which Python counts among the whole numbers
        return option is bool
    return isinstance(value, option)


def _convert(option: Any, value: Any) -> Any:
    """A value brought to a type, or `None` where it cannot be."""
    origin, args = get_origin(option), get_args(option)
    if origin is tuple and isinstance(value, list | tuple | range):
        entries = tuple(value)
        return _at_home(entries) if all(_is_of(args[0], entry) for entry in entries) else None
    if origin in (dict, Mapping) and isinstance(value, Mapping):
        converted = {key: _as(args[1], entry) for key, entry in value.items()}
        return None if None in converted.values() else converted
    if option is float and isinstance(value, int) and not isinstance(value, bool):
        return _as_float(value)
    if option is Path and isinstance(value, str):
        if not value:
            raise ValueError("a path must have characters, got ''.")
        return from_home(Path(value))
    if isinstance(value, str) and hasattr(option, "parse"):
        return option.parse(value)
    return None


def from_home(path: Path) -> Path:
    """The path that is meant, which may begin at a home folder; as it is where there is none."""
    try:
        return path.expanduser()
    except RuntimeError:  # of a user who is not known here
        return path


def as_path(name: str, value: str | Path) -> Path:
    """An argument as the path that is meant, which may begin at a home folder.

    Raises:
        TypeError: If it is no path.
    """
    try:
        return from_home(Path(value))
    except TypeError:
        raise TypeError(f"`{name}` must be a path, got {value!r}.") from None


def _at_home(value: Any) -> Any:
    """A value whose paths are those that are meant."""
    if isinstance(value, tuple):
        return tuple(_at_home(entry) for entry in value)
    return from_home(value) if isinstance(value, Path) else value


def _as_float(value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf  # which no range takes


def _as(option: Any, value: Any) -> Any:
    return value if _is_of(option, value) else _convert(option, value)


def _shown(options: tuple[Any, ...]) -> str:
    """Types as a reader of an error knows them."""
    words = []
    for option in options:
        if get_origin(option) is Literal:
            words += [repr(choice) for choice in get_args(option)]
        elif option is type(None):
            words.append("None")
        else:
            words.append(
                getattr(option, "__name__", str(option)) if not get_args(option) else str(option)
            )
    return ", ".join(words[:-1]) + (" or " if len(words) > 1 else "") + words[-1]


def _check_value(name: str, value: Any, bounds: Mapping[str, Any]) -> None:
    """Reject numbers out of range, wherever they stand, and text that names nothing."""
    if isinstance(value, str | Path):
        if not str(value) or "\0" in str(value):
            raise ValueError(f"`{name}` must have characters, and no NUL, got {str(value)!r}.")
    elif isinstance(value, tuple | dict):
        for entry in value.values() if isinstance(value, dict) else value:
            check_range(name, entry, {"at_least": None, "at_most": None} | dict(bounds))
    else:
        check_range(name, value, bounds)


def check_range(name: str, value: Any, bounds: Mapping[str, Any]) -> None:
    """Reject numbers out of range.

    Args:
        name: Of the setting.
        value: Anything; what is no number has no range.
        bounds: As in `setting`.

    Raises:
        ValueError: Naming the setting, the bound and the number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    is_count = isinstance(value, int)
    if not (is_count or math.isfinite(value)):
        raise ValueError(f"`{name}` must be finite, got {value}.")
    at_least = bounds.get("at_least", 1 if is_count and "above" not in bounds else None)
    at_most = bounds.get("at_most", MOST_BY_DEFAULT if is_count else None)
    if "above" in bounds and value <= bounds["above"]:
        rule = "positive" if bounds["above"] == 0 else f"above {bounds['above']}"
        raise ValueError(f"`{name}` must be {rule}, got {value}.")
    if at_least is not None and value < at_least:
        rule = "not be negative" if at_least == 0 else f"be at least {at_least}"
        raise ValueError(f"`{name}` must {rule}, got {value}.")
    if at_most is not None and value > at_most:
        raise ValueError(f"`{name}` must be at most {at_most}, got {value}.")
    if "below" in bounds and value >= bounds["below"]:
        raise ValueError(f"`{name}` must be below {bounds['below']}, got {value}.")
