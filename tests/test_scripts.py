import json
import runpy
import subprocess
import sys
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest

from deep_curiosity.training import train

ROOT = Path(__file__).parents[1]
TINY = (
    "--total-steps 60 --learning-starts 20 --hidden-dim 16 --batch-size 32 --components 16 "
    "--num-members 2 --log-interval 20 --evaluation-episodes 1"
).split()


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


def test_train_resume_and_evaluate(tmp_path):
    out = tmp_path / "run"
    trained = run("train.py", "--env-id", "PointMaze", *TINY, "--out", out)
    assert trained.returncode == 0, trained.stderr
    assert "nats=" in trained.stderr
    resumed = run("train.py", "--resume", out, "--total-steps", 80)
    assert resumed.returncode == 0, resumed.stderr
    assert json.loads((out / "summary.json").read_text())["total_steps"] == 80
    evaluated = run("evaluate.py", out, "--episodes", 2)
    assert evaluated.returncode == 0, evaluated.stderr
    assert evaluated.stdout.startswith("PointMaze: return ")


def test_a_run_stops_when_it_is_solved(tmp_path, monkeypatch, capsys):
    out = tmp_path / "run"
    solved = ["--evaluation-interval", 40, "--stop-when-solved", -1e9]
    run_here(monkeypatch, "train.py", "--env-id", "PointMaze", *TINY, "--out", out, *solved)
    assert json.loads((out / "summary.json").read_text())["total_steps"] == 40
    assert "Stopped at step 40; continue with --resume" in capsys.readouterr().out


def test_a_conditioned_run_is_played_at_several_hungers(tiny, monkeypatch, capsys):
    train(tiny.override(hunger="random"), show_progress=False)
    capsys.readouterr()
    run_here(monkeypatch, "evaluate.py", tiny.run.out, "--episodes", 1, "--hunger", 0, 0.5, 1)
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(": return")[0].split()[-1] for line in lines] == ["0", "0.5", "1"]
    with pytest.raises(
        SystemExit, match=r"error: `hunger` must lie in \[0, 1\] where conditioned, got 2.0"
    ):
        run_here(monkeypatch, "evaluate.py", tiny.run.out, "--hunger", 2)


def test_a_video_is_written_where_something_renders(tiny, tmp_path):
    video = tmp_path / "video.gif"
    task = {"env_id": "ReacherSparse", "env_kwargs": {}, "frame_stack": 2}
    train(tiny.override(**task), show_progress=False)
    played = run("evaluate.py", tiny.run.out, "--episodes", 1, "--video", video, MUJOCO_GL="egl")
    if played.returncode:
        assert "error: MuJoCo could not start OpenGL" in played.stderr
        pytest.skip("nothing renders here")
    frames = np.stack(imageio.mimread(video))[..., :3]
    assert len(frames) == 100
    assert (frames[0] != frames[0, 0, 0]).any(-1).mean() > 0.01  # something is there
    assert (frames[0] != frames[-1]).any()  # and moves


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env-id", "CartPole-v1"], "error: `action_space` must be a Box"),
        (["--env-id", "NoSuchTask-v0"], "error: `env_id` must be a registered id"),
        (["--num-members", "1"], "error: `num_members` must be at least 2"),
        (["--resume", "no/such/folder"], "error: a run must have a config.json"),
        (["--bonus", "noise"], "curiosity"),
    ],
    ids=str,
)
def test_a_mistake_on_the_command_line_is_answered_in_one_line(
    tmp_path, monkeypatch, capsys, arguments, message
):
    with pytest.raises(SystemExit) as stopped:
        run_here(monkeypatch, "train.py", *arguments, "--out", tmp_path / "run")
    printed = capsys.readouterr()
    assert stopped.value.code not in (None, 0)
    assert message in f"{stopped.value.code}{printed.err}{printed.out}"


@pytest.mark.parametrize("script", ["train.py", "evaluate.py", "study.py", "tune.py"])
def test_help_says_what_every_option_is(monkeypatch, capsys, script):
    with pytest.raises(SystemExit) as stopped:
        run_here(monkeypatch, script, "--help")
    assert stopped.value.code == 0
    assert "Folder" in capsys.readouterr().out


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
