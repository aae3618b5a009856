import math

import mujoco
import numpy as np
import pytest

from deep_curiosity_envs import ReacherSparse

EPISODE_STEPS = 100
LINK = 0.5  # m


@pytest.fixture
def env():
    env = ReacherSparse()
    env.reset(seed=0)
    return env


def place(env, joints, target):
    env.data.qpos[:], env.data.qvel[:] = joints, 0.0
    env.data.mocap_pos[0, :2] = target
    mujoco.mj_kinematics(env.model, env.data)


def joint_angles(target):
    """Pose whose fingertip is at the target, by the law of cosines."""
    distance = math.hypot(*target)
    elbow = math.acos((distance**2 - 2 * LINK**2) / (2 * LINK**2))
    return np.array([math.atan2(target[1], target[0]) - elbow / 2, elbow])


def reach(env):
    """Torques of springs and dampers that pull the joints to the target's pose."""
    goal = joint_angles(env.data.mocap_pos[0, :2])
    error = [math.remainder(angle, math.tau) for angle in goal - env.data.qpos]
    return np.clip(3.0 * np.array(error) - 1.2 * env.data.qvel, -1, 1)


def test_fingertip_is_where_the_geometry_says(env):
    place(env, joints=(0.0, math.pi / 2), target=(0.3, 0.4))
    assert env.fingertip_to_target == pytest.approx([0.3 - 0.5, 0.4 - 0.5])


def test_observation_is_pose_speed_target_and_error(env):
    place(env, joints=(0.0, math.pi / 2), target=(0.3, 0.4))
    env.data.qvel[:] = (2.0, -4.0)
    expected = [1.0, 0.0, 0.0, 1.0, 0.5, -1.0, 0.3, 0.4, -0.2, -0.1]
    assert env.get_observation() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("offset", "reward"), [(0.0, 1.0), (0.049, 1.0), (0.051, 0.0)])
def test_only_a_fingertip_in_the_target_pays(env, offset, reward):
    place(env, joints=(0.0, math.pi / 2), target=(0.5 + offset, 0.5))
    assert env.get_reward() == reward


def test_targets_are_drawn_within_reach(env):
    distances = []
    for seed in range(50):
        env.reset(seed=seed)
        distances.append(math.hypot(*env.data.mocap_pos[0, :2]))
    assert 0.3 <= min(distances) < 0.4
    assert 0.8 < max(distances) <= 0.9


def test_observation_after_a_step_shows_the_fingertip_of_that_step(env):
    observation = env.step((1.0, 0.5))[0]
    shoulder, elbow = env.data.qpos
    fingertip = LINK * np.exp(1j * shoulder) + LINK * np.exp(1j * (shoulder + elbow))
    error = env.data.mocap_pos[0, :2] - [fingertip.real, fingertip.imag]
    assert observation[-2:] == pytest.approx(error, abs=1e-6)


def test_springs_reach_the_target_and_succeed():
    env = ReacherSparse()
    for seed in range(5):
        env.reset(seed=seed)
        rewards = [env.step(reach(env))[1] for _ in range(EPISODE_STEPS)]
        assert sum(rewards) > EPISODE_STEPS / 4
        assert env.is_success()


def test_success_needs_half_a_second_in_the_target(env):
    place(env, joints=(0.3, 1.0), target=(0.0, 0.0))
    env.data.mocap_pos[0, :2] = env.data.site("fingertip").xpos[:2]
    successes = [env.step((0, 0))[4]["is_success"] for _ in range(11)]
    assert successes == [False] * 9 + [True] * 2
