import sys
from pathlib import Path

import pytest

from deep_curiosity import requirements
from deep_curiosity.requirements import require, warn_if_untested


def test_a_missing_package_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(ImportError, match=r"pip install 'deep-curiosity\[sb3\]'"):
        require("no_such_package", extra="sb3")


def test_a_package_that_is_there_passes() -> None:
    require("torch", extra="sb3")


def test_a_package_that_misses_something_itself_is_not_called_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_package.py").write_text("import no_such_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    require("broken_package", extra="sb3")
    assert "broken_package" not in sys.modules  # nothing is imported


def test_all_that_are_missing_are_named_at_once() -> None:
    with pytest.raises(ImportError, match=r"^no_such, nor_such are missing: pip install"):
        require("no_such", "torch", "nor_such", extra="sb3")


@pytest.mark.parametrize("installed", ["2.7", "2.7.0a1", "2.9.2", "2.10"])
def test_a_tested_version_is_silent(installed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requirements, "version", lambda _: installed)
    warn_if_untested("stable_baselines3", lowest="2.7", below="3")


@pytest.mark.parametrize("installed", ["2.6.9", "3.0", "3.0.0a2"])
def test_an_untested_version_warns(installed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requirements, "version", lambda _: installed)
    with pytest.warns(UserWarning, match=f"stable_baselines3 {installed} is untested here"):
        warn_if_untested("stable_baselines3", lowest="2.7", below="3")
