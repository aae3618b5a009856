import json
import os
import signal
import subprocess
import sys

import pytest

from deep_curiosity.cli import main
from deep_curiosity.training.learner import Learner

TINY = (
    "--total-steps 60 --learning-starts 20 --hidden-dim 16 --batch-size 32 --components 16 "
    "--num-members 2 --log-interval 20 --evaluation-episodes 1"
).split()


def run(*arguments):
    """Run a command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "deep_curiosity", *map(str, arguments)],
        capture_output=True,
        text=True,
    )


def test_train_resume_and_evaluate(tmp_path, capsys):
    out = tmp_path / "run"
    trained = run("train", "--env-id", "PointMaze", *TINY, "--out", out)
    assert trained.returncode == 0, trained.stderr
    assert "nats=" in trained.stderr
    assert main(["train", "--resume", str(out), "--total-steps", "80"]) == 0
    assert json.loads((out / "summary.json").read_text())["total_steps"] == 80
    capsys.readouterr()
    assert main(["evaluate", str(out), "--episodes", "2"]) == 0
    assert capsys.readouterr().out.startswith("PointMaze: return ")


@pytest.mark.parametrize(
    ("sent", "status"), [(None, 0), (signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
def test_the_exit_status_says_whether_a_signal_stopped_the_run(
    tmp_path, monkeypatch, sent, status
):
    update = Learner.update

    def interrupted(self):
        if sent is not None and len(self.replay) == 33:
            os.kill(os.getpid(), sent)
        return update(self)

    monkeypatch.setattr(Learner, "update", interrupted)
    solved = ["--evaluation-interval", "40", "--stop-when-solved=-1"]
    arguments = ["train", "--env-id", "PointMaze", *TINY, *solved, "--out", str(tmp_path / "run")]
    assert main(arguments) == status
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["stopped_by"] == ("callback" if sent is None else sent.name)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env-id", "CartPole-v1"], "error: `action_space` must be a Box"),
        (["--env-id", "NoSuchTask-v0"], "error: `env_id` must be a registered id"),
        (["--num-members", "1"], "error: `num_members` must be at least 2"),
        (["--resume", "no/such/folder"], "error: `resume` must be the folder of a run"),
    ],
    ids=str,
)
def test_a_mistake_on_the_command_line_is_answered_in_one_line(
    tmp_path, refusal, arguments, message
):
    out = [] if "--resume" in arguments else ["--out", tmp_path / "run"]
    printed = refusal("train", *arguments, *out)
    assert printed.startswith(message)
    assert printed.count("\n") == 1


def test_a_word_that_is_no_choice_is_answered_with_the_choices(refusal):
    assert "curiosity" in refusal("train", "--bonus", "noise")
