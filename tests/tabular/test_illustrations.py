import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from deep_curiosity.tabular.environments import FLIP, STAY, clever_random, reliable_unreliable
from deep_curiosity_envs import ILLUSTRATION_IDS
from deep_curiosity_envs.illustrations import CleverRandom, ReliableUnreliable


def frequency(env, state, action, num_steps=2_000):
    """Share of steps from a state that lead to state 1."""
    env.reset(seed=0)
    arrivals = []
    for _ in range(num_steps):
        env.state = state
        observation, reward, terminated, truncated, _ = env.step(np.array([action], np.float32))
        assert reward == 0 and not terminated and not truncated
        arrivals.append(observation[0])
    return np.mean(arrivals)


def test_both_are_registered_and_end_by_their_time_limit():
    for env_id in ILLUSTRATION_IDS:
        env = gymnasium.make(env_id)
        env.reset(seed=0)
        ends = [env.step(env.action_space.sample())[2:4] for _ in range(100)]
        assert ends == [(False, False)] * 99 + [(False, True)]
    assert ILLUSTRATION_IDS == (
        "deep_curiosity/CleverRandom-v0",
        "deep_curiosity/ReliableUnreliable-v0",
    )


@pytest.mark.parametrize("env", [CleverRandom(), ReliableUnreliable()])
def test_environment_keeps_the_rules_of_gymnasium(env):
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("state", [0, 1])
@pytest.mark.parametrize(("action", "index"), [(0.0, 0), (0.3, 3), (1.0, 10)])
def test_clever_random_moves_as_its_table_says(state, action, index):
    expected = clever_random(11).transition[state, index, 1]
    assert frequency(CleverRandom(), state, action) == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("state", [0, 1])
@pytest.mark.parametrize("action", [STAY, FLIP])
def test_reliable_and_unreliable_move_as_their_table_says(state, action):
    expected = reliable_unreliable().transition[state, action, 1]
    measured = frequency(ReliableUnreliable(), state, float(action))
    assert measured == pytest.approx(expected, abs=0.03)


def test_same_seed_starts_and_flips_alike():
    trajectories = []
    for _ in range(2):
        env = CleverRandom()
        observations = [env.reset(seed=7)[0][0]]
        observations += [env.step(np.array([0.5], np.float32))[0][0] for _ in range(20)]
        trajectories.append(observations)
    assert trajectories[0] == trajectories[1]
