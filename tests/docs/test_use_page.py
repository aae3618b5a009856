import pytest

from tests.docs.pages import ROOT, run_blocks

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs/use.md"


def test_the_page_runs_as_written(tmp_path, monkeypatch):
    for package in ("onnxruntime", "onnxscript", "safetensors"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    names = run_blocks(PAGE)
    assert names["actions"].shape == names["sampled"].shape == names["curious"].shape == (2, 1)
    assert names["value"].shape == (2,)
    assert names["terminated"] or names["truncated"]
    assert names["harder"].summary["total_steps"] == 600
    assert (tmp_path / "exported/pendulum/policy.safetensors").exists()
