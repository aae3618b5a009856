import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MISTAKES = {"train": ["--num-members", 1], "evaluate": ["no/such"], "study": ["no_such.py"]}


def run_here(monkeypatch, script, *arguments):
    """Run a script in this process."""
    monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
    runpy.run_path(str(ROOT / "scripts" / script), run_name="__main__")


def run(script, *arguments, **environment):
    """Run a script in a process of its own."""
    return subprocess.run(
        [sys.executable, ROOT / "scripts" / script, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={"PATH": "", "OMP_NUM_THREADS": "1", **environment},
    )


@pytest.mark.parametrize("name", MISTAKES)
def test_a_script_is_the_command_of_its_name(monkeypatch, capsys, name):
    with pytest.raises(SystemExit) as stopped:
        run_here(monkeypatch, f"{name}.py", "--help")
    assert stopped.value.code == 0
    assert f"usage: deep-curiosity {name}" in capsys.readouterr().out
    with pytest.raises(SystemExit) as stopped:
        run_here(monkeypatch, f"{name}.py", *MISTAKES[name])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("error: ")


@pytest.mark.slow
def test_a_section_of_the_benchmark_leaves_its_page(tmp_path):
    measured = run("benchmark.py", "--only", "vector", "--repeats", 1, "--out", tmp_path)
    assert measured.returncode == 0, measured.stderr
    assert "## Vector environments" in (tmp_path / "README.md").read_text()
    assert (tmp_path / "vector.png").exists()


def test_calls_and_hops_are_printed(monkeypatch, capsys):
    run_here(monkeypatch, "count_calls.py")
    printed = capsys.readouterr().out
    assert "Update with the uniform prior: " in printed
    assert "Update with the learned prior: " in printed
    assert "From environment.step to torch.autograd.grad: " in printed
    assert "training/learner.py" in printed and "replay.py" in printed
