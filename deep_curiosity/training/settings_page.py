"""The page of all settings, docs/settings.md: python -m deep_curiosity.training.settings_page."""

from pathlib import Path
from typing import Any

from deep_curiosity.arguments import read_arguments
from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import Group, as_plain, flat
from deep_curiosity.training.command_line import (
    BONUS_HELP,
    NEW_EPISODE_HELP,
    PRESET_HELP,
    RESUME_HELP,
    SETTINGS_HELP,
    STOP_HELP,
    help_of,
)
from deep_curiosity.training.config import PRESETS, Config

INTRODUCTION = """\
# Settings

Every setting has one name. It is a flag of `deep-curiosity train` (`--total-steps 8000`; `--no-`
before the name of a switch turns it off, where its default is `True` or `False`), a keyword in
Python (`Config.of(total_steps=8000)`) and an entry of a run's `config.json`. A setting that would
do nothing in a run is refused. `--help` lists the common ones, `--help-all` all. `python -m
deep_curiosity.training.settings_page` writes this page.

## Command line
"""
HEADER = "\n| flag | default | meaning |\n| --- | --- | --- |\n"


def settings_page() -> str:
    """All settings in Markdown, a table for each group, with the comments of their fields."""
    config = Config()
    own = {"environment": config.environment, "run": config.run, "agent": config.agent}
    bonuses = {f"bonus: {kind}": make() for kind, make in BONUS_CONFIGS.items() if kind != "none"}
    command_line = [_row("resume", None, RESUME_HELP), _row("bonus", "curiosity", BONUS_HELP)]
    command_line += [_row("preset", "fast", PRESET_HELP)]
    command_line += [_row("settings", None, SETTINGS_HELP)]
    command_line += [_row("stop_when_solved", None, STOP_HELP)]
    command_line += [_row("new_episode", False, NEW_EPISODE_HELP), "\n"]
    for name, values in [each for each in PRESETS.items() if each[1]]:
        flags = " ".join(f"--{_flag(key)} {value}" for key, value in values.items())
        command_line.append(f"- `--preset {name}` is `{flags}`\n")
    groups: dict[str, Group] = own | bonuses | {"speed": config.speed}
    tables = [_tables(title.capitalize(), group) for title, group in groups.items()]
    return "".join([INTRODUCTION, HEADER, *command_line, *tables])


def _tables(title: str, group: Group) -> str:
    text, owner = f"\n## {title}\n", None
    for name, each in flat(group).items():
        if each.owner is not owner:
            owner = each.owner
            text += f"\n{(owner.__doc__ or '').splitlines()[0]}\n{HEADER}"
        text += _row(name, as_plain(each.value), help_of(each))
    return text


def _row(name: str, default: Any, text: str) -> str:
    return f"| `--{_flag(name)}` | {'' if default in ({}, []) else f'`{default}`'} | {text} |\n"


def _flag(name: str) -> str:
    return name.replace("_", "-")


def main() -> None:
    """Write the page."""
    Path("docs/settings.md").write_text(settings_page())


if __name__ == "__main__":
    read_arguments(main, description=__doc__)
