import gymnasium
import numpy as np
import pytest

from deep_curiosity_envs import (
    CartpoleHiddenVelocity,
    CartpoleSwingup,
    PendulumHiddenVelocity,
    PendulumSwingup,
)

PAIRS = [
    (PendulumHiddenVelocity, PendulumSwingup, 2),
    (CartpoleHiddenVelocity, CartpoleSwingup, 3),
]


@pytest.fixture(params=PAIRS, ids=lambda pair: pair[0].__name__)
def pair(request):
    hidden, shown, num_positions = request.param
    return hidden(action_cost=0.1), shown(action_cost=0.1), num_positions


def test_exactly_the_speeds_are_missing(pair):
    hidden, shown, num_positions = pair
    assert np.array_equal(hidden.reset(seed=3)[0], shown.reset(seed=3)[0][:num_positions])
    for action in np.random.default_rng(0).uniform(-1, 1, (60, 1)):
        step, expected = hidden.step(action), shown.step(action)
        assert np.array_equal(step[0], expected[0][:num_positions])
        assert step[1:] == expected[1:]


def test_the_space_is_that_of_the_positions(pair):
    hidden, shown, num_positions = pair
    assert hidden.observation_space.shape == (num_positions,)
    assert shown.observation_space.shape == (num_positions + shown.model.nv,)
    assert np.array_equal(
        hidden.observation_space.high, shown.observation_space.high[:num_positions]
    )


def test_two_states_that_differ_in_speed_look_alike(pair):
    hidden, shown, _ = pair
    for env in (hidden, shown):
        env.reset(seed=0)
    before = hidden.get_observation(), shown.get_observation()
    hidden.qvel[:], shown.qvel[:] = 1.0, 1.0
    assert np.array_equal(hidden.get_observation(), before[0])
    assert not np.array_equal(shown.get_observation(), before[1])


def test_vector_env_hides_it_too():
    envs = gymnasium.make_vec("deep_curiosity/CartpoleHiddenVelocity-v0", num_envs=5)
    assert envs.reset(seed=0)[0].shape == (5, 3)
