import numpy as np
import pytest

from deep_curiosity_envs import ManyMotors, PendulumSwingup
from deep_curiosity_envs.many_motors import NUM_MOTORS

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (80, NUM_MOTORS))


def observations(env, actions):
    env.reset(seed=5)
    return np.array([env.step(action)[0] for action in actions])


def test_many_motors_are_one_with_their_mean_command():
    many = observations(ManyMotors(), ACTIONS)
    one = observations(PendulumSwingup(), ACTIONS.mean(1, keepdims=True))
    np.testing.assert_allclose(many, one, rtol=0, atol=1e-5)


def test_equal_commands_have_the_torque_and_the_cost_of_one_motor():
    many, one = ManyMotors(action_cost=0.1), PendulumSwingup(action_cost=0.1)
    for env in (many, one):
        env.reset(seed=5)
    for _ in range(40):
        observation, reward, *_ = many.step(np.full(NUM_MOTORS, 0.7))
        expected, expected_reward, *_ = one.step(np.array([0.7]))
        assert observation == pytest.approx(expected, abs=1e-5)
        assert reward == pytest.approx(expected_reward) == pytest.approx(-0.049)


def test_motors_that_pull_against_each_other_cost_and_do_nothing():
    against = np.where(np.arange(NUM_MOTORS) % 2, 1.0, -1.0)
    fighting, idle = ManyMotors(action_cost=0.1), ManyMotors(action_cost=0.1)
    ends = [observations(fighting, [against] * 40), observations(idle, [0 * against] * 40)]
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-5)
    assert fighting.step(against)[1] == pytest.approx(-0.1)
    assert idle.step(0 * against)[1] == 0.0


def test_every_motor_is_as_good_as_another():
    first, last = np.eye(NUM_MOTORS)[0], np.eye(NUM_MOTORS)[-1]
    ends = [observations(ManyMotors(), [action] * 40) for action in (first, last)]
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-6)
    assert not np.allclose(ends[0], observations(ManyMotors(), [0 * first] * 40))
