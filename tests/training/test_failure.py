import gymnasium
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deep_curiosity.training.config import Config
from deep_curiosity.training.failure import (
    closed_at_the_end,
    environment_failure,
    failed_index,
    note,
    way_on,
)
from deep_curiosity.training.wrappers import SyncEnvironments


class Breaking(gymnasium.Wrapper):
    def step(self, action):
        raise OSError("the link to the robot is down")


@pytest.mark.parametrize("kind", [SyncVectorEnv, SyncEnvironments])
def test_the_one_of_several_environments_that_raised_is_named(kind):
    makers = [
        lambda wrap=wrap: wrap(gymnasium.make("Pendulum-v1"))
        for wrap in (gymnasium.Wrapper, gymnasium.Wrapper, Breaking)
    ]
    several = kind(makers, autoreset_mode=AutoresetMode.DISABLED)
    several.reset(seed=0)
    with pytest.raises(OSError, match="robot") as raised:
        several.step(several.action_space.sample())
    several.close()
    assert failed_index(raised.value) == 2
    config = Config.of(env_id="Pendulum-v1", num_envs=3, out="runs/robot")
    told = str(environment_failure(config, raised.value, "training", step=6, kept="it is saved"))
    assert "got OSError: the link to the robot is down, from Pendulum-v1, number 2 of 3," in told
    assert "in training after step 6; it is saved." in told


@pytest.mark.parametrize(
    ("functions", "expected"),
    [
        ([], "continue with --resume runs/a"),
        (["hunger"], "continue with deep_curiosity.continue_run('runs/a', hunger=...)"),
    ],
)
def test_what_no_folder_holds_is_given_again_to_go_on(functions, expected):
    assert way_on(Config.of(out="runs/a"), functions) == expected


def test_a_single_environment_has_no_number():
    assert failed_index(ValueError("no traceback")) is None


class Noteless(Exception):
    """As before Python 3.11."""

    add_note = property()


def test_what_takes_no_note_is_told_by_a_warning():
    error = ValueError("wrong")
    note(error, "all is saved")
    assert error.__notes__ == ["all is saved"]
    with pytest.warns(UserWarning, match="all is saved"):
        note(Noteless(), "all is saved")


class Stuck(gymnasium.Env):
    def close(self):
        raise OSError("the socket is closed already")


def test_of_an_error_and_another_in_closing_the_first_comes_out():
    with pytest.raises(KeyError), closed_at_the_end(Stuck()):
        raise KeyError
    with pytest.raises(OSError, match="socket"), closed_at_the_end(Stuck()):
        pass
