import math

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from deep_curiosity.training.collection import Collector, Episode, evaluate


class Counter(gymnasium.Env):
    """Counts its steps from a seeded start; ends by its own rule or by the clock."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, *, terminate_at=None, truncate_at=None, drift=0.0):
        self.terminate_at, self.truncate_at, self.drift = terminate_at, truncate_at, drift

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        self.start = self.np_random.uniform() + self.drift
        return self._observation(), {}

    def step(self, action):
        self.count += 1
        terminated = self.count == self.terminate_at
        truncated = self.count == self.truncate_at
        info = {"is_success": terminated}
        return self._observation(), float(action[0]), terminated, truncated, info

    def _observation(self):
        return np.array([self.start + self.count], np.float32)


def steps(collector, number):
    return [collector.step(np.full(1, 0.5, np.float32)) for _ in range(number)]


def test_the_successor_at_truncation_is_the_true_one_not_the_next_start():
    collector = Collector(Counter(truncate_at=3), seed=0)
    (step, episode) = steps(collector, 3)[-1]
    assert step.next_observation == step.observation + 1
    assert (step.terminated, step.truncated) == (False, True)
    assert collector.observation != step.next_observation
    assert episode == Episode(1.5, 3, 0.0)


def test_success_is_kept_to_the_end_of_the_episode():
    collector = Collector(Counter(terminate_at=2), seed=0)
    assert steps(collector, 2)[-1][1] == Episode(1.0, 2, 1.0)
    assert math.isnan(Episode().after(1.0, {}).success)
    assert (
        Episode().after(1.0, {"is_success": True}).after(1.0, {"is_success": False}).success == 1
    )


def test_every_episode_starts_anew_and_another_seed_elsewhere():
    first, second = Collector(Counter(truncate_at=2), 0), Collector(Counter(truncate_at=2), 1)
    starts = []
    for collector in (first, second):
        for _ in range(3):
            starts.append(collector.observation.item())
            steps(collector, 2)
    assert len(set(starts)) == 6


def test_a_restored_collector_goes_on_as_the_saved_one():
    collector = Collector(Counter(truncate_at=5), seed=0)
    steps(collector, 8)
    restored = Collector(Counter(truncate_at=5), seed=0)
    restored.load_state_dict(collector.state_dict())
    for (step, episode), (other, other_episode) in zip(
        steps(collector, 5), steps(restored, 5), strict=True
    ):
        assert np.array_equal(step.observation, other.observation)
        assert episode == other_episode


def test_an_environment_that_does_not_repeat_itself_is_reported():
    collector = Collector(Counter(), seed=0)
    steps(collector, 3)
    restored = Collector(Counter(drift=1.0), seed=0)
    with pytest.raises(RuntimeError, match="must repeat an episode from its seed and actions"):
        restored.load_state_dict(collector.state_dict())


def test_evaluation_plays_the_same_whole_episodes_at_every_call():
    seen = []

    def act(observation):
        seen.append(observation.item())
        return torch.ones(1, 1)

    environment = Counter(truncate_at=4)
    for _ in range(2):
        episodes = evaluate(act, environment, episodes=3, seed=0)
        assert [(episode.episode_return, episode.length) for episode in episodes] == [(4.0, 4)] * 3
    assert seen[:12] == seen[12:]
