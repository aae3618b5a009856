import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from deep_curiosity.training.run_log import RunLog
from deep_curiosity.training.wrappers import (
    ActionRepeat,
    PlainSteps,
    SyncEnvironments,
    VectorObservation,
    real_dtype,
    with_crossed_cells,
)

ACTION = np.zeros(1, np.float32)


class Says(gymnasium.Env):
    """Returns from `step` and `reset` what it was given."""

    action_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, returned=None, *, start=(None, {}), space=None):
        self.returned, self.start = returned, start
        self.observation_space = space or spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        return self.start

    def step(self, action):
        return self.returned


class Doubling(gymnasium.Env):
    """Changes its action in place, and remembers what it was given."""

    action_space = observation_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self):
        self.given = []

    def step(self, action):
        self.given.append(action.item())
        action *= 2
        return np.zeros(1), 0.0, False, False, {}


def test_an_action_is_held_though_a_task_changes_it():
    task, action = Doubling(), np.full(1, 0.3)
    ActionRepeat(task, 3).step(action)
    assert task.given == [0.3] * 3 and action == 0.3


def step(*, reward=0.0, terminated=False, truncated=False, info=None, **settings):
    returned = np.zeros(1, np.float32), reward, terminated, truncated, info or {}
    return PlainSteps(Says(returned), **settings).step(ACTION)


@pytest.mark.parametrize(
    "reward",
    [2, 2.0, np.float32(2), np.array([2.0]), np.array(2), np.array([[2]], np.uint8), [2.0]],
    ids=repr,
)
def test_a_reward_is_one_number_in_whatever_form(reward):
    given = step(reward=reward)[1]
    assert type(given) is float and given == 2.0


@pytest.mark.parametrize("flag", [True, np.True_, np.array([True]), np.array([1.0]), 1], ids=repr)
def test_a_flag_is_one_in_whatever_form(flag):
    assert step(terminated=flag)[2:4] == (True, False)
    assert step(truncated=flag)[2:4] == (False, True)
    assert all(type(value) is bool for value in step(terminated=flag, truncated=flag)[2:4])


@pytest.mark.parametrize("name", ["reward", "terminated", "truncated"])
@pytest.mark.parametrize("value", [None, "1", [1.0, 2.0], np.zeros(0), {}], ids=repr)
def test_what_is_no_number_is_named(name, value):
    with pytest.raises(ValueError, match=rf"`{name}` must be one number, got "):
        step(**{name: value})


@pytest.mark.parametrize("name", ["terminated", "truncated"])
@pytest.mark.parametrize("value", [np.nan, 0.5, 2, -1, np.array([0.5])], ids=repr)
def test_a_flag_that_is_neither_true_nor_false_is_named(name, value):
    with pytest.raises(ValueError, match=rf"`{name}` must be True or False, got "):
        step(**{name: value})


@pytest.mark.parametrize(
    ("returned", "got"),
    [((0, 1.0, False, {}), "4 values"), ((0, 1.0), "2 values"), (None, "NoneType")],
)
def test_a_step_of_another_length_is_named(returned, got):
    with pytest.raises(ValueError, match=rf"`step` .* must return \(observation, .*got {got}"):
        PlainSteps(Says(returned)).step(ACTION)


def test_a_reset_without_an_info_is_named():
    with pytest.raises(
        ValueError, match=r"`reset` .* must return \(observation, info\).* ndarray"
    ):
        PlainSteps(Says(start=np.zeros(1))).reset()
    with pytest.raises(ValueError, match=r"`info` must be a dictionary, got \[\]"):
        PlainSteps(Says(start=(np.zeros(1), []))).reset()


class OldStyle(Says):
    """As before gymnasium 0.26."""

    def reset(self, seed=None):
        return self.start


class Bare(Says):
    def reset(self):
        return self.start


@pytest.mark.parametrize(
    ("task", "got"), [(OldStyle, r"OldStyle\.reset\(seed=None\)"), (Bare, r"Bare\.reset\(\)")]
)
@pytest.mark.parametrize("wrap", [lambda task: task, gymnasium.Wrapper], ids=["bare", "wrapped"])
def test_a_reset_that_does_not_take_seed_and_options_is_named(task, got, wrap):
    with pytest.raises(ValueError, match=rf"`reset` .* must take \(seed, options\).*got {got}"):
        PlainSteps(wrap(task())).reset(seed=0)


def test_a_step_that_does_not_take_one_action_is_named():
    class Twice(Says):
        def step(self, action, other):
            return self.returned

    with pytest.raises(
        ValueError, match=r"`step` .* take \(action\).*Twice.step\(action, other\)"
    ):
        PlainSteps(Twice()).step(ACTION)


def test_an_error_of_the_same_kind_within_a_task_stays_what_it_is():
    class Fails(Says):
        def reset(self, **options):
            return len(3)

        def step(self, action):
            return len(3)

    task = PlainSteps(Fails())
    for call in (task.reset, lambda: task.step(ACTION)):
        with pytest.raises(TypeError, match="has no len"):
            call()


@pytest.mark.parametrize("error", [RuntimeError, OSError, SystemExit])
def test_a_task_that_cannot_be_closed_is_told_of(error):
    class Stuck(Says):
        def close(self):
            raise error("the socket is closed already")

    with pytest.warns(UserWarning, match=rf"`close` .* got {error.__name__}: the socket is"):
        PlainSteps(Stuck()).close()


@pytest.mark.parametrize("name", ["is_success", "success"])
@pytest.mark.parametrize(
    ("value", "succeeded"),
    [
        *[(value, True) for value in (True, 1.0, np.array([True]), np.float32(1), [1])],
        *[(value, False) for value in (False, 0.0, np.array([0.0]), None, np.nan, "no")],
    ],
    ids=repr,
)
def test_success_has_one_name_and_one_form(name, value, succeeded):
    assert step(info={name: value})[4]["is_success"] is succeeded


def test_of_two_words_of_success_one_is_enough_and_silence_stays_silence():
    assert step(info={"is_success": False, "success": 1.0})[4]["is_success"] is True
    assert "is_success" not in step(info={"successes": 3})[4]


def test_the_info_of_the_task_is_left_as_it_is():
    info = {"success": True}
    step(info=info)
    assert info == {"success": True}


def test_an_episode_ends_at_success_if_that_is_wanted():
    for succeeded in (True, False):
        info = {"success": succeeded}
        assert step(info=info, terminate_on_success=True)[2] is succeeded
        assert step(info=info)[2] is False
    assert step(terminate_on_success=True)[2] is False


def test_an_observation_is_a_new_vector_of_real_numbers():
    mine = np.array([3, 255], np.uint8)
    env = VectorObservation(
        Says(
            (mine, 0.0, False, False, {}),
            start=(mine, {}),
            space=spaces.Box(0, 255, (2,), np.uint8),
        )
    )
    first, second = env.reset()[0], env.step(ACTION)[0]
    mine[:] = 0
    assert first.dtype == second.dtype == env.observation_space.dtype == np.float32
    assert first.tolist() == second.tolist() == [3.0, 255.0]
    assert env.observation_space.high.tolist() == [255.0, 255.0]


def test_an_observation_of_another_shape_is_named():
    env = VectorObservation(Says(start=(np.zeros((1, 1)), {})))
    with pytest.raises(ValueError, match=r"`observation` must have the shape \(1,\).*\(1, 1\)"):
        env.reset()


def test_precision_is_kept_and_whole_numbers_are_single():
    assert real_dtype(np.float64) is np.float64
    assert {real_dtype(kind) for kind in (np.float16, np.float32, np.int64, np.uint8)} == {
        np.float32
    }


class Counts(gymnasium.Env):
    """Shows how many steps it has taken, and pays as much; something may happen at some step."""

    action_space = spaces.Box(-1.0, 1.0, (1,))
    observation_space = spaces.Box(-np.inf, np.inf, (1,))

    def __init__(self, **happens):
        self.happens = happens
        self.steps = 0

    def step(self, action):
        self.steps += 1
        shown = np.full(1, self.steps, np.float32)
        if self.steps == self.happens.get("broken"):
            shown[:] = np.nan
        flags = [self.steps == self.happens.get(name) for name in ("terminated", "truncated")]
        success = {"is_success": self.steps == self.happens.get("success")}
        return shown, float(self.steps), *flags, success if "success" in self.happens else {}


def test_an_action_is_held_and_its_rewards_are_summed():
    environment = ActionRepeat(Counts(), 3)
    given = [environment.step(ACTION) for _ in range(2)]
    assert [(step[0].item(), step[1]) for step in given] == [(3.0, 6.0), (6.0, 15.0)]
    assert given[1][2:] == (False, False, {})


@pytest.mark.parametrize("name", ["terminated", "truncated", "broken"])
def test_what_ends_an_episode_ends_the_holding(name):
    environment = ActionRepeat(Counts(**{name: 2}), 5)
    observation, reward, terminated, truncated, _ = environment.step(ACTION)
    assert (reward, environment.unwrapped.steps) == (3.0, 2)
    assert (terminated, truncated) == (name == "terminated", name == "truncated")
    assert np.isnan(observation).all() == (name == "broken")


def test_a_success_that_is_told_at_its_step_alone_is_one():
    class Tells(Counts):
        def step(self, action):
            *step, _ = super().step(action)
            return *step, {"is_success": True} if self.steps == 1 else {}

    environment = ActionRepeat(Tells(), 3)
    assert [environment.step(ACTION)[4] for _ in range(2)] == [{"is_success": True}, {}]


class Walks(Counts):
    """Tells the cell it is in, another one at every step."""

    def step(self, action):
        *step, info = super().step(action)
        return *step, info | {"cell": 10 * self.steps}


def test_cells_that_are_crossed_while_an_action_is_held_are_told():
    environment = ActionRepeat(Walks(truncated=5), 3)
    infos = [environment.step(ACTION)[4] for _ in range(2)]
    assert [info["cell"] for info in infos] == [30, 50]
    assert [info["cells_crossed"].tolist() for info in infos] == [[10, 20, 30], [40, 50]]
    assert with_crossed_cells({"cell": 3}) == {"cell": 3}


def test_cells_are_those_of_each_environment_though_holdings_end_apart():
    makers = [lambda end=end: ActionRepeat(Walks(terminated=end), 3) for end in (1, 9)]
    info = with_crossed_cells(SyncEnvironments(makers).step(np.zeros((2, 1)))[4])
    assert [cells.tolist() for cells in info["cell"]] == [[10], [10, 20, 30]]
    log = RunLog(step=4)
    log.on_step(info)
    assert log.cells == {10: 4, 20: 4, 30: 4}


@pytest.mark.parametrize(
    ("at", "steps"), [(1, [True, False]), (3, [True, False]), (4, [False, True])]
)
def test_a_success_on_the_way_is_one(at, steps):
    environment = ActionRepeat(Counts(success=at), 3)
    assert [environment.step(ACTION)[4]["is_success"] for _ in steps] == steps
