import math

import numpy as np
import pytest

from deep_curiosity_envs import PointMaze
from deep_curiosity_envs.point_maze import (
    MAZE,
    cell_at,
    cell_centre,
    find_cell,
    reachable_cells,
)

EPISODE_STEPS = 300
CORNERS = [(3, 16), (8, 16), (10, 3), find_cell("G")]  # the turns of the way


@pytest.fixture
def env():
    env = PointMaze(goal_terminates=1.0)  # as the command line gives it
    env.reset(seed=0)
    return env


def drive_to(env, target, num_steps=EPISODE_STEPS, radius=0.15):
    """Pull the point straight to a place or into the goal; yields what every step returns."""
    for _ in range(num_steps):
        if math.dist(env.position, target) < radius or env.is_terminated():
            return
        yield env.step(np.clip(5.0 * np.subtract(target, env.position), -1, 1))


def walk_to_goal(env):
    return [step for corner in CORNERS for step in drive_to(env, cell_centre(corner))]


def test_maze_is_a_closed_rectangle():
    assert {len(line) for line in MAZE} == {20}
    assert set(MAZE[0] + MAZE[-1]) == {"#"}
    assert all(line[0] == line[-1] == "#" for line in MAZE)


def test_every_free_cell_is_reachable_and_counted_once():
    num_free = sum(mark != "#" for line in MAZE for mark in line)
    index = reachable_cells(find_cell("S"))
    assert PointMaze.num_cells == num_free == 296
    assert sorted(index.values()) == list(range(num_free))
    assert index[find_cell("S")] == 0


def test_every_cell_holds_its_centre():
    for cell in reachable_cells(find_cell("S")):
        assert cell_at(*cell_centre(cell)) == cell


def test_episode_starts_at_rest_in_the_start_cell(env):
    _, info = env.reset(seed=3)
    assert info["cell"] == 0
    assert (env.data.qvel == 0.0).all()


def test_observation_is_position_and_velocity(env):
    env.data.qpos[:], env.data.qvel[:] = (0.5, -0.25), (0.1, -1.0)
    assert env.get_observation() == pytest.approx([0.5, -0.25, 0.1, -1.0])


@pytest.mark.parametrize("push", [(-1, 0), (0, 1), (-1, 1), (0, -1), (1, 0), (1, -1)])
def test_walls_stop_the_point(env, push):
    for _ in range(100):
        _, _, _, _, info = env.step(push)
        assert 0 <= info["cell"] < env.num_cells
    assert MAZE[cell_at(*env.position)[0]][cell_at(*env.position)[1]] != "#"


def test_wall_between_the_corridors_holds_against_full_force(env):
    for _ in range(100):
        env.step((0, -1))
    wall_top = cell_centre((6, 1))[1] + 0.05
    assert env.position[1] == pytest.approx(wall_top + 0.03, abs=0.01)


def test_waypoints_reach_the_goal_in_half_an_episode(env):
    steps = walk_to_goal(env)
    rewards = [reward for _, reward, *_ in steps]
    assert rewards == [0.0] * (len(steps) - 1) + [1.0]
    assert [terminated for _, _, terminated, _, _ in steps].index(True) == len(steps) - 1
    assert steps[-1][4]["is_success"]
    assert len(steps) < EPISODE_STEPS / 2


def test_walking_visits_cells_farther_and_farther_from_the_start(env):
    cells = [info["cell"] for *_, info in walk_to_goal(env)]
    assert len(set(cells)) > 40
    assert max(cells) > 0.6 * env.num_cells


def test_goal_may_pay_on_without_ending_the_episode():
    env = PointMaze()
    env.reset(seed=0)
    env.data.qpos[:] = cell_centre(find_cell("G"))
    for _ in range(3):
        _, reward, terminated, _, info = env.step((0, 0))
        assert (reward, terminated, info["is_success"]) == (1.0, False, True)


def test_scripted_walk_earns_twice_what_counts_as_solved_in_the_study():
    env = PointMaze()
    env.reset(seed=0)
    rewards = [reward for _, reward, *_ in walk_to_goal(env)]
    while len(rewards) < EPISODE_STEPS:
        rewards.append(env.step((0, 0))[1])
    assert sum(rewards) == pytest.approx(203, abs=2)


def test_success_is_remembered_after_leaving_the_goal():
    env = PointMaze()
    env.reset(seed=0)
    env.data.qpos[:] = cell_centre(find_cell("G"))
    env.step((0, 0))
    *_, (_, reward, _, _, info) = drive_to(env, cell_centre((18, 12)))
    assert (reward, info["is_success"]) == (0.0, True)
    assert env.reset()[1]["is_success"] is False


def test_white_noise_does_not_find_the_goal(env):
    random = np.random.default_rng(0)
    for step in range(10 * EPISODE_STEPS):
        if step % EPISODE_STEPS == 0:
            env.reset()
        assert env.step(random.uniform(-1, 1, 2))[1] == 0.0
