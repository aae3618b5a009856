from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deep_curiosity.integrations.trainer import LearnerIntegration
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_environment, make_vector_environment
from deep_curiosity.training.frame_stack import FrameStack, VectorFrameStack
from deep_curiosity.training.parts import make_run_bonus


class Counter(gymnasium.Env):
    """Shows the seed of its episode and the count of its steps; an episode has three."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        self.seed, self.count = seed, 0
        return self._observation(), {}

    def step(self, action):
        self.count += 1
        return self._observation(), 0.0, False, self.count == 3, {}

    def _observation(self):
        return np.array([self.seed, self.count], np.float32)


def counters(num_envs, mode=AutoresetMode.DISABLED):
    return SyncVectorEnv([Counter] * num_envs, autoreset_mode=mode)


def act(*values):
    return np.array(values, np.float32)


def test_windows_of_two_episodes():
    env = FrameStack(Counter(), 3)
    for seed in (7, 8):
        first, _ = env.reset(seed=seed)
        assert first.tolist() == [seed, 0, 0, seed, 0, 0, seed, 0]
        steps = [env.step(act(action)) for action in (0.25, -0.5, 5.0)]
        assert [step[0].tolist() for step in steps] == [
            [seed, 0, 0, seed, 0, 0.25, seed, 1],
            [seed, 0, 0.25, seed, 1, -0.5, seed, 2],
            [seed, 1, -0.5, seed, 2, 1.0, seed, 3],  # the action is as the space clips it
        ]
        assert [step[3] for step in steps] == [False, False, True]


def test_only_environments_that_are_reset_begin_anew():
    environments = VectorFrameStack(counters(3), 2)
    environments.reset(seed=[1, 2, 3])
    for action in (0.25, 0.5, 0.75):
        window = environments.step(np.full((3, 1), action, np.float32))[0]
    assert window.tolist() == [[seed, 2, 0.75, seed, 3] for seed in (1, 2, 3)]
    mask = np.array([False, True, True])
    window, _ = environments.reset(seed=[None, 5, 6], options={"reset_mask": mask})
    assert window.tolist() == [[1, 2, 0.75, 1, 3], [5, 0, 0, 5, 0], [6, 0, 0, 6, 0]]


def test_without_a_past_a_window_is_the_observation():
    env = FrameStack(Counter(), 1)
    assert env.reset(seed=4)[0].tolist() == [4, 0]
    assert env.step(act(0.5))[0].tolist() == [4, 1]
    assert env.observation_space == Counter.observation_space


def test_what_was_returned_stays_as_it_was():
    for env, action in ((FrameStack(Counter(), 2), act(0.5)), (counters(2), act(0.5, 0.5))):
        env = env if isinstance(env, FrameStack) else VectorFrameStack(env, 2)
        returned = [env.reset(seed=0)[0], env.step(action.reshape(env.action_space.shape))[0]]
        before = [window.copy() for window in returned]
        env.step(-action.reshape(env.action_space.shape))
        assert all(np.array_equal(*pair) for pair in zip(returned, before, strict=True))


@pytest.mark.parametrize("vectorization", ["native", "sync", "async"])
def test_several_environments_have_the_windows_of_single_ones(vectorization):
    single = EnvironmentConfig("ReacherSparse", {"action_cost": 0.1}, frame_stack=3)
    environments = make_vector_environment(
        replace(single, num_envs=2, vectorization=vectorization)
    )
    collector = Collector(environments, seed=0)
    singles = [make_environment(single) for _ in range(2)]
    random, starts = np.random.default_rng(0), []
    for step in range(220):  # two episodes and some of the third
        if step % 100 == 0:
            starts = [_seed(step // 100 * 2 + index) for index in range(2)]
            first = [env.reset(seed=seed)[0] for env, seed in zip(singles, starts, strict=True)]
            assert np.array_equal(collector.observation, first)
        action = random.uniform(-1, 1, (2, 2)).astype(np.float32)
        taken = collector.step(action)[0]
        expected = [env.step(row)[0] for env, row in zip(singles, action, strict=True)]
        np.testing.assert_allclose(taken.next_observation, expected, rtol=0, atol=1e-6)
    assert environments.single_observation_space == singles[0].observation_space
    assert environments.single_observation_space.contains(taken.next_observation[0])
    environments.close()


def _seed(number):
    return int(np.random.SeedSequence((0, number)).generate_state(1)[0])


@pytest.mark.parametrize(("frame_stack", "size"), [(1, 2), (2, 5), (4, 11)])
def test_the_space_grows_with_the_frame_stack(frame_stack, size):
    config = EnvironmentConfig("PendulumHiddenVelocity", frame_stack=frame_stack)
    one = make_environment(config)
    several = make_vector_environment(replace(config, num_envs=2))
    assert one.observation_space.shape == (size,)
    assert one.observation_space.contains(one.reset(seed=0)[0])
    assert several.observation_space.shape == (2, size)
    assert several.single_observation_space == one.observation_space


def test_the_space_keeps_the_precision_of_the_observation():
    env = make_environment(EnvironmentConfig("InvertedPendulum-v5", frame_stack=2))
    window, _ = env.reset(seed=0)
    assert window.dtype == env.observation_space.dtype == np.float64
    assert env.step(act(0.5))[0].dtype == np.float64
    env.close()


def test_what_is_no_vector_is_rejected():
    class Named(Counter):
        observation_space = spaces.Dict({"count": Counter.observation_space})

    with pytest.raises(ValueError, match=r"`env` must have boxes of vectors .*, got Dict"):
        FrameStack(Named(), 2)


def test_a_stack_without_an_observation_is_rejected():
    with pytest.raises(ValueError, match="`num_frames` must be at least 1, got 0"):
        FrameStack(Counter(), 0)
    with pytest.raises(ValueError, match="`num_frames` must be at least 1, got 0"):
        VectorFrameStack(counters(2), 0)
    with pytest.raises(ValueError, match="`frame_stack` must be at least 1, got 0"):
        EnvironmentConfig("PointMaze", num_envs=2, frame_stack=0)


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_environments_that_reset_by_themselves_are_rejected(mode):
    with pytest.raises(ValueError, match="`env` must have its autoreset disabled, got"):
        VectorFrameStack(counters(2, mode), 2)


def test_the_check_has_the_same_window(tiny):
    agent = LearnerIntegration(tiny.override(frame_stack=3))
    assert agent.collect(5, seed=0).observation.shape == (5, 3 * 3 + 2 * 1)


@pytest.mark.parametrize(
    ("frame_stack", "settings", "entries"),
    [
        (1, {}, None),
        (1, {"features": (0, -1)}, [0, 2]),
        (3, {}, [4, 5, 6, 8, 9, 10]),
        (3, {"features": (0, 1)}, [8, 9]),
        (3, {"features": (0, -1)}, [8, 10]),
        (3, {"features": (0, -1), "features_of": "window"}, [0, 10]),
    ],
)
def test_curiosity_is_about_the_newest_observations_of_a_window(
    tiny, frame_stack, settings, entries
):
    """Of three entries, with one action between two observations."""
    config = tiny.override(frame_stack=frame_stack, **settings)
    bonus = make_run_bonus(config, 3 * frame_stack + frame_stack - 1, 1)
    assert bonus.entries == entries


def test_what_is_no_entry_of_an_observation_is_none_of_its_window(tiny):
    for features in ((3,), (-4,), (0, -3)):
        config = tiny.override(frame_stack=3, features=features)
        with pytest.raises(ValueError, match="`features` must name different entries of 3, got"):
            make_run_bonus(config, 11, 1)


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int64])
def test_a_window_over_whole_numbers_has_room_for_actions(dtype):
    class Whole(Counter):
        observation_space = spaces.Box(0, 100, (2,), dtype)

        def reset(self, *, seed=None, options=None):
            observation, info = super().reset(seed=seed)
            return observation.astype(dtype), info

        def step(self, action):
            observation, *rest = super().step(action)
            return observation.astype(dtype), *rest

    env = FrameStack(Whole(), 2)
    assert env.reset(seed=4)[0].tolist() == [4, 0, 0, 4, 0]
    window = env.step(act(-0.5))[0]
    assert window.tolist() == [4, 0, -0.5, 4, 1]
    assert env.observation_space.contains(window)
