import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial

import cloudpickle
import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

import deep_curiosity_envs
from deep_curiosity.training import environments
from deep_curiosity.training.collector import Collector, evaluate
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import (
    MADE_BY_FUNCTION,
    MAX_EPISODE_STEPS,
    EnvironmentMaker,
    check_spaces,
    make_environment,
    make_vector_environment,
    num_cells,
    picture_features,
    registered_id,
)
from deep_curiosity.training.wrappers import AsyncEnvironments, SyncEnvironments
from deep_curiosity_envs import MujocoVectorEnv

VECTOR = spaces.Box(-1.0, 1.0, (3,))


@pytest.mark.parametrize("env_id", [*deep_curiosity_envs.TASK_IDS, "MountainCarContinuous-v0"])
def test_actions_lie_in_the_unit_box(env_id):
    environment = make_environment(EnvironmentConfig(env_id))
    assert environment.action_space.low.tolist() == [-1.0] * environment.action_space.shape[0]
    assert environment.action_space.high.tolist() == [1.0] * environment.action_space.shape[0]
    environment.close()


def test_gymnasium_mujoco_tasks_are_rescaled():
    environment = make_environment(
        EnvironmentConfig("InvertedPendulum-v5")
    )  # its own actions lie in [-3, 3]
    environment.reset(seed=0)
    environment.step(np.array([0.5], np.float32))
    assert environment.unwrapped.data.ctrl.item() == pytest.approx(1.5)
    environment.close()


def test_short_names_are_ours():
    environment = make_environment(EnvironmentConfig("PointMaze", {"action_cost": 0.5}))
    assert environment.unwrapped.action_cost == 0.5
    assert num_cells(environment) == environment.unwrapped.num_cells
    assert picture_features(EnvironmentConfig("PointMaze")) == (0, 1)
    assert picture_features(EnvironmentConfig("PendulumSwingup")) == (0, 2)
    assert picture_features(EnvironmentConfig("PointMaze", frame_stack=3)) == (12, 13)
    assert picture_features(EnvironmentConfig("PendulumSwingup", frame_stack=2)) == (4, 6)


@pytest.mark.parametrize("env_id", ["MountainCarContinuous-v0", "ActionCost", "NoiseSwitch"])
def test_reaching_the_goal_of_mountain_car_is_success_whatever_is_around_it(env_id):
    environment = make_environment(EnvironmentConfig(env_id))
    environment.reset(seed=0)
    push = np.ones(environment.action_space.shape, np.float32)
    assert environment.step(0 * push)[4]["is_success"] is False
    environment.unwrapped.state = np.array([0.449, 0.07])
    assert environment.step(push)[4]["is_success"] is True


def test_the_goal_of_mountain_car_is_success_where_a_function_makes_it():
    config = EnvironmentConfig(environments.MADE_BY_FUNCTION)
    environment = make_environment(
        config, make_env=lambda: gymnasium.make("MountainCarContinuous-v0")
    )
    environment.reset(seed=0)
    assert environment.step(np.zeros(1, np.float32))[4]["is_success"] is False


def test_dm_control_dictionaries_become_vectors():
    pytest.importorskip("shimmy")
    pytest.importorskip("dm_control")
    environment = make_environment(EnvironmentConfig("dm_control/pendulum-swingup-v0"))
    observation, _ = environment.reset(seed=3)
    again, _ = environment.reset(seed=3)
    assert observation.shape == (3,)
    assert np.array_equal(observation, again)


def test_dm_control_is_imported_without_a_word_and_leaves_warnings_as_they_were():
    pytest.importorskip("shimmy")
    pytest.importorskip("dm_control")
    program = """
import warnings
from deep_curiosity.training.environments import registered_id
before = list(warnings.filters)
print(registered_id("dm_control/pendulum-swingup-v0"), warnings.filters == before)
"""
    headless = {name: os.environ[name] for name in os.environ.keys() - {"DISPLAY", "MUJOCO_GL"}}
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=headless
    )
    assert (run.stdout, run.stderr) == ("dm_control/pendulum-swingup-v0 True\n", "")


@pytest.mark.parametrize(
    ("observation_space", "action_space", "message"),
    [
        (VECTOR, spaces.Discrete(2), r"`action_space` must be a Box.*Discrete\(2\)"),
        (VECTOR, spaces.Box(-np.inf, np.inf, (1,)), "`action_space` must be bounded"),
        (VECTOR, spaces.Box(0.0, np.inf, (1,)), "`action_space` must be bounded"),
        (spaces.Dict(a=VECTOR), VECTOR, "`observation_space` must be a Box.*FlattenObservation"),
        (spaces.Box(0, 255, (8, 8, 3), np.uint8), VECTOR, "`observation_space` must be a Box"),
        (spaces.Discrete(4), VECTOR, r"`observation_space` must be a Box.*Discrete\(4\)"),
    ],
    ids=str,
)
def test_spaces_that_the_agent_cannot_take_are_named(observation_space, action_space, message):
    with pytest.raises(ValueError, match=message):
        check_spaces(observation_space, action_space)


def test_an_unknown_id_is_answered_with_the_nearest_and_our_own():
    with pytest.raises(ValueError, match=r"got 'HalfCheeta-v5'.*PendulumSwingup") as caught:
        make_environment(EnvironmentConfig("HalfCheeta-v5"))
    assert "HalfCheetah-v5" in str(caught.value)


def test_unknown_arguments_of_an_environment_are_named():
    with pytest.raises(ValueError, match=r"`env_kwargs` must be arguments of .*'wind'"):
        make_environment(EnvironmentConfig("PointMaze", {"wind": 1.0}))


@pytest.mark.parametrize(
    ("env_id", "vectorization", "kind"),
    [
        ("PointMaze", "auto", MujocoVectorEnv),
        ("PointMaze", "native", MujocoVectorEnv),
        ("PointMaze", "sync", SyncEnvironments),
        ("MountainCarContinuous-v0", "auto", SyncEnvironments),
        ("MountainCarContinuous-v0", "async", AsyncEnvironments),
    ],
)
def test_environments_are_made_in_the_way_that_is_set(env_id, vectorization, kind):
    config = EnvironmentConfig(env_id, num_envs=2, vectorization=vectorization)
    environments = make_vector_environment(config)
    one = make_environment(EnvironmentConfig(env_id))
    assert type(environments) is kind
    assert environments.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert environments.single_observation_space == one.observation_space
    assert environments.single_action_space == one.action_space
    observation, _ = environments.reset(seed=3)
    assert np.array_equal(observation[0], one.reset(seed=3)[0])
    infos = environments.step(np.full((2, *one.action_space.shape), 0.5, np.float32))[4]
    assert infos["is_success"].tolist() == [False, False]
    environments.close()


def test_ctrl_c_is_left_to_the_process_that_steps():
    handler = signal.getsignal(signal.SIGINT)
    config = EnvironmentConfig("PendulumSwingup", num_envs=2, vectorization="async")
    environments = make_vector_environment(config)
    assert signal.getsignal(signal.SIGINT) is handler
    environments.reset(seed=0)
    for process in environments.processes:
        os.kill(process.pid, signal.SIGINT)
    for _ in range(3):
        environments.step(np.zeros((2, 1), np.float32))
    environments.close()


def test_arguments_reach_every_environment():
    config = EnvironmentConfig("PendulumSwingup", {"action_cost": 0.5}, num_envs=2)
    environments = make_vector_environment(config)
    environments.reset(seed=0)
    assert environments.step(np.ones((2, 1)))[1].tolist() == [-0.5, -0.5]


def test_a_native_environment_is_only_for_our_own_tasks():
    config = EnvironmentConfig("MountainCarContinuous-v0", num_envs=2, vectorization="native")
    with pytest.raises(ValueError, match=r"`vectorization` must be .* for MountainCar.*'native'"):
        make_vector_environment(config)


def test_nothing_is_registered_twice():
    assert len(set(deep_curiosity_envs.TASK_IDS)) == len(deep_curiosity_envs.TASK_IDS)
    assert set(deep_curiosity_envs.TASK_IDS) <= set(gymnasium.registry)


class Task(gymnasium.Env):
    """Never ends by itself; what it shows and takes can be chosen."""

    def __init__(self, observation_space=VECTOR, action_space=VECTOR, word="", flag=None):
        self.observation_space, self.action_space = observation_space, action_space
        self.word, self.flag, self.taken = word, flag, []
        self.observation_space.seed(0)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        self.taken.append(action)
        info = {"success": np.array([1.0])} if len(self.taken) == 3 else {}
        return self.observation_space.sample(), np.array([0.5]), False, False, info


@pytest.fixture
def own():
    """The id of a task that is registered for one test."""
    gymnasium.register("Own-v0", entry_point=Task, max_episode_steps=5)
    yield "Own-v0"
    gymnasium.registry.pop("Own-v0")


UNMADE = EnvironmentConfig(MADE_BY_FUNCTION, max_episode_steps=5)


def made(observation_space=VECTOR, action_space=VECTOR, **settings):
    def make():
        return Task(observation_space, action_space)

    return make_environment(replace(UNMADE, **settings), make_env=make)


@pytest.mark.parametrize(
    ("action_space", "message"),
    [
        (spaces.Box(0, 10, (1,), np.int64), "must be a Box of continuous vectors.*int64"),
        (spaces.Box(0, 10, (1,), np.uint8), "must be a Box of continuous vectors.*uint8"),
        (spaces.Box(-1.0, 1.0, (0,)), "must be a Box of continuous vectors of one entry or more"),
        (spaces.Box(-3e38, 3e38, (1,)), r"must be bounded on both sides, by at most 1e\+09"),
        (
            spaces.Box(np.float32([-1.0, 2.0]), np.float32([1.0, 2.0])),
            "must have `low` below `high`",
        ),
    ],
    ids=str,
)
def test_actions_that_cannot_be_served_are_named(action_space, message):
    with pytest.raises(ValueError, match=f"`action_space` {message}"):
        made(action_space=action_space)


def test_an_observation_without_an_entry_is_named():
    with pytest.raises(
        ValueError, match=r"`observation_space` must be a Box .* one entry or more"
    ):
        made(spaces.Box(-1.0, 1.0, (0,)))


@pytest.mark.parametrize("frame_stack", [1, 3])
@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int64, np.uint64, np.float16])
def test_whole_numbers_are_observed_as_real_ones(dtype, frame_stack):
    info = np.finfo(dtype) if np.dtype(dtype).kind == "f" else np.iinfo(dtype)
    space = spaces.Box(info.min, info.max, (2,), dtype)
    environment = made(space, frame_stack=frame_stack)
    environment.reset(seed=0)
    action = np.array([-0.5, 0.25, 1.0], np.float32)
    for _ in range(2):
        observation = environment.step(action)[0]
    assert observation.dtype == environment.observation_space.dtype == np.float32
    assert observation.shape == environment.observation_space.shape
    if frame_stack > 1:
        assert observation[-5:-2].tolist() == action.tolist()


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("high", [1.3, 2.7, 0.1])
def test_an_action_lies_in_the_box_of_the_task_and_has_its_type(dtype, high):
    space = spaces.Box(-0.7, high, (3,), dtype)
    environment = made(action_space=space)
    environment.reset(seed=0)
    for value in (-1.0, 1.0, 0.999_999_9):
        environment.step(np.full(3, value, np.float32))
    for action in environment.unwrapped.taken:
        assert space.contains(action)
        assert action.dtype == dtype


@pytest.mark.parametrize(
    ("vectorization", "frame_stack"),
    [("sync", 1), ("sync", 3), ("async", 3), pytest.param("async", 1, marks=pytest.mark.slow)],
)
def test_what_an_environment_changes_in_place_stays_as_it_was(vectorization, frame_stack):
    class InPlace(Task):
        def reset(self, *, seed=None, options=None):
            self.state = np.zeros(3, np.float32)
            return self.state, {}

        def step(self, action):
            self.state += 0.1
            action *= 0
            return self.state, 0.0, False, False, {}

    config = replace(UNMADE, frame_stack=frame_stack)
    many = replace(config, num_envs=2, vectorization=vectorization)
    for environment in (
        make_environment(config, make_env=InPlace),
        make_vector_environment(many, make_env=InPlace),
    ):
        collector = Collector(environment, seed=0)
        action = np.full((collector.environment.num_envs, 3), 0.5, np.float32)
        taken = [collector.step(action)[0] for _ in range(12)]
        for step in taken:
            moved = step.next_observation[:, -3:] - step.observation[:, -3:]
            assert moved == pytest.approx(0.1, abs=1e-6)
        assert (action == 0.5).all()
        environment.close()


GOAL = spaces.Dict(
    observation=spaces.Box(-1.0, 1.0, (4,), np.float64),
    desired_goal=spaces.Box(-1.0, 1.0, (2,), np.float64),
    parts=spaces.Tuple((spaces.Discrete(3), spaces.Box(0, 9, (2, 2), np.int64))),
)


def test_dictionaries_become_vectors_of_the_entries_that_are_wanted():
    assert made(GOAL).observation_space.shape == (4 + 2 + 3 + 4,)
    chosen = made(GOAL, observation_keys=("observation", "desired_goal"))
    observation, _ = chosen.reset(seed=0)
    assert chosen.observation_space.shape == observation.shape == (6,)
    assert observation.dtype == np.float64
    expected = made(GOAL).reset(seed=0)[0]
    GOAL.seed(0)
    sample = GOAL.sample()
    assert observation[:2].tolist() == sample["desired_goal"].tolist()
    assert observation[2:].tolist() == sample["observation"].tolist()
    assert expected.shape == (13,)


def test_entries_that_are_not_there_and_images_are_named():
    with pytest.raises(
        ValueError, match=r"`observation_keys` must be entries .*desired_goal.*'a'"
    ):
        made(GOAL, observation_keys=("a",))
    with pytest.raises(ValueError, match=r"`observation_keys` must be entries .*no dictionary"):
        made(observation_keys=("a",))
    camera = spaces.Dict(camera=spaces.Box(0, 255, (8, 8, 3), np.uint8), speed=VECTOR)
    with pytest.raises(ValueError, match=r"`observation_space` must have no images.*_keys"):
        made(camera)
    assert made(camera, observation_keys=("speed",)).observation_space.shape == (3,)


def test_an_episode_has_the_limit_that_is_set_or_that_of_the_task(own):
    def length(environment):
        collector = Collector(environment, seed=0)
        action = np.zeros((collector.environment.num_envs, 3), np.float32)
        finished = []
        while not finished:
            finished = collector.step(action)[1]
        environment.close()
        return finished[0].length

    assert length(make_environment(EnvironmentConfig(own))) == 5
    for limit in (2, 9):
        config = EnvironmentConfig(own, max_episode_steps=limit)
        assert length(make_environment(config)) == limit
        assert length(make_vector_environment(replace(config, num_envs=2))) == limit
        assert (
            length(make_environment(EnvironmentConfig(own, {"max_episode_steps": limit}))) == limit
        )
    native = EnvironmentConfig("ReacherSparse", max_episode_steps=7, num_envs=2)
    environment = make_vector_environment(native)
    assert type(environment) is MujocoVectorEnv
    collector, finished = Collector(environment, seed=0), []
    while not finished:
        finished = collector.step(np.zeros((2, 2), np.float32))[1]
    assert finished[0].length == 7


def test_a_task_without_a_limit_is_told_of_and_cut_off():
    with pytest.warns(
        UserWarning, match="`max_episode_steps` should be set.*make_env.*1000 steps"
    ):
        environment = make_environment(EnvironmentConfig(MADE_BY_FUNCTION), make_env=Task)
    (episode,) = evaluate(lambda x, info: torch.zeros(1, 3), environment, episodes=1, seed=0)
    assert episode.length == MAX_EPISODE_STEPS
    said = type("Said", (Task,), {"_max_episode_steps": 5})  # which nothing holds it to
    with pytest.warns(UserWarning, match="`max_episode_steps` should be set"):
        environment = make_environment(EnvironmentConfig(MADE_BY_FUNCTION), make_env=said)
    own_limit = gymnasium.wrappers.TimeLimit(Task(), 7)  # which is seen, and kept
    environment = make_environment(EnvironmentConfig(MADE_BY_FUNCTION), make_env=lambda: own_limit)
    (episode,) = evaluate(lambda x, info: torch.zeros(1, 3), environment, episodes=1, seed=0)
    assert episode.length == 7


def test_an_environment_in_the_place_of_a_function_is_refused():
    with pytest.raises(TypeError, match=r"`make_env` must be a function that .*, got <"):
        EnvironmentMaker(Task())


@pytest.mark.parametrize(("own", "expected"), [(9, 9), (0, None), ((3, 4), None), (True, None)])
def test_what_is_no_number_of_cells_means_something_else_in_a_task(own, expected):
    environment = Task()
    environment.num_cells = own
    assert num_cells(environment) == expected


def test_a_function_that_hands_out_one_environment_again_is_refused():
    one = Task()
    make = EnvironmentMaker(lambda: one)
    assert make() is one
    with pytest.raises(ValueError, match="`make_env` must make a new environment at every call"):
        make()
    make = EnvironmentMaker(Task)
    kept = [make(), make()]
    assert kept[0] is not kept[1]


def test_an_environment_that_was_let_go_is_none_of_before_even_where_its_place_is_taken():
    make, places = EnvironmentMaker(Task), set()
    for _ in range(100):
        places.add(id(make()))
    assert len(places) < 100


def test_a_function_that_makes_environments_goes_to_workers_alone():
    make = EnvironmentMaker(Task)
    kept = make()
    there = cloudpickle.loads(cloudpickle.dumps(make))
    assert type(there()) is type(kept) and there.make_env is Task


def test_success_is_heard_and_ends_an_episode_if_that_is_wanted(own):
    for ends, length in ((False, 5), (True, 3)):
        config = EnvironmentConfig(own, terminate_on_success=ends)
        for environment in (
            make_environment(config),
            make_vector_environment(replace(config, num_envs=2)),
        ):
            collector, finished = Collector(environment, seed=0), []
            action = np.zeros((collector.environment.num_envs, 3), np.float32)
            while not finished:
                step, finished = collector.step(action)
            assert (finished[0].length, finished[0].success) == (length, 1.0)
            assert bool(step.terminated[0]) is ends


def test_a_native_environment_does_not_end_at_success():
    config = EnvironmentConfig("PointMaze", num_envs=2, terminate_on_success=True)
    assert type(make_vector_environment(config)) is SyncEnvironments
    with pytest.raises(
        ValueError, match=r"`vectorization` must be .*end at success, got 'native'"
    ):
        make_vector_environment(replace(config, vectorization="native"))


def test_arguments_of_every_kind_reach_the_task(own):
    environment = make_environment(EnvironmentConfig(own, {"word": "yes", "flag": True}))
    assert (environment.unwrapped.word, environment.unwrapped.flag) == ("yes", True)


def test_a_function_makes_the_environment_in_the_place_of_an_id():
    assert isinstance(made().unwrapped, Task)
    with pytest.raises(ValueError, match=r"`make_env` must be given again.*got None"):
        make_environment(UNMADE)
    with pytest.raises(ValueError, match=r"`env_id` must be left out beside `make_env`, got 'Pen"):
        make_environment(EnvironmentConfig("PendulumSwingup"), make_env=Task)
    with pytest.raises(ValueError, match=r"`env_kwargs` must be left out beside `make_env`"):
        make_environment(replace(UNMADE, env_kwargs={"a": 1}), make_env=Task)
    with pytest.raises(ValueError, match=r"`make_env` must return a gymnasium environment, got 3"):
        make_environment(UNMADE, make_env=lambda: 3)


def test_a_module_is_imported_for_its_tasks(tmp_path, monkeypatch):
    (tmp_path / "tasks_of_mine.py").write_text(
        "import gymnasium\n"
        "gymnasium.register('Mine-v0', entry_point='gymnasium.envs.classic_control:PendulumEnv',\n"
        "                   max_episode_steps=5)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    environment = make_environment(EnvironmentConfig("tasks_of_mine:Mine-v0"))
    assert environment.spec.max_episode_steps == 5
    with pytest.raises(ValueError, match=r"such as tasks_of_mine:Mine-v0.*'tasks_of_mine:Mine'"):
        make_environment(EnvironmentConfig("tasks_of_mine:Mine"))
    gymnasium.registry.pop("Mine-v0")
    with pytest.raises(
        ValueError, match=r"`env_id` must be a registered id.*'tasks_of_mine:Other"
    ):
        make_environment(EnvironmentConfig("tasks_of_mine:Other-v0"))
    with pytest.raises(ValueError, match=r"`env_id` must name a module.*PYTHONPATH.*'nowhere:M"):
        make_environment(EnvironmentConfig("nowhere:Mine-v0"))
    for path in ("./tasks_of_mine.py", ".tasks_of_mine", "tasks of mine"):
        with pytest.raises(ValueError, match=r"`env_id` must name a module as an import does"):
            make_environment(EnvironmentConfig(f"{path}:Mine-v0"))


@pytest.mark.parametrize(
    ("env_id", "settings", "make_env"),
    [
        ("ActionCost", {"env_kwargs": {"env_id": "Pendulum-v1"}}, None),
        (MADE_BY_FUNCTION, {}, lambda: gymnasium.make("Pendulum-v1")),
    ],
)
def test_a_limit_beyond_that_of_the_task_would_do_nothing_and_is_refused(
    env_id, settings, make_env
):
    own = {} if make_env is None else {"make_env": make_env}
    with pytest.raises(ValueError, match=r"`max_episode_steps` must be at most 200, .* 201"):
        make_environment(EnvironmentConfig(env_id, max_episode_steps=201, **settings), **own)
    config = EnvironmentConfig(env_id, max_episode_steps=7, **settings)
    environment = make_environment(config, **own)
    environment.reset(seed=0)
    taken = [environment.step(environment.action_space.sample())[3] for _ in range(7)]
    assert taken == [False] * 6 + [True]


@pytest.mark.parametrize("limits", [(20, 500), (500, 20), (20,)])
def test_of_several_limits_the_least_is_that_of_the_task(limits):
    def limited():
        task = Task()
        for limit in limits:
            task = gymnasium.wrappers.TimeLimit(task, limit)
        return task

    config = EnvironmentConfig(MADE_BY_FUNCTION)
    with pytest.raises(ValueError, match=r"`max_episode_steps` must be at most 20, .* 300"):
        make_environment(replace(config, max_episode_steps=300), make_env=limited)
    environment = make_environment(config, make_env=limited)
    (episode,) = evaluate(lambda x, info: torch.zeros(1, 3), environment, episodes=1, seed=0)
    assert episode.length == 20


def test_a_limit_beyond_that_within_a_task_of_dm_control_is_refused():
    env_id = "dm_control/pendulum-swingup-v0"
    inner = partial(gymnasium.make, registered_id(env_id), max_episode_steps=2_000)
    with pytest.raises(ValueError, match=r"`max_episode_steps` must be at most 1000, .* 1001"):
        config = EnvironmentConfig(MADE_BY_FUNCTION, max_episode_steps=1001)
        make_environment(config, make_env=inner)
    with pytest.raises(ValueError, match=r"`max_episode_steps` must be at most 1000, .* 1001"):
        make_environment(EnvironmentConfig(env_id, max_episode_steps=1001))
    assert make_environment(EnvironmentConfig(env_id, max_episode_steps=1000))


def test_a_task_of_gymnasium_robotics_names_its_extra_or_the_mujoco_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium_robotics", None)
    with pytest.raises(ImportError, match=r"gymnasium_robotics is missing.*\[robotics\]"):
        make_environment(EnvironmentConfig("PointMaze_UMaze-v3"))

    class OfAnotherMujoco(Task):
        __module__ = "gymnasium_robotics.envs"

        def __init__(self):
            raise AssertionError

    monkeypatch.setattr(environments, "version", {"mujoco": "3.17.0"}.get)
    gymnasium.register("FetchOwn-v4", entry_point=OfAnotherMujoco, max_episode_steps=5)
    with pytest.raises(ImportError, match=r"`env_id` must .* mujoco 3.17.0, got 'FetchOwn-v4'"):
        make_environment(EnvironmentConfig("FetchOwn-v4"))
    gymnasium.registry.pop("FetchOwn-v4")


@pytest.mark.parametrize("env_id", ["PointMaze_UMaze-v3", "AntMaze_UMaze-v5", "AdroitHandDoor-v1"])
def test_mazes_and_hands_of_gymnasium_robotics_are_taken(env_id):
    pytest.importorskip("gymnasium_robotics")
    config = EnvironmentConfig(env_id, max_episode_steps=4, terminate_on_success=True)
    collector = Collector(make_environment(config), seed=0)
    size = collector.environment.single_action_space.shape
    finished = [collector.step(np.zeros((1, *size), np.float32))[1] for _ in range(4)][-1]
    assert finished[0][1:3] == (4, 0.0)


@pytest.mark.parametrize("num_envs", [1, 2])
def test_actions_are_repeated_within_the_episodes_of_the_task(num_envs):
    config = EnvironmentConfig("PendulumSwingup", action_repeat=8, num_envs=num_envs)
    held = Collector(make_vector_environment(config), seed=0)
    single = Collector(make_vector_environment(replace(config, action_repeat=1)), seed=0)
    action = np.full((num_envs, 1), 0.5, np.float32)
    for _ in range(8):
        each, _ = single.step(action)
    once, _ = held.step(action)
    np.testing.assert_allclose(once.next_observation, each.next_observation, atol=1e-6)
    episodes = [episode for _ in range(24) for episode in held.step(action)[1]]
    assert [episode.length for episode in episodes] == [25] * num_envs  # of 200 steps
    for collector in (held, single):
        collector.environment.close()


def test_repeated_actions_are_not_stepped_by_one_call():
    config = EnvironmentConfig("PendulumSwingup", action_repeat=2, vectorization="native")
    with pytest.raises(ValueError, match="whose actions are repeated, got 'native'"):
        make_vector_environment(config)
