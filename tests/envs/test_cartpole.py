import math

import numpy as np
import pytest

from deep_curiosity_envs import CartpoleSwingup

EPISODE_STEPS = 200
GRAVITY, LENGTH = 9.81, 0.5  # m/s^2, m
TOTAL_MASS, MOTOR_FORCE = 1.1, 6.0  # kg, N
CATCH_GAINS = np.array([3.65, 5.03, 39.3, 8.97])  # linear-quadratic, for the acceleration


@pytest.fixture
def env():
    env = CartpoleSwingup()
    env.reset(seed=0)
    return env


def place(env, *, position=0.0, angle=0.0, speed=0.0):
    env.data.joint("slider").qpos[0] = position
    env.data.joint("hinge").qpos[0] = angle
    env.data.joint("hinge").qvel[0] = speed


def swing_up(env):
    """Pump energy towards that of standing upright, then balance."""
    state = np.array([env.cart_position, env.cart_speed, env.pole_angle, env.pole_speed])
    position, cart_speed, angle, speed = state
    if abs(angle) < 0.5:
        acceleration = CATCH_GAINS @ state
    else:
        energy = 0.5 * (LENGTH * speed) ** 2 + GRAVITY * LENGTH * (math.cos(angle) - 1)
        pump = 5.0 * energy * math.tanh(5.0 * speed * math.cos(angle))
        acceleration = pump - 0.5 * position - 0.5 * cart_speed
    return np.clip([acceleration * TOTAL_MASS / MOTOR_FORCE], -1, 1)


def test_episode_starts_hanging_in_the_middle(env):
    assert abs(env.pole_angle) == pytest.approx(math.pi, abs=0.02)
    assert env.cart_position == pytest.approx(0.0, abs=0.02)


def test_observation_is_scaled(env):
    place(env, position=1.0, angle=math.pi / 2, speed=-4.0)
    env.data.joint("slider").qvel[0] = 2.0
    assert env.get_observation() == pytest.approx([0.5, 0.0, 1.0, 0.5, -0.5], abs=1e-6)


@pytest.mark.parametrize(
    ("state", "reward"),
    [
        ({}, 1.0),
        ({"angle": -0.29, "speed": 0.99, "position": 0.49}, 1.0),
        ({"angle": 0.31}, 0.0),
        ({"speed": 1.01}, 0.0),
        ({"position": -0.51}, 0.0),
        ({"angle": math.pi}, 0.0),
    ],
)
def test_only_upright_slow_and_centred_pays(env, state, reward):
    place(env, **state)
    assert env.get_reward() == reward


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_the_rail_ends(env, direction):
    for _ in range(EPISODE_STEPS):
        env.step([direction])
        assert abs(env.cart_position) < 2.1
    assert env.cart_position * direction > 1.5


def test_pumping_energy_swings_up_and_succeeds(env):
    rewards = [env.step(swing_up(env))[1] for _ in range(EPISODE_STEPS)]
    assert sum(rewards) > EPISODE_STEPS / 2
    assert env.is_success()
