import math

import numpy as np
import pytest

from deep_curiosity_envs import PendulumSwingup

EPISODE_STEPS = 200
GRAVITY_TORQUE = 1.0 * 9.81 * 0.5  # N m: mass, gravity, length
INERTIA = 1.0 * 0.5**2  # kg m^2
MOTOR_TORQUE = 1.6  # N m


@pytest.fixture
def env():
    env = PendulumSwingup()
    env.reset(seed=0)
    return env


def place(env, angle, speed=0.0):
    joint = env.data.joint("hinge")
    joint.qpos[0], joint.qvel[0] = angle, speed


def swing_up(env):
    """Pump energy towards that of standing upright, then catch with springs and dampers."""
    angle, speed = env.pole_angle, env.pole_speed
    if abs(angle) < 0.4:
        torque = -8.0 * angle - 2.0 * speed
        return np.clip([torque / MOTOR_TORQUE], -1, 1)
    energy = 0.5 * INERTIA * speed**2 + GRAVITY_TORQUE * (math.cos(angle) - 1)
    return np.clip([-3.0 * energy * math.copysign(1.0, speed)], -1, 1)


def run_episode(env, controller, seed=0):
    env.reset(seed=seed)
    rewards, info = [], {}
    for _ in range(EPISODE_STEPS):
        _, reward, terminated, _, info = env.step(controller(env))
        assert not terminated
        rewards.append(reward)
    return sum(rewards), info


def test_episode_starts_hanging_at_rest(env):
    assert abs(env.pole_angle) == pytest.approx(math.pi, abs=0.02)
    assert env.pole_speed == pytest.approx(0.0, abs=0.02)


def test_observation_is_the_direction_and_speed(env):
    place(env, 3 * math.pi / 2, speed=4.0)
    assert env.get_observation() == pytest.approx([0.0, -1.0, 0.5], abs=1e-6)


@pytest.mark.parametrize(
    ("angle", "speed", "reward"),
    [
        (0.0, 0.0, 1.0),
        (0.29, 0.0, 1.0),
        (-0.29, 0.99, 1.0),
        (math.tau + 0.1, 0.0, 1.0),
        (0.31, 0.0, 0.0),
        (0.0, -1.01, 0.0),
        (math.pi, 0.0, 0.0),
    ],
)
def test_only_upright_and_slow_pays(env, angle, speed, reward):
    place(env, angle, speed)
    assert env.get_reward() == reward


def test_full_torque_cannot_lift_the_pole_directly(env):
    highest = math.pi
    for _ in range(EPISODE_STEPS):
        env.step([1.0])
        highest = min(highest, abs(env.pole_angle))
    assert highest > math.pi / 2


def test_pumping_energy_swings_up_and_succeeds():
    env = PendulumSwingup(action_cost=0.1)
    for seed in range(3):
        episode_return, info = run_episode(env, swing_up, seed)
        assert episode_return > EPISODE_STEPS / 2
        assert info["is_success"]


def test_doing_nothing_earns_nothing_and_random_actions_lose():
    env = PendulumSwingup(action_cost=0.1)
    random = np.random.default_rng(0)
    assert run_episode(env, lambda env: [0.0]) == (0.0, {"is_success": False})
    assert run_episode(env, lambda env: random.uniform(-1, 1, 1))[0] < -4.0


def test_success_needs_one_second_of_holding(env):
    place(env, 0.0)
    successes = [env.step(swing_up(env))[4]["is_success"] for _ in range(21)]
    assert successes == [False] * 19 + [True] * 2
