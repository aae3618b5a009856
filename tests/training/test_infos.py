import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from deep_curiosity.training import Config, train
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import (
    MADE_BY_FUNCTION,
    make_environment,
    make_vector_environment,
)
from deep_curiosity.training.infos import after_reset, is_told, joined

HERE, ELSEWHERE = np.array([True, False]), np.array([False, True])


def told(*values):
    """Values of an entry of several infos, of which `...` tells none, and their type."""
    infos = [{} if value is ... else {"entry": value} for value in values]
    entry = joined(infos)["entry"]
    return entry.tolist(), entry.dtype.kind


@pytest.mark.parametrize(
    ("values", "expected", "kind"),
    [
        ((1, 0.7), [1.0, 0.7], "f"),
        ((1.0, 0.5), [1.0, 0.5], "f"),
        ((True, False), [True, False], "b"),
        ((3, 4), [3, 4], "i"),
        ((3, np.float32(0.5)), [3.0, 0.5], "f"),
        ((np.array(2), 0.5), [2.0, 0.5], "f"),
        ((np.arange(2), np.full(2, 0.5)), [[0.0, 1.0], [0.5, 0.5]], "f"),
        ((..., True), [False, True], "b"),
        ((..., 4), [None, 4], "O"),
        ((0.5, ..., 1), [0.5, pytest.approx(np.nan, nan_ok=True), 1.0], "f"),
        ((..., np.ones(1)), [pytest.approx([np.nan], nan_ok=True), [1.0]], "f"),
        ((1.5, "far"), [1.5, "far"], "O"),
        ((1.5, None), [1.5, None], "O"),
        (({"a": 1}, None), [{"a": 1}, None], "O"),
        (([0.0], [0.0, 1.0]), [[0.0], [0.0, 1.0]], "O"),
        ((2**70, 1), [2**70, 1], "O"),
    ],
    ids=repr,
)
def test_infos_are_joined_whatever_they_hold(values, expected, kind):
    assert told(*values) == (expected, kind)


def test_arrays_of_several_lengths_stay_as_they_were_told():
    contacts = np.zeros(2), np.ones(3)
    entry = joined([{"contacts": each} for each in contacts])["contacts"]
    for each in contacts:
        each[:] = 9  # which the task may do with what is its own
    assert [each.tolist() for each in entry] == [[0.0, 0.0], [1.0, 1.0, 1.0]]


def test_a_mask_says_who_has_told():
    info = joined([{"a": 1.0, "_a": "private"}, {"b": 2}])
    assert is_told(info, "a").tolist() == [True, False]
    assert is_told(info, "b").tolist() == [False, True]
    assert not is_told(info, "c")
    assert is_told({"a": np.ones(1), "_a": np.array(["private"], object)}, "a")


def test_after_a_reset_everything_is_of_the_present():
    before = joined([{"a": 1.0, "b": 1, "c": {"x": 1}, "d": "old"}] * 2)
    start = joined([{}, {"a": 2.0, "b": 2, "c": {"x": 2}, "e": True}])
    present = after_reset(ELSEWHERE, start, before)
    assert present["a"].tolist() == [1.0, 2.0]
    assert present["b"].tolist() == [1, 2] and present["b"].dtype.kind == "i"
    assert present["c"].tolist() == [{"x": 1}, {"x": 2}]
    assert present["d"].tolist() == ["old", None]
    assert present["e"].tolist() == [False, True]
    assert present["_d"].tolist() == [True, False]
    assert present["_a"].tolist() == [True, True]


def test_what_nobody_tells_any_more_is_gone():
    before = joined([{"a": 1.0}, {}])
    assert after_reset(HERE, {}, before) == {}


class Tells(gymnasium.Env):
    """Tells what a function makes of its number and of the steps in its episode."""

    observation_space = spaces.Box(-3.0, 3.0, (2,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, number, info):
        self.number, self.info = number, info

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return np.zeros(2), self.info(self.number, 0)

    def step(self, action):
        self.count += 1
        return np.zeros(2), 0.0, False, False, self.info(self.number, self.count)


def maker(info):
    made = []

    def make():
        made.append(Tells(len(made), info))
        return made[-1]

    return make


def collector(info, num_envs, **settings):
    config = EnvironmentConfig(
        MADE_BY_FUNCTION, num_envs=num_envs, max_episode_steps=5, **settings
    )
    make = make_vector_environment if num_envs > 1 else make_environment
    return Collector(make(config, make_env=maker(info)), seed=0)


@pytest.mark.parametrize("num_envs", [1, 3])
def test_dictionaries_are_told_alike_of_one_environment_and_of_several(num_envs):
    stepped = collector(lambda number, count: {"sensors": {"charge": count}}, num_envs)
    for step in range(12):
        charges = [sensors["charge"] for sensors in stepped.present_info["sensors"]]
        assert charges == [step % 5] * num_envs
        stepped.step(np.zeros((num_envs, 1), np.float32))


@pytest.mark.parametrize("vectorization", ["sync", "async"])
def test_what_does_not_fit_into_one_array_is_told_in_training(tiny, vectorization):
    config = Config.of(
        **tiny.to_json()
        | {
            "env_id": EnvironmentConfig().env_id,
            "env_kwargs": {},
            "num_envs": 2,
            "vectorization": vectorization,
            "max_episode_steps": 7,
        }
    )

    def make():
        return Tells(
            0,
            lambda number, count: {
                "contacts": np.zeros(count % 3),
                "distance": 1.5 if count % 2 else "far",
                "sensors": {"charge": 0.5},
                **({"battery": 1} if count else {}),
            },
        )

    assert train(config, make_env=make, show_progress=False)["total_steps"] == 60
