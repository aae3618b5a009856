import subprocess
import sys

import pytest

from deep_curiosity.cli.check import describe
from deep_curiosity.integrations.check.profile import profile
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_environment, task_actions


def check(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "deep_curiosity.integrations.check", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_task_is_profiled_and_the_bonus_checked():
    done = check("PendulumSwingup", "--num-steps", "300", "--num-updates", "20")
    assert done.returncode == 0, done.stderr
    for word in ("excess kurtosis", "targets", "floor_share", "noise floor makes"):
        assert word in done.stdout


def test_the_actions_of_a_task_are_those_that_the_agent_acts_in():
    environment = make_environment(EnvironmentConfig("NoiseSwitch", {"env_id": "Pendulum-v1"}))
    shown = describe(profile(environment, num_steps=2), task_actions(environment))
    assert shown.startswith("Actions: Box([-2. -1.], [2. 1.], (2,), float32), given in [-1, 1]")


@pytest.mark.slow
def test_the_frame_stack_is_profiled():
    done = check(
        "PendulumSwingup", "--frame-stack", "2", "--num-steps", "300", "--num-updates", "1"
    )
    assert done.returncode == 0, done.stderr
    features = [line.split()[0] for line in done.stdout.splitlines() if line[:9].strip().isdigit()]
    assert features == [str(number) for number in range(2 * 3 + 1)]


@pytest.mark.slow
def test_a_useless_bonus_is_reported_by_the_exit_status():
    done = check("PendulumSwingup", "--num-steps", "100", "--bonus", "constant")
    assert done.returncode == 1 and "not constant  NO" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["CartPole-v1"], "error: `action_space` must be a Box"),
        (["PendulumSwingup", "--bonus", "luck"], "error: `bonus` must be one of"),
        (["PendulumSwingup", "--bonus", "none"], "error: `bonus` must not be 'none'"),
        (["PendulumSwingup", "--num-steps", "1"], "`num_steps` must be at least 2,"),
    ],
)
def test_what_cannot_be_checked_is_reported_in_a_line(refusal, capsys, arguments, message):
    printed = refusal("check", *arguments)
    assert message in printed and "Traceback" not in printed
    assert not capsys.readouterr().out
