import os
import signal

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import deep_curiosity_envs
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import (
    check_spaces,
    make_environment,
    make_vector_environment,
    num_cells,
    picture_features,
)
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


def test_reaching_the_goal_of_mountain_car_is_success():
    environment = make_environment(EnvironmentConfig("MountainCarContinuous-v0"))
    environment.reset(seed=0)
    assert environment.step(np.zeros(1, np.float32))[4]["is_success"] is False
    environment.unwrapped.state = np.array([0.449, 0.07])
    assert environment.step(np.ones(1, np.float32))[4]["is_success"] is True


def test_dm_control_dictionaries_become_vectors():
    pytest.importorskip("shimmy")
    pytest.importorskip("dm_control")
    environment = make_environment(EnvironmentConfig("dm_control/pendulum-swingup-v0"))
    observation, _ = environment.reset(seed=3)
    again, _ = environment.reset(seed=3)
    assert observation.shape == (3,)
    assert np.array_equal(observation, again)


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
        ("PointMaze", "sync", SyncVectorEnv),
        ("MountainCarContinuous-v0", "auto", SyncVectorEnv),
        ("MountainCarContinuous-v0", "async", AsyncVectorEnv),
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
