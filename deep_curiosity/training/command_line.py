"""The command line of a run: every setting by its flat name, the common ones in `--help`."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import field, make_dataclass, replace
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import tyro

from deep_curiosity.arguments import check_folder, read_arguments
from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import Setting, coerce, flat, from_home, unknown_setting
from deep_curiosity.training.config import IGNORED, PRESETS, Config, merge_config
from deep_curiosity.training.log import once_each, read_config

COMMON = (
    "env_id",
    "env_kwargs",
    "max_episode_steps",
    "observation_keys",
    "frame_stack",
    "num_envs",
    "total_steps",
    "seed",
    "out",
    "init_from",
    "update_to_data",
    "evaluation_interval",
    "bonus_weight",
    "features",
    "hidden_dim",
    "prior",
    "hunger",
    "discount",
    "curiosity_discount",
    "learning_rate",
    "device",
    "threads",
    "compile",
)
"""Settings that a user turns; `--help-all` shows the others too."""
BONUS_HELP = (
    "Curiosity; a baseline to compare with, weighed and standardised alike; constant, a control "
    "without information; or none, plain soft actor-critic. Each has settings of its own."
)
PRESET_HELP = (
    "How networks sample a batch: the fast default; exact, every network learns from all of every "
    "batch; or paper, which besides renews the marginal at every update."
)
TRUTH = {"true": True, "false": False}
"""Words among arguments of the environment that would be true as text, both of them."""
RESUME_HELP = (
    "Folder of a run to continue, in place; what does not change what is learned may be given "
    "anew: total_steps, intervals, evaluation_episodes, device, threads, compile."
)
SETTINGS_HELP = "JSON file of settings by their flat names, as tune writes it; flags go before it."
STOP_HELP = "Mean return of an evaluation from which the run stops, as solved; it can be resumed."
NEW_EPISODE_HELP = (
    "With --resume: go on with the next episode, where a task does not repeat the one in progress."
)


class Command(NamedTuple):
    """What a command line asks for."""

    config: Config
    resume: bool
    stop_when_solved: float | None = None
    new_episode: bool = False


def parse(
    arguments: Sequence[str] | None = None, *, description: str, prog: str | None = None
) -> Command:
    """Read a command line; with `--resume` what is not given is as the run has it.

    Args:
        arguments: Those of the process when `None`.
        description: Of the command, for its help.
        prog: How the command is called, for its help.

    Raises:
        FileNotFoundError: If there is no run to continue.
        SystemExit: If an option cannot be read, once it is printed why.
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of range, a setting would do nothing, or a run cannot be
            continued with it.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    show_all = not {"-h", "--help"} & set(given)  # what is hidden could not be set either
    given = ["--help" if argument == "--help-all" else argument for argument in given]
    resume = _peek(given, "--resume")
    own = Config() if resume is None else _read_own(resume)
    path = _peek(given, "--settings")
    file = {} if path is None else read_file(from_home(Path(path)))
    preset = _known(_peek(given, "--preset"), PRESETS)
    bonus = _known(_peek(given, "--bonus"), BONUS_CONFIGS)
    base = own.override(preset, bonus=bonus or file.get("bonus", own.bonus))
    _refuse_of_other_bonuses(given, base)
    settings = _with_file(base, file, preset)
    kind = _command_class(settings, base.bonus.kind, show_all)
    read = vars(read_arguments(kind, given, description=description, prog=prog))
    values = {name: _from_text(each, read[name]) for name, each in settings.items()}
    config = base.override(**values)
    if resume is None:
        if read["new_episode"]:
            raise ValueError("`new_episode` must be left out without --resume, got True.")
        check_folder("out", config.run.out)
        return Command(config, False, read["stop_when_solved"])
    if config.run.out.resolve() != own.run.out.resolve():
        raise ValueError(
            f"`out` must be left out where a run is continued in {own.run.out}, "
            f"got {config.run.out}."
        )
    merged = merge_config(config, own)
    return Command(merged, True, read["stop_when_solved"], read["new_episode"])


def _read_own(folder: str) -> Config:
    """Settings of the run that is to be continued."""
    path = from_home(Path(folder))
    check_folder("resume", path)
    return read_config(path, "resume")


def read_file(path: Path) -> dict[str, Any]:
    """Settings in a JSON file, by their flat names; where a run lies, and what a clock chose, not.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds something else.
    """
    try:
        values = json.loads(path.read_text(), object_pairs_hook=once_each)
    except (OSError, ValueError, RecursionError) as error:
        kind = type(error) if isinstance(error, FileNotFoundError) else ValueError
        raise kind(f"`settings` must name a JSON file, got {path}: {error}.") from error
    if not isinstance(values, dict):
        raise ValueError(f"`settings` must name a file of names and values, got {path}.")
    return {name: value for name, value in values.items() if name not in IGNORED}


def _peek(arguments: list[str], flag: str) -> str | None:
    """Value of a flag, before all are read."""
    for argument, value in zip_longest(arguments, arguments[1:]):
        if argument == flag:
            return value
        if argument.startswith(f"{flag}="):
            return argument.partition("=")[2]
    return None


def _known(value: str | None, choices: Any) -> str | None:
    """A choice, or nothing where it is none: the parser then says which there are."""
    return value if value in choices else None


def _with_file(base: Config, file: dict[str, Any], preset: str | None) -> dict[str, Setting]:
    """All settings, those of a file in their places; they are checked together with the flags.

    What the file says of its own bonus is left out where a flag names another one, and what a
    preset says that is given goes before it.

    Raises:
        TypeError: If there is no such setting, or a value has the wrong type.
        ValueError: If text cannot be read.
    """
    settings = flat(base)
    left_out = {"bonus", *(PRESETS[preset] if preset else ())}
    if file.get("bonus", base.bonus.kind) != base.bonus.kind:
        left_out |= set(flat(Config.of(bonus=file["bonus"]))) - set(settings)
    for name, value in file.items():
        if name not in {*settings, *left_out}:
            raise unknown_setting(name, settings)
        if name not in left_out:
            each = settings[name]
            settings[name] = replace(each, value=coerce(name, each.annotation, value))
    return settings


def _refuse_of_other_bonuses(arguments: list[str], base: Config) -> None:
    """Name the bonus whose setting is given; the parser only says that there is none here.

    Raises:
        ValueError: If a setting is given that another bonus has.
    """
    flags = [
        each[2:].partition("=")[0].replace("-", "_") for each in arguments if each[:2] == "--"
    ]
    for name in set(flags) - set(flat(base)):
        owners = [kind for kind in BONUS_CONFIGS if name in flat(Config.of(bonus=kind))]
        if owners:
            raise ValueError(
                f"`{name}` must be left out with the bonus {base.bonus.kind}; it is a setting of "
                f"{', '.join(owners)}."
            )


def _command_class(settings: dict[str, Setting], bonus_kind: str, show_all: bool) -> type:
    """One flat dataclass of all settings, as tyro reads it."""
    bonus = Annotated[Literal[tuple(BONUS_CONFIGS)], tyro.conf.arg(help=BONUS_HELP)]  # type: ignore[valid-type]
    preset = Annotated[Literal[tuple(PRESETS)], tyro.conf.arg(help=PRESET_HELP)]  # type: ignore[valid-type]
    resumed = Annotated[Path | None, tyro.conf.arg(help=RESUME_HELP)]
    file = Annotated[Path | None, tyro.conf.arg(help=SETTINGS_HELP)]
    solved = Annotated[float | None, tyro.conf.arg(help=STOP_HELP)]
    anew = Annotated[bool, tyro.conf.arg(help=NEW_EPISODE_HELP)]
    own: list[Any] = [
        ("resume", resumed, field(default=None)),
        ("bonus", bonus, field(default=bonus_kind)),
        ("preset", preset, field(default="fast")),
        ("settings", file, field(default=None)),
        ("stop_when_solved", solved, field(default=None)),
        ("new_episode", anew, field(default=False)),
    ]
    for name, each in settings.items():
        hidden = () if show_all or name in COMMON else (tyro.conf.Suppress,)
        argument = tyro.conf.arg(help=help_of(each))
        annotation = Annotated[(_annotation(each), argument, *hidden)]  # type: ignore[valid-type]
        own.append((name, annotation, _default(each)))
    return make_dataclass("Command", own)


def _annotation(each: Setting) -> Any:
    """Type of a setting on a command line, where values that can be parsed are text."""
    if any(hasattr(option, "parse") for option in get_args(each.annotation)):
        return str
    return each.annotation


def _default(each: Setting) -> Any:
    value = each.value
    if _annotation(each) is str:
        return field(default=str(value))
    if isinstance(value, dict):
        return field(default_factory=lambda: dict(value))
    return field(default=value)


def _from_text(each: Setting, value: Any) -> Any:
    """A value of the command line as the setting takes it: a number where it is one."""
    if isinstance(value, dict):
        return {name: TRUTH.get(entry, entry) for name, entry in value.items()}
    if _annotation(each) is not str or each.annotation is str:
        return value
    try:
        return float(value)
    except ValueError:
        return value


@cache
def _comments(owner: type) -> dict[str, str]:
    """Text below each field of a class, and of those it extends."""
    comments: dict[str, str] = {}
    for kind in reversed(owner.__mro__[:-1]):
        try:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        except (OSError, TypeError):
            continue
        assert isinstance(tree, ast.ClassDef)
        for statement, below in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(statement, ast.AnnAssign) and isinstance(below, ast.Expr):
                name, text = ast.unparse(statement.target), ast.literal_eval(below.value)
                comments[name] = " ".join(text.split())
    return comments


def help_of(each: Setting) -> str:
    """What the comment of a setting says."""
    return _comments(each.owner)[each.field]


def read_settings(pairs: Sequence[str], argument: str = "set") -> dict[str, Any]:
    """Settings written as `name=value`, each value as Python or as text.

    Args:
        pairs: As they are written.
        argument: That was given them, for errors.

    Raises:
        ValueError: If one is not written so, or named twice.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        name, separator, text = pair.partition("=")
        if not (separator and name):
            raise ValueError(f"`{argument}` must be written as name=value, got {pair!r}.")
        if name in values:
            raise ValueError(f"`{argument}` must name a setting once, got {name!r} twice.")
        try:
            values[name] = ast.literal_eval(text)
        except (MemoryError, RecursionError, SyntaxError, ValueError):  # no Python, or too deep
            values[name] = text
    return values
