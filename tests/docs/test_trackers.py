"""The recipes run as written, with modules in place of the trackers that note what is told."""

import sys
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from deep_curiosity.training.log import read_progress
from tests.docs.pages import ROOT, run_blocks

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs/integrations/trackers.md"


@pytest.fixture
def told(monkeypatch, tmp_path):
    """What each tracker was told, by its name; runs lie in a folder of the test."""
    monkeypatch.chdir(tmp_path)
    told = {"wandb": {}, "trackio": {}, "mlflow": {}, "summary": {}, "settings": {}}

    def note(tracker):
        return lambda values, step: told[tracker].update({step: values})

    @contextmanager
    def opened(**options):
        assert options.get("mode", "offline") == "offline"
        told["settings"].update(options.get("config", {}))
        yield SimpleNamespace(log=note("wandb"), summary=told["summary"])

    modules = {
        "wandb": SimpleNamespace(init=opened),
        "trackio": SimpleNamespace(
            init=lambda **options: None, log=note("trackio"), finish=lambda: None
        ),
        "mlflow": SimpleNamespace(
            start_run=opened,
            log_params=told["settings"].update,
            log_metrics=note("mlflow"),
            set_tracking_uri=lambda uri: None,
        ),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return told


def test_every_tracker_hears_every_row(told):
    first = run_blocks(PAGE)["config"].run.out
    trackers = {"wandb": "", "trackio": "_by_trackio", "mlflow": "_by_mlflow"}
    for tracker, ending in trackers.items():
        recorded = read_progress(first.with_name(f"{first.name}{ending}"))
        assert list(told[tracker]) == [int(row["step"]) for row in recorded] != []
        for row, values in zip(recorded, told[tracker].values(), strict=True):
            assert values["agent/critic_loss"] == float(row["agent/critic_loss"])
    assert told["summary"]["eval/return"] == float(read_progress(first)[-1]["eval/return"])
    assert told["settings"]["hidden_dim"] == 16
