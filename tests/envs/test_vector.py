"""A vector environment is its single environment, many times over."""

import pickle
from copy import deepcopy

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deep_curiosity_envs import TASK_IDS, MujocoVectorEnv, PendulumSwingup, PointMaze
from deep_curiosity_envs.point_maze import cell_centre, find_cell

NUM_ENVS = 4
NUM_STEPS = 420  # longer than any episode
CONTACT_TOLERANCE = (
    1e-5  # of float32 observations, where contact forces are computed without a warm start
)


@pytest.fixture(params=TASK_IDS)
def task_id(request):
    return request.param


def make(task_id, num_envs=NUM_ENVS, **kwargs):
    mode = "vector_entry_point"
    return gymnasium.make_vec(task_id, num_envs=num_envs, vectorization_mode=mode, **kwargs)


def make_reference(task_id, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs):
    return SyncVectorEnv(
        [lambda: gymnasium.make(task_id, disable_env_checker=True, **kwargs)] * NUM_ENVS,
        autoreset_mode=autoreset_mode,
    )


def pushes(environment, num_steps=NUM_STEPS):
    """Random actions, some environments pushing one way for long, so that walls are met."""
    random = np.random.default_rng(0)
    actions = random.uniform(-1.5, 1.5, (num_steps, *environment.action_space.shape))
    actions[:, NUM_ENVS // 2 :] = np.repeat(np.sign(actions[::20, NUM_ENVS // 2 :]), 20, axis=0)
    return actions.astype(np.float32)


def assert_same(one, other, tolerance=CONTACT_TOLERANCE):
    """Equal structure, kinds and values, but for what contact leaves open."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key], tolerance)
    elif one is not None and one.dtype == object:
        for row, other_row in zip(one, other, strict=True):
            assert_same(row, other_row, tolerance)
    elif one is not None:
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance)


def place_in_goal(environment, index):
    environment._batched_task.qpos[index] = cell_centre(find_cell("G"))


@pytest.mark.parametrize("action_cost", [0.0, 0.1])
def test_every_step_is_that_of_the_single_environments(task_id, action_cost):
    native = make(task_id, action_cost=action_cost)
    reference = make_reference(task_id, action_cost=action_cost)
    assert_same(native.reset(seed=7)[0], reference.reset(seed=7)[0])
    num_ended = 0
    for action in pushes(native):
        step, expected = native.step(action), reference.step(action)
        num_ended += (step[2] | step[3]).sum()
        for one, other in zip(step, expected, strict=True):
            assert_same(one, other)
    assert num_ended >= NUM_ENVS


def test_without_contact_every_bit_is_that_of_the_single_environment():
    native, single = make("deep_curiosity/PendulumSwingup-v0", 1), PendulumSwingup()
    assert np.array_equal(native.reset(seed=3)[0][0], single.reset(seed=3)[0])
    for action in np.random.default_rng(0).uniform(-1, 1, (150, 1, 1)):
        assert np.array_equal(native.step(action)[0][0], single.step(action[0])[0])
        assert np.array_equal(native._batched_task.qpos[0], single.data.qpos)


def test_spaces_are_those_of_gymnasium(task_id):
    native, reference = make(task_id), make_reference(task_id)
    for name in ("single_observation_space", "single_action_space"):
        assert getattr(native, name) == getattr(reference, name)
    assert native.observation_space == reference.observation_space
    assert native.action_space == reference.action_space
    assert native.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert native.spec.id == task_id


def test_same_seed_gives_the_same_bits_and_another_seed_others(task_id):
    native, again = make(task_id), make(task_id)
    starts = [environment.reset(seed=1)[0] for environment in (native, again)]
    assert np.array_equal(*starts)
    for action in pushes(native):
        assert np.array_equal(native.step(action)[0], again.step(action)[0])
    assert (native.reset(seed=[7, 8, 9, 10])[0] == again.reset(seed=7)[0]).all()
    assert (native.reset()[0] != again.reset(seed=8)[0]).any(-1).all()


def test_a_goal_that_ends_the_episode_shows_the_end_and_starts_the_next():
    native = make("deep_curiosity/PointMaze-v0", goal_terminates=True)
    native.reset(seed=0)
    place_in_goal(native, 2)
    observation, reward, terminated, truncated, infos = native.step(np.zeros((NUM_ENVS, 2)))
    assert reward.tolist() == terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    assert infos["final_obs"][2] == pytest.approx([*cell_centre(find_cell("G")), 0, 0])
    assert infos["final_obs"][1] is None
    assert infos["final_info"]["is_success"].tolist() == [False, False, True, False]
    assert observation[2, :2] == pytest.approx(cell_centre(find_cell("S")), abs=0.03)
    assert not infos["is_success"].any()
    assert infos["cell"].tolist() == [0] * NUM_ENVS
    assert not native.step(np.zeros((NUM_ENVS, 2)))[2].any()


def test_success_is_remembered_in_its_own_env_until_the_reset():
    native = make("deep_curiosity/PointMaze-v0")
    native.reset(seed=0)
    place_in_goal(native, 1)
    native.step(np.zeros((NUM_ENVS, 2)))
    native._batched_task.qpos[1] = cell_centre(find_cell("S"))
    *_, infos = native.step(np.zeros((NUM_ENVS, 2)))
    assert infos["is_success"].tolist() == [False, True, False, False]
    assert not native.reset()[1]["is_success"].any()


def test_without_autoreset_the_mask_says_who_starts_anew():
    task_id = "deep_curiosity/ReacherSparse-v0"
    native = make(task_id, autoreset_mode=AutoresetMode.DISABLED)
    reference = make_reference(task_id, AutoresetMode.DISABLED)
    for environment in (native, reference):
        environment.reset(seed=0)
    action = pushes(native, 100)
    for number in range(100):
        step, expected = native.step(action[number]), reference.step(action[number])
    for one, other in zip(step, expected, strict=True):
        assert_same(one, other)
    assert step[3].all() and "final_obs" not in step[4]
    mask, seed = np.array([True, False, False, True]), [5, None, None, 6]
    resets = [env.reset(seed=seed, options={"reset_mask": mask}) for env in (native, reference)]
    for one, other in zip(*resets, strict=True):
        assert_same(one, other)
    assert native.step(action[0])[3].tolist() == [False, True, True, False]


def test_what_was_returned_stays_as_it_was(task_id):
    native = make(task_id)
    returned = [*native.reset(seed=0)[:1], *native.step(pushes(native)[0])[:4]]
    before = [array.copy() for array in returned]
    for action in pushes(native, 20):
        native.step(action)
    for array, copy in zip(returned, before, strict=True):
        assert np.array_equal(array, copy)


def test_envs_do_not_touch_each_other(task_id):
    many, few = make(task_id), make(task_id, 2)
    many.reset(seed=0)
    few.reset(seed=0)
    for action in pushes(many, 120):
        assert np.array_equal(many.step(action)[0][:2], few.step(action[:2])[0])


@pytest.mark.parametrize("mode", ["SameStep", AutoresetMode.DISABLED], ids=str)
def test_no_step_goes_before_the_reset_of_every_env(task_id, mode):
    native = make(task_id, autoreset_mode=mode)
    action = np.zeros(native.action_space.shape)
    with pytest.raises(
        ResetNeeded, match=r"`reset` must .*, got none in environments \[0, 1, 2, 3\]"
    ):
        native.step(action)
    native.reset(seed=0, options={"reset_mask": np.array([True, False, False, True])})
    with pytest.raises(ResetNeeded, match=r"`reset` must .*, got none in environments \[1, 2\]"):
        native.step(action)
    native.reset(seed=0, options={"reset_mask": np.array([False, True, True, False])})
    native.step(action)
    native.reset(seed=0, options={"reset_mask": np.array([True, False, False, False])})
    native.step(action)


@pytest.mark.parametrize("copied", [deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_the_env_would_and_leaves_it_alone(task_id, copied):
    native = make(task_id, max_episode_steps=40)  # so that the next episodes are compared too
    native.reset(seed=0)
    actions = pushes(native, 100)
    for action in actions[:30]:
        native.step(action)
    twin = copied(native)
    courses = [[env.step(action) for action in actions[30:]] for env in (twin, native)]
    for step, expected in zip(*courses, strict=True):
        for one, other in zip(step, expected, strict=True):
            assert_same(one, other, tolerance=0)
    native.close()
    twin.step(actions[0])
    twin.close()


def test_a_copy_remembers_success_and_how_long_it_has_lasted():
    native = make("deep_curiosity/BatteryRover-v0")
    native.reset(seed=0)
    native._batched_task.success_streak.update(np.array([True, False, False, False]))
    native._batched_task.success_streak.achieved[1] = True
    twin = deepcopy(native)
    for _ in range(4):
        twin._batched_task.success_streak.update(np.array([True] * NUM_ENVS))
    assert twin._batched_task.is_success().tolist() == [True, True, False, False]
    assert native._batched_task.is_success().tolist() == [False, True, False, False]


def test_a_copy_before_the_reset_waits_for_it():
    twin = deepcopy(make("deep_curiosity/PendulumSwingup-v0"))
    with pytest.raises(ResetNeeded):
        twin.step(np.zeros((NUM_ENVS, 1)))


def test_the_clock_of_mujoco_runs_on_for_others():
    native = make("deep_curiosity/PendulumSwingup-v0")
    native.reset(seed=0)
    native.step(np.zeros((NUM_ENVS, 1)))
    data = PendulumSwingup().data
    mujoco.mj_step(PendulumSwingup().model, data)
    assert data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration > 0


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"num_envs": 0}, "`num_envs` must be a whole number of at least 1, got 0"),
        ({"num_envs": 1.5}, "`num_envs` must be a whole number of at least 1, got 1.5"),
        ({"num_envs": "2"}, "`num_envs` must be a whole number of at least 1, got '2'"),
        ({"max_episode_steps": 0}, "`max_episode_steps` must be a whole number of .*, got 0"),
        ({"max_episode_steps": 1.5}, "`max_episode_steps` must be a whole number of .*, got 1.5"),
        (
            {"max_episode_steps": True},
            "`max_episode_steps` must be a whole number of .*, got True",
        ),
        (
            {"autoreset_mode": AutoresetMode.NEXT_STEP},
            "`autoreset_mode` must be 'SameStep' or 'Disabled', got <AutoresetMode.NEXT_STEP",
        ),
        (
            {"autoreset_mode": "foo"},
            "`autoreset_mode` must be 'SameStep' or 'Disabled', got 'foo'",
        ),
        ({"action_cost": -1.0}, "`action_cost` must be a finite number and not negative, got -1"),
    ],
    ids=str,
)
def test_what_has_no_meaning_is_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        MujocoVectorEnv(PointMaze, **{"num_envs": 2, **kwargs})


def test_bad_actions_seeds_and_masks_are_named(task_id):
    native = make(task_id)
    native.reset(seed=0)
    with pytest.raises(ValueError, match=r"`action` must have shape \(4, .+\), got shape \(7,\)"):
        native.step(np.zeros(7))
    with pytest.raises(ValueError, match="`action` must be finite"):
        native.step(np.full(native.action_space.shape, np.nan))
    with pytest.raises(ValueError, match=r"`action` must have shape \(4, .+\), got \[\[0.0\], "):
        native.step([[0.0], *[[0.0, 0.0, 0.0]] * 3])
    for value in ("0.5", 0.5j):
        with pytest.raises(ValueError, match="`action` must hold real numbers, got "):
            native.step(np.full(native.action_space.shape, value))
    with pytest.raises(ValueError, match="`seed` must have 4 entries, got 2"):
        native.reset(seed=[0, 1])
    with pytest.raises(ValueError, match=r"`reset_mask` must hold 4 booleans, got bool \(2,\)"):
        native.reset(options={"reset_mask": np.array([True, False])})
    native.close()
    native.close()
