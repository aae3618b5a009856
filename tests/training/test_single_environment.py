import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.single_environment import SingleEnvironment


class Talkative(gymnasium.Env):
    """Has infos of many kinds, and shows the same array at every step."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    closed = False

    def __init__(self):
        self.state = np.zeros(2, np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state[:] = seed or 0
        return self.state, {"cell": 3}

    def step(self, action):
        self.state += action
        infos = {
            "goal": np.ones(2),
            "is_success": True,
            "energy": 0.5,
            "word": "yes",
            "pair": (1,),
        }
        return self.state, 1, True, False, infos

    def close(self):
        self.closed = True


def test_it_is_stepped_as_gymnasiums_vector_of_one():
    config = EnvironmentConfig("PointMaze")
    single = SingleEnvironment(make_environment(config))
    vector = SyncVectorEnv(
        [lambda: make_environment(config)], autoreset_mode=AutoresetMode.DISABLED
    )
    assert single.observation_space == vector.observation_space
    assert single.action_space == vector.action_space
    assert single.single_action_space == vector.single_action_space
    mask = np.ones(1, dtype=bool)
    for _ in range(2):
        first, _ = single.reset(seed=[4], options={"reset_mask": mask})
        expected, _ = vector.reset(seed=[4], options={"reset_mask": mask})
        assert np.array_equal(first, expected)
        for action in np.linspace(-1, 1, 20, dtype=np.float32):
            action = np.full((1, 2), action)
            taken, others = single.step(action), vector.step(action)
            for value, other in zip(taken[:4], others[:4], strict=True):
                assert np.array_equal(value, other) and value.dtype == other.dtype
            assert taken[4]["cell"] == others[4]["cell"]
    vector.close()


def test_an_observation_stays_as_it_was_when_the_environment_reuses_its_memory():
    single = SingleEnvironment(Talkative())
    first, _ = single.reset(seed=7)
    second = single.step(np.ones((1, 1), np.float32))[0]
    single.step(np.ones((1, 1), np.float32))
    assert (first.tolist(), second.tolist()) == ([[7, 7]], [[8, 8]])


def test_every_entry_of_the_info_has_the_axis_of_the_environments():
    single = SingleEnvironment(Talkative())
    assert single.reset(seed=0)[1]["cell"].tolist() == [3]
    info = single.step(np.ones((1, 1), np.float32))[4]
    assert info["goal"].tolist() == [[1, 1]]
    assert info["is_success"].tolist() == [True]
    assert info["energy"].tolist() == [0.5]
    assert info["word"].tolist() == ["yes"]
    assert info["pair"].shape == (1,) and info["pair"][0] == (1,)


def test_the_end_is_told_and_nothing_is_reset():
    single = SingleEnvironment(Talkative())
    single.reset(seed=5)
    observation, reward, terminated, truncated, _ = single.step(np.ones((1, 1), np.float32))
    assert observation.tolist() == [[6, 6]]
    assert (reward.dtype, reward.tolist()) == (np.float64, [1.0])
    assert (terminated.tolist(), truncated.tolist()) == ([True], [False])
    assert single.metadata["autoreset_mode"] is AutoresetMode.DISABLED


@pytest.mark.parametrize("seed", [3, [3], None, [None]])
def test_a_seed_is_one_or_a_list_of_one(seed):
    single = SingleEnvironment(Talkative())
    assert single.reset(seed=seed)[0].tolist() == [[3, 3] if seed in (3, [3]) else [0, 0]]


def test_closing_closes_the_environment():
    environment = Talkative()
    SingleEnvironment(environment).close()
    assert environment.closed


def test_neither_side_reaches_into_the_arrays_of_the_other():
    class Meddling(Talkative):
        def step(self, action):
            action *= 0
            self.goal = np.ones(2)
            return *super().step(action)[:4], {"goal": self.goal}

    single = SingleEnvironment(Meddling())
    single.reset(seed=0)
    action = np.ones((1, 1), np.float32)
    info = single.step(action)[4]
    single.environment.goal[:] = 9
    assert action.tolist() == [[1.0]]
    assert info["goal"].tolist() == [[1.0, 1.0]]
