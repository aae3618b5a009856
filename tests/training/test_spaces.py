import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_environment, task_spaces
from deep_curiosity.training.log import write_json
from deep_curiosity.training.spaces import SPACES, Entry, TaskSpaces, read_spaces

REACH = TaskSpaces(
    5,
    (-2.0, 0.0),
    (2.0, 3.0),
    "float64",
    (Entry(("goal",), (2,)), Entry(("robot", "angle"), ()), Entry(("robot", "place"), (1, 2))),
)
OBSERVATION = {"robot": {"place": [[3, 4]], "angle": 0.5}, "goal": np.array([1, 2])}


def test_actions_go_to_the_units_of_the_task_and_back():
    action = np.array([[-1, -1], [0, 0], [1, 1], [0.5, -0.5]], np.float32)
    scaled = REACH.to_task(action)
    assert scaled.tolist() == [[-2, 0], [0, 1.5], [2, 3], [1, 0.75]]
    assert scaled.dtype == np.float64
    np.testing.assert_allclose(REACH.from_task(scaled), action)
    assert REACH.to_task(np.array([2.0, -2.0])).tolist() == [2, 0]
    assert REACH.from_task([9, -9]).tolist() == [1, -1]


def test_they_are_read_as_they_were_written(tmp_path):
    assert read_spaces(tmp_path) is None
    write_json(tmp_path / SPACES, REACH.to_json())
    assert read_spaces(tmp_path) == REACH


def test_dictionaries_become_vectors_as_gymnasium_flattens_them():
    space = spaces.Dict(
        {
            "robot": spaces.Dict(
                {"place": spaces.Box(-9, 9, (1, 2)), "angle": spaces.Box(-9, 9, ())}
            ),
            "goal": spaces.Box(-9, 9, (2,)),
        }
    )
    converted = {
        "robot": {name: np.array(value) for name, value in OBSERVATION["robot"].items()},
        "goal": OBSERVATION["goal"],
    }
    expected = spaces.flatten(space, converted)
    assert REACH.to_vector(OBSERVATION).tolist() == expected.tolist() == [1, 2, 0.5, 3, 4]


def test_a_batch_of_dictionaries_is_a_batch_of_vectors():
    observation = {
        "robot": {"place": np.ones((7, 1, 2)), "angle": np.arange(7)},
        "goal": np.zeros((7, 2)),
    }
    vector = REACH.to_vector(observation)
    assert vector.shape == (7, 5)
    assert vector[3].tolist() == [0, 0, 3, 1, 1]


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ({"robot": {"place": [[3, 4]]}, "goal": [1, 2]}, r"the entry 'robot\.angle', got \['goal"),
        ({"robot": OBSERVATION["robot"]}, r"must have the entry 'goal', got \['robot'\]"),
        (OBSERVATION | {"goal": [1, 2, 3]}, r"the shape \(2,\) in its entry 'goal', got \(3,\)"),
    ],
)
def test_what_an_observation_lacks_is_named(observation, message):
    with pytest.raises(ValueError, match=message):
        REACH.to_vector(observation)


@pytest.mark.parametrize("frame_stack", [1, 2])
def test_those_of_a_task_are_below_its_wrappers(frame_stack):
    environment = make_environment(EnvironmentConfig("Pendulum-v1", frame_stack=frame_stack))
    assert task_spaces(environment) == TaskSpaces(3, (-2.0,), (2.0,), "float32")
    environment.close()


def test_entries_of_a_dictionary_are_written_down():
    pytest.importorskip("shimmy")
    environment = make_environment(EnvironmentConfig("dm_control/pendulum-swingup-v0"))
    found = task_spaces(environment)
    assert [entry.path for entry in found.entries] == [("orientation",), ("velocity",)]
    inner = environment
    while not isinstance(inner, gymnasium.wrappers.FlattenObservation):
        inner = inner.env
    observation, _ = inner.env.reset(seed=0)
    vector, _ = environment.reset(seed=0)
    np.testing.assert_allclose(found.to_vector(observation), vector)
    environment.close()


def test_places_are_those_of_the_flattened_entries():
    assert REACH.places("goal") == (0, 1)
    assert REACH.places("robot") == (2, 3, 4)
    assert REACH.places("reward") == ()


@pytest.mark.parametrize("text", ["{", "[]", '{"entries": []}'])
def test_a_damaged_file_is_named(tmp_path, text):
    (tmp_path / SPACES).write_text(text)
    with pytest.raises(ValueError, match=f"`{SPACES}` must hold spaces in JSON, got {tmp_path}"):
        read_spaces(tmp_path)


MIXED = spaces.Tuple(
    (
        spaces.Dict({"mode": spaces.Discrete(3, start=2), "at": spaces.Box(-9, 9, (2,))}),
        spaces.MultiDiscrete([2, 3]),
        spaces.MultiBinary(2),
    )
)


class Mixed(gymnasium.Env):
    observation_space, action_space = MIXED, spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}


def test_choices_become_zeros_and_ones_as_gymnasium_flattens_them(tmp_path):
    environment = make_environment(
        EnvironmentConfig("make_env", max_episode_steps=5), make_env=Mixed
    )
    write_json(tmp_path / SPACES, task_spaces(environment).to_json())
    found = read_spaces(tmp_path)
    MIXED.seed(0)
    for _ in range(20):
        observation = MIXED.sample()
        expected = spaces.flatten(MIXED, observation)
        assert found.to_vector(observation).tolist() == expected.tolist()
    many = ({"mode": [2, 4], "at": np.ones((2, 2))}, [[0, 2], [1, 0]], [[0, 1], [1, 1]])
    assert found.to_vector(many)[:, :5].tolist() == [[1, 1, 1, 0, 0], [1, 1, 0, 0, 1]]


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (({"mode": 5, "at": [0, 0]}, [0, 0], [0, 0]), r"one of the choices in its entry '0.mode'"),
        (({"mode": 2, "at": [0, 0]}, [0, 0]), r"must have the entry '2'"),
        (({"mode": 2, "at": [0, 0]}, [0, 0, 1], [0, 0]), r"the shape \(2,\) in its entry '1'"),
    ],
)
def test_an_observation_of_other_choices_is_refused(observation, message):
    environment = make_environment(
        EnvironmentConfig("make_env", max_episode_steps=5), make_env=Mixed
    )
    with pytest.raises(ValueError, match=message):
        task_spaces(environment).to_vector(observation)


@pytest.mark.parametrize(
    ("observation", "error", "message"),
    [
        ({"goal": np.ones((2, 2)), "angle": np.ones(3)}, ValueError, r"got \[\(2,\), \(3,\)\]"),
        ({"goal": np.ones((2, 2)), "angle": 0.5}, ValueError, r"got \[\(2,\), \(\)\]"),
        ({"goal": [1, 2], 3: 0.5}, ValueError, r"the entry 'angle', got \[3, 'goal'\]"),
        (
            {"goal": [1, 2], "angle": "north"},
            TypeError,
            r"`observation\['angle'\]` must be of real",
        ),
        ({"goal": [1, 1e300], "angle": 0}, ValueError, r"in float32, got \[1, 1e\+300\]"),
        (
            [{"goal": [1, 2], "angle": 0.5}],
            TypeError,
            "`observation` must be of real numbers, got",
        ),
    ],
)
def test_what_is_no_dictionary_of_such_entries_is_refused_by_name(observation, error, message):
    entries = (Entry(("goal",), (2,)), Entry(("angle",), ()))
    found = TaskSpaces(3, (-1.0,), (1.0,), "float32", entries)
    with pytest.raises(error, match=message):
        found.to_vector(observation)
    assert found.to_vector({"goal": np.ones((0, 2)), "angle": np.ones(0)}).shape == (0, 3)
