from pathlib import Path

from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import flat
from deep_curiosity.training import Config
from deep_curiosity.training.command_line import help_of
from deep_curiosity.training.settings_page import settings_page

PAGE = Path(__file__).parents[2] / "docs" / "settings.md"


def test_the_committed_page_is_what_the_configurations_say():
    rewrite = "python -m deep_curiosity.training.settings_page writes it anew"
    assert PAGE.read_text() == settings_page(), rewrite


def test_the_page_has_every_setting_of_every_bonus_with_its_comment():
    page = settings_page()
    for kind in BONUS_CONFIGS:
        for name, each in flat(Config.of(bonus=kind)).items():
            rows = [
                row
                for row in page.splitlines()
                if row.startswith(f"| `--{name}` ".replace("_", "-"))
            ]
            assert any(row.endswith(f" {help_of(each)} |") for row in rows), name
