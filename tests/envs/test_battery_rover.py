import gymnasium
import numpy as np
import pytest

from deep_curiosity_envs import BatteryRover
from deep_curiosity_envs.battery_rover import CHARGE_PER_STEP, CHARGER_POSITION, DRAIN_PER_STEP

EPISODE_STEPS = 400
FAR_AWAY = (-0.7, -0.7)


@pytest.fixture
def env():
    env = BatteryRover()
    env.reset(seed=0)
    return env


def drive_to(env, target):
    """Push of a spring towards a place."""
    return np.clip(5.0 * np.subtract(target, env.position), -1, 1)


class Prudent:
    """Stays in the far corner until half of the battery is left, then charges."""

    def __init__(self):
        self.charging = False

    def __call__(self, env):
        self.charging = env.energy < (0.95 if self.charging else 0.5)
        return drive_to(env, CHARGER_POSITION if self.charging else FAR_AWAY)


def run_episode(env, controller, num_steps=EPISODE_STEPS):
    """Rewards of an episode, what it drained in batteries, and its last info."""
    rewards, drained, info = [], 0.0, {}
    for _ in range(num_steps):
        action = np.asarray(controller(env), dtype=float)
        _, reward, terminated, _, info = env.step(action)
        rewards.append(reward)
        drained += 0 if env.on_charger else DRAIN_PER_STEP * (1 + np.square(action).mean())
        if terminated:
            break
    return np.array(rewards), drained, info


def test_an_episode_starts_in_the_middle_with_a_full_battery(env):
    observation, info = env.reset(seed=3)
    assert observation[:2] == pytest.approx([0, 0], abs=0.05)
    assert observation[2:].tolist() == [0.0, 0.0, 1.0]
    assert (info["energy"], info["starved"], info["is_success"]) == (1.0, False, False)


@pytest.mark.parametrize(("push", "num_steps"), [((0, 0), 200), ((-1, -1), 100), ((0, -1), 134)])
def test_a_battery_lasts_by_what_is_done_with_it(env, push, num_steps):
    rewards, _, info = run_episode(env, lambda env: push)
    assert len(rewards) == pytest.approx(num_steps, abs=1)
    assert (info["energy"], info["starved"], info["is_success"]) == (0.0, True, False)
    assert not rewards.any()


def test_random_pushes_starve():
    env = BatteryRover()
    random = np.random.default_rng(0)
    lengths = []
    for seed in range(10):
        env.reset(seed=seed)
        lengths.append(len(run_episode(env, lambda env: random.uniform(-1, 1, 2))[0]))
    assert np.median(lengths) == pytest.approx(150, abs=5)
    assert max(lengths) < EPISODE_STEPS


def test_a_rover_that_goes_back_in_time_survives_and_is_paid_for_what_it_charges(env):
    rewards, drained, info = run_episode(env, Prudent())
    assert len(rewards) == EPISODE_STEPS
    assert (info["starved"], info["is_success"]) == (False, True)
    assert rewards.sum() > 15
    assert info["energy"] == pytest.approx(1 - drained + CHARGE_PER_STEP * rewards.sum())


def test_a_rover_that_turns_back_too_late_starves(env):
    late = lambda env: drive_to(env, CHARGER_POSITION if env.energy < 0.1 else FAR_AWAY)  # noqa: E731
    rewards, _, info = run_episode(env, late)
    assert len(rewards) < EPISODE_STEPS
    assert info["starved"]


def test_charging_takes_ten_steps_and_pays_one_for_each(env):
    env.qpos[:], env.userdata[0] = CHARGER_POSITION, 1e-6
    steps = [env.step((0, 0)) for _ in range(12)]
    rewards = [reward for _, reward, *_ in steps]
    assert rewards[:9] == [1.0] * 9
    assert rewards[9] == pytest.approx(1.0, abs=1e-4)
    assert rewards[10:] == [0.0, 0.0]
    assert steps[-1][0][-1] == steps[-1][4]["energy"] == 1.0


def test_the_last_gap_is_paid_by_its_size(env):
    env.qpos[:], env.userdata[0] = CHARGER_POSITION, 0.97
    assert env.step((0, 0))[1] == pytest.approx(0.3)


@pytest.mark.parametrize(("offset", "charges"), [(0.19, True), (0.21, False)])
def test_only_the_disc_charges(env, offset, charges):
    env.qpos[:], env.userdata[0] = (CHARGER_POSITION[0] - offset, CHARGER_POSITION[1]), 0.5
    _, reward, *_, info = env.step((0, 0))
    assert reward == float(charges)
    assert info["energy"] == pytest.approx(0.6 if charges else 0.495)


def test_success_needs_half_a_battery_in_one_go(env):
    env.qpos[:], env.userdata[0] = CHARGER_POSITION, 0.55
    assert not any(env.step((0, 0))[4]["is_success"] for _ in range(8))
    env.userdata[0] = 0.45
    successes = [env.step((0, 0))[4]["is_success"] for _ in range(6)]
    assert successes == [False] * 4 + [True] * 2


def test_the_observation_is_position_velocity_and_energy(env):
    env.qpos[:], env.qvel[:], env.userdata[0] = (0.5, -0.25), (0.1, -1.0), 0.75
    assert env.get_observation() == pytest.approx([0.5, -0.25, 0.1, -1.0, 0.75])


def test_every_env_has_a_battery_of_its_own():
    envs = gymnasium.make_vec("deep_curiosity/BatteryRover-v0", num_envs=3)
    envs.reset(seed=0)
    envs._batched_task.qpos[1] = CHARGER_POSITION
    envs._batched_task.userdata[:, 0] = 0.5, 0.5, 0.004
    _, reward, terminated, _, infos = envs.step(np.zeros((3, 2)))
    assert reward.tolist() == [0.0, 1.0, 0.0]
    assert terminated.tolist() == [False, False, True]
    assert infos["final_info"]["starved"].tolist() == [False, False, True]
    assert infos["energy"] == pytest.approx([0.495, 0.6, 1.0])
