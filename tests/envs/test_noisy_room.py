import gymnasium
import numpy as np
import pytest

from deep_curiosity_envs import NoisyRoom
from deep_curiosity_envs.noisy_room import split_mix

EPISODE_STEPS = 300
CHANNELS = slice(4, 6)
IN_CORNER, OUTSIDE = (0.7, 0.7), (-0.3, 0.7)


@pytest.fixture
def env():
    env = NoisyRoom()
    env.reset(seed=0)
    return env


def stay(env, place, num_steps, seed=0):
    """Values of the channels while the point rests at a place."""
    env.reset(seed=seed)
    env.qpos[:] = place
    idle = np.zeros(env.action_space.shape)
    return np.array([env.step(idle)[0][CHANNELS] for _ in range(num_steps)])


def test_the_stream_of_bits_is_split_mix_64():
    bits = split_mix(np.array([1234567], np.uint64), np.arange(3, dtype=np.uint64))
    assert bits.tolist() == [6457827717110365317, 3203168211198807973, 9817491932198370423]


@pytest.mark.parametrize(
    ("place", "noisy"),
    [
        (IN_CORNER, True),
        ((0.41, 0.41), True),
        ((0.96, 0.96), True),
        ((0.39, 0.9), False),
        ((0.9, 0.39), False),
        (OUTSIDE, False),
        ((-0.7, -0.7), False),
    ],
)
def test_only_the_corner_is_noisy(env, place, noisy):
    env.qpos[:] = place
    observation, _, _, _, info = env.step((0, 0))
    assert info["noisy"] is noisy
    assert (observation[CHANNELS] != 0).all() == (observation[CHANNELS] != 0).any() == noisy


def test_the_share_of_noisy_cells_is_what_it_says(env):
    noisy_cells = set()
    centres = np.arange(-0.9, 1.0, 0.2)
    for x in centres:
        for y in centres:
            env.qpos[:] = x, y
            noisy_cells |= {int(env.cell)} if env.noisy else set()
    assert len(noisy_cells) / env.num_cells == env.noisy_share == 0.09


def test_noise_is_uniform_and_independent_over_steps_channels_and_episodes(env):
    noise = stay(env, IN_CORNER, 4000)
    assert noise.min() < -0.99 and 0.99 < noise.max() < 1
    assert noise.mean(0) == pytest.approx([0, 0], abs=0.04)
    assert noise.var(0) == pytest.approx([1 / 3, 1 / 3], abs=0.02)
    others = stay(env, IN_CORNER, 4000, seed=1)
    for one, other in [
        (noise[:-1], noise[1:]),
        (noise[:-7], noise[7:]),
        (noise[:, :1], noise[:, 1:]),
        (noise[:-1, :1], noise[1:, 1:]),
        (noise, others),
    ]:
        correlation = np.corrcoef(one.ravel(), other.ravel())[0, 1]
        assert correlation == pytest.approx(0, abs=0.06)


def test_noise_is_the_same_for_the_same_seed_whatever_came_before(env):
    noise = stay(env, IN_CORNER, 20, seed=5)
    assert np.array_equal(stay(env, IN_CORNER, 20, seed=5), noise)
    assert np.array_equal(stay(NoisyRoom(), IN_CORNER, 20, seed=5), noise)
    assert not np.isin(stay(env, IN_CORNER, 20, seed=6), noise).any()


def test_looking_twice_shows_the_same_noise(env):
    env.qpos[:] = IN_CORNER
    assert np.array_equal(env.step((0, 0))[0], env.observe())


def test_envs_side_by_side_have_noise_of_their_own():
    envs = gymnasium.make_vec("deep_curiosity/NoisyRoom-v0", num_envs=3)
    envs.reset(seed=4)
    envs._batched_task.qpos[:] = IN_CORNER, OUTSIDE, IN_CORNER
    channels = np.array([envs.step(np.zeros((3, 2)))[0][:, CHANNELS] for _ in range(20)])
    assert np.array_equal(channels[:, 0], stay(NoisyRoom(), IN_CORNER, 20, seed=4))
    assert (channels[:, 1] == 0).all()
    assert np.array_equal(channels[:, 2], stay(NoisyRoom(), IN_CORNER, 20, seed=6))


def test_nothing_pays_and_nothing_succeeds(env):
    for action in np.random.default_rng(0).uniform(-1, 1, (EPISODE_STEPS, 2)):
        _, reward, terminated, _, info = env.step(action)
        assert (reward, terminated, info["is_success"]) == (0.0, False, False)


def test_driving_into_the_corner_ends_at_its_walls(env):
    for _ in range(60):
        info = env.step((1, 1))[4]
    assert env.position == pytest.approx([0.97, 0.97], abs=0.01)
    assert (info["noisy"], info["cell"]) == (True, 9)


@pytest.mark.parametrize(
    ("place", "cell"),
    [((-0.95, 0.95), 0), ((0.95, 0.95), 9), ((-0.75, 0.75), 11), ((0.95, -0.95), 99)],
)
def test_cells_are_numbered_in_rows_from_the_top_left(env, place, cell):
    env.qpos[:] = place
    assert env.step((0, 0))[4]["cell"] == cell


def test_no_push_leaves_the_cells(env):
    for push in [(1, 0), (-1, 1), (0, -1), (1, -1), (-1, -1)] * 2:
        for _ in range(60):
            assert 0 <= env.step(push)[4]["cell"] < env.num_cells
            assert np.abs(env.position).max() < 1.0


def test_the_switch_makes_noise_anywhere_and_only_while_it_is_on():
    env = NoisyRoom(switch=True)
    _, info = env.reset(seed=0)
    assert env.action_space.shape == (3,)
    assert info["noisy"] is False
    for place in (IN_CORNER, OUTSIDE):
        env.qpos[:] = place
        for push in (0.5, -0.5, 0.01, 0.0):
            observation, _, _, _, info = env.step((0, 0, push))
            assert info["noisy"] is (push > 0)
            assert (observation[CHANNELS] != 0).all() == (push > 0)


def test_the_switch_pushes_nothing():
    env, other = NoisyRoom(switch=True), NoisyRoom()
    env.reset(seed=0)
    other.reset(seed=0)
    for action in np.random.default_rng(0).uniform(-1, 1, (50, 3)):
        assert np.array_equal(env.step(action)[0][:4], other.step(action[:2])[0][:4])


def test_envs_side_by_side_have_switches_of_their_own():
    envs = gymnasium.make_vec("deep_curiosity/NoisyRoom-v0", num_envs=3, switch=True)
    envs.reset(seed=0)
    singles = [NoisyRoom(switch=True) for _ in range(3)]
    for seed, single in enumerate(singles):
        single.reset(seed=seed)
    for action in np.random.default_rng(0).uniform(-1, 1, (30, 3, 3)):
        observation, *_, infos = envs.step(action)
        assert infos["noisy"].tolist() == (action[:, 2] > 0).tolist()
        expected = [single.step(row)[0] for single, row in zip(singles, action, strict=True)]
        assert np.array_equal(observation, expected)
