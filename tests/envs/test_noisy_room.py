import numpy as np
import pytest

from deep_curiosity_envs import NoisyRoom
from deep_curiosity_envs.noisy_room import NOISY_FROM

CORNER, ELSEWHERE = (0.8, 0.8), (0.8, 0.0)


def watched(room, place, num_steps=200, action=(0.0, 0.0)):
    """Noise channels and infos of a point that is held in a place."""
    channels, infos = [], []
    for _ in range(num_steps):
        room.qpos[:], room.qvel[:] = place, 0
        observation, reward, terminated, _, info = room.step(np.array(action, np.float32))
        assert reward == 0 and not terminated
        channels.append(observation[4:])
        infos.append(info)
    return np.array(channels), infos


def test_the_corner_alone_is_noisy():
    room = NoisyRoom()
    room.reset(seed=0)
    noise, infos = watched(room, CORNER)
    assert all(info["noisy"] for info in infos)
    assert (noise != 0).all()
    silence, infos = watched(room, ELSEWHERE)
    assert not any(info["noisy"] for info in infos)
    assert (silence == 0).all()


def test_the_noise_is_uniform_and_drawn_anew_at_every_step_in_both_channels():
    room = NoisyRoom()
    room.reset(seed=0)
    noise, _ = watched(room, CORNER, 2_000)
    assert len(np.unique(noise)) == noise.size
    assert np.abs(noise.mean(0)).max() < 0.05
    assert noise.std(0) == pytest.approx([3**-0.5] * 2, rel=0.05)
    now, later = noise[:-1], noise[1:]
    assert abs(np.corrcoef(now[:, 0], later[:, 0])[0, 1]) < 0.07
    assert abs(np.corrcoef(noise[:, 0], noise[:, 1])[0, 1]) < 0.07


def test_an_episode_has_a_noise_of_its_own_that_its_seed_repeats():
    room = NoisyRoom()
    courses = []
    for seed in (1, 1, 2):
        room.reset(seed=seed)
        courses.append(watched(room, CORNER)[0])
    assert np.array_equal(courses[0], courses[1])
    assert (courses[0] != courses[2]).all()


def test_the_cells_in_the_corner_are_the_share_that_is_told():
    room = NoisyRoom()
    room.reset(seed=0)
    centres = np.arange(10) * 0.2 - 0.9
    noisy = cells = 0
    seen = set()
    for x in centres:
        for y in centres:
            room.qpos[:] = x, y
            noisy, cells = noisy + int(room.noisy), cells + 1
            seen.add(int(room.cell))
    assert noisy / cells == NoisyRoom.noisy_share
    assert seen == set(range(NoisyRoom.num_cells))
    assert pytest.approx(0.4) == NOISY_FROM


def test_a_switch_turns_the_noise_on_wherever_the_point_is():
    room = NoisyRoom(switch=True)
    room.reset(seed=0)
    assert room.action_space.shape == (3,)
    noise, infos = watched(room, ELSEWHERE, action=(0.0, 0.0, 0.5))
    assert (noise != 0).all() and all(info["noisy"] for info in infos)
    silence, infos = watched(room, CORNER, action=(0.0, 0.0, -0.5))
    assert (silence == 0).all() and not any(info["noisy"] for info in infos)


def test_the_switch_pushes_nothing():
    places = []
    for switch in (-1.0, 1.0):
        room = NoisyRoom(switch=True)
        room.reset(seed=0)
        for _ in range(20):
            room.step(np.array([0.5, -0.5, switch], np.float32))
        places.append(room.position.copy())
    assert np.array_equal(*places)
    assert places[0][0] > 0.2 > -0.2 > places[0][1]
