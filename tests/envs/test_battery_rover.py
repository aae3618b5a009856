import numpy as np
import pytest

from deep_curiosity_envs import BatteryRover
from deep_curiosity_envs.battery_rover import CHARGER, FORCE_DRAIN, IDLE_DRAIN

IDLE = np.zeros(2, np.float32)


def towards(rover, place):
    """Push towards a place, braking on the way."""
    push = 4 * (np.array(place) - rover.position) - rover.qvel
    return np.clip(push, -1, 1).astype(np.float32)


def test_a_rover_that_comes_home_in_time_lives_and_is_paid_for_what_it_brings():
    rover = BatteryRover()
    rover.reset(seed=0)
    total, drained, energies, away = 0.0, 0.0, [], True
    for _ in range(300):
        energy = float(rover.energy)
        away = energy > 0.95 or (away and energy > 0.5)
        place = (0.5, 0.5) if away else CHARGER
        push = towards(rover, place)
        _, reward, terminated, _, info = rover.step(push)
        total += reward
        drained += IDLE_DRAIN + FORCE_DRAIN * np.square(push).mean()
        energies.append(info["energy"])
        assert not terminated and not info["starved"]
    assert min(energies) < 0.5 and max(energies) == 1.0
    assert info["is_success"]
    assert total * 0.1 == pytest.approx(energies[-1] - 1 + drained)


@pytest.mark.parametrize(
    ("push", "drain"), [((0.0, 0.0), IDLE_DRAIN), ((1.0, -1.0), IDLE_DRAIN + FORCE_DRAIN)]
)
def test_away_from_the_charger_the_battery_drains_until_the_rover_starves(push, drain):
    rover = BatteryRover()
    rover.reset(seed=0)
    rover.qpos[:] = 0.5, 0.0
    energies, terminated = [], False
    while not terminated:
        observation, reward, terminated, _, info = rover.step(np.array(push, np.float32))
        assert reward == 0
        assert observation[4] == pytest.approx(info["energy"], abs=1e-6)
        energies.append(info["energy"])
    assert info["starved"] and info["energy"] == 0
    assert energies[0] == pytest.approx(1 - drain)
    assert len(energies) == pytest.approx(1 / drain, abs=1)


def test_an_empty_battery_is_filled_in_ten_steps_each_paid_in_full():
    rover = BatteryRover()
    rover.reset(seed=0)
    rover.mocap_pos[0, 0] = 0.1
    paid = [rover.step(IDLE)[1] for _ in range(12)]
    assert paid[:9] == [1.0] * 9
    assert 0 < paid[-1] < 0.1
    assert rover.energy == 1.0 and rover.is_success()


def test_a_full_battery_on_the_charger_earns_only_what_it_spends():
    rover = BatteryRover()
    rover.reset(seed=0)
    _, reward, _, _, info = rover.step(IDLE)
    assert reward == pytest.approx(IDLE_DRAIN / 0.1)
    assert info["energy"] == 1.0 and not info["is_success"]
