import itertools
import math

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deep_curiosity.training.collector import Collector, Episode, evaluate
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_vector_environment


class Counter(gymnasium.Env):
    """Counts its steps from a seeded start; ends by its own rule or by the clock."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, *, terminate_at=None, truncate_at=None, succeed_at=None, drift=0.0):
        self.terminate_at, self.truncate_at, self.drift = terminate_at, truncate_at, drift
        self.succeed_at = terminate_at if succeed_at is None else succeed_at

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        self.start = self.np_random.uniform() + self.drift
        return self._observation(), {}

    def step(self, action):
        self.count += 1
        terminated = self.count == self.terminate_at
        truncated = self.count == self.truncate_at
        info = {"is_success": self.count == self.succeed_at}
        return self._observation(), float(action[0]), terminated, truncated, info

    def _observation(self):
        return np.array([self.start + self.count], np.float32)


def steps(collector, number):
    return [collector.step(np.full((1, 1), 0.5, np.float32)) for _ in range(number)]


def counters(*ends, mode=AutoresetMode.DISABLED):
    """An environment for each end: of the clock where positive, else it terminates."""
    makers = [
        lambda end=end: Counter(truncate_at=end) if end > 0 else Counter(terminate_at=-end)
        for end in ends
    ]
    return SyncVectorEnv(makers, autoreset_mode=mode)


def vector_steps(collector, number):
    """The action in each environment is a tenth of its place."""
    action = np.linspace(0.0, 0.2, collector.environment.num_envs, dtype=np.float32)[:, None]
    return [collector.step(action) for _ in range(number)]


def test_the_successor_at_truncation_is_the_true_one_not_the_next_start():
    collector = Collector(Counter(truncate_at=3), seed=0)
    step, finished = steps(collector, 3)[-1]
    assert step.next_observation == step.observation + 1
    assert (step.terminated.tolist(), step.truncated.tolist()) == ([False], [True])
    assert collector.observation != step.next_observation
    assert finished == [Episode(1.5, 3, 0.0)]


def test_success_is_kept_to_the_end_of_the_episode():
    collector = Collector(Counter(terminate_at=2), seed=0)
    assert [finished for _, finished in steps(collector, 2)] == [[], [Episode(1.0, 2, 1.0)]]
    collector = Collector(Counter(truncate_at=4, succeed_at=2), seed=0)
    assert steps(collector, 4)[-1][1] == [Episode(2.0, 4, 1.0)]


def test_without_a_word_of_success_in_the_info_there_is_none():
    class Silent(Counter):
        def step(self, action):
            return *super().step(action)[:4], {}

    _, (episode,) = steps(Collector(Silent(truncate_at=2), seed=0), 2)[-1]
    assert episode.length == 2
    assert math.isnan(episode.success)
    assert math.isnan(Episode().success)


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
    for (step, finished), (other, other_finished) in zip(
        steps(collector, 5), steps(restored, 5), strict=True
    ):
        assert np.array_equal(step.observation, other.observation)
        assert finished == other_finished


def test_an_environment_that_does_not_repeat_itself_is_reported():
    collector = Collector(Counter(), seed=0)
    steps(collector, 3)
    restored = Collector(Counter(drift=1.0), seed=0)
    with pytest.raises(RuntimeError, match="must repeat an episode from its seed and actions"):
        restored.load_state_dict(collector.state_dict())


def test_evaluation_plays_the_same_whole_episodes_at_every_call():
    observed = []

    def act(observation, info):
        observed.append(observation.item())
        return torch.ones(1, 1)

    environment = Counter(truncate_at=4)
    for _ in range(2):
        episodes = evaluate(act, environment, episodes=3, seed=0)
        assert [(episode.episode_return, episode.length) for episode in episodes] == [(4.0, 4)] * 3
    assert observed[:12] == observed[12:]


def test_environments_end_each_in_its_way_and_never_reach_into_the_next_episode():
    collector = Collector(counters(3, -2, 100), seed=0)
    taken = vector_steps(collector, 12)
    for (step, _), (next_step, _) in itertools.pairwise(taken):
        assert step.next_observation == pytest.approx(step.observation + 1)
        done = step.terminated | step.truncated
        assert ((next_step.observation != step.next_observation)[:, 0] == done).all()
    assert np.array([step.truncated for step, _ in taken]).sum(0).tolist() == [4, 0, 0]
    assert np.array([step.terminated for step, _ in taken]).sum(0).tolist() == [0, 6, 0]


def test_environments_report_the_episodes_that_end():
    collector = Collector(counters(3, -2), seed=0)
    finished = [episodes for _, episodes in vector_steps(collector, 6)]
    short, long = Episode(pytest.approx(0.4), 2, 1.0), Episode(0.0, 3, 0.0)
    assert finished == [[], [short], [long], [short], [], [long, short]]


def test_episodes_in_several_environments_are_those_of_a_single_one():
    single, several = Collector(Counter(truncate_at=2), 0), Collector(counters(2, 2), 0)
    starts = [step.observation.item() for step, _ in steps(single, 8)[::2]]
    assert [x for step, _ in vector_steps(several, 4)[::2] for x in step.observation] == starts


@pytest.mark.parametrize("number", [0, 1, 5, 6, 17])
def test_restored_environments_go_on_as_the_saved_ones(number):
    ends = 5, -3, 7, 100
    collector = Collector(counters(*ends), seed=0)
    vector_steps(collector, number)
    restored = Collector(counters(*ends), seed=0)
    vector_steps(restored, 4)  # of which no trace may stay
    restored.load_state_dict(collector.state_dict())
    for one, other in zip(vector_steps(collector, 9), vector_steps(restored, 9), strict=True):
        for field, other_field in zip(one[0], other[0], strict=True):
            assert np.array_equal(field, other_field)
        assert one[1] == other[1]
    state = restored.state_dict()
    for name, value in collector.state_dict().items():
        assert torch.equal(torch.as_tensor(value), torch.as_tensor(state[name]))
    assert len(restored.actions) <= max(5, 3, 7, number + 9)


def test_the_actions_of_past_episodes_are_forgotten():
    collector = Collector(counters(3, -2), seed=0)
    vector_steps(collector, 50)
    assert len(collector.actions) <= 3


def test_environments_that_do_not_repeat_themselves_are_reported():
    collector = Collector(counters(9, 9), seed=0)
    vector_steps(collector, 3)
    other = Collector(counters(9, 9), seed=1)
    with pytest.raises(RuntimeError, match="must repeat an episode from its seed and actions"):
        other.load_state_dict(collector.state_dict())


def test_environments_that_reset_by_themselves_are_rejected():
    environment = counters(3, mode=AutoresetMode.SAME_STEP)
    with pytest.raises(ValueError, match="`environment` must have its autoreset disabled, got"):
        Collector(environment, seed=0)


@pytest.mark.parametrize("vectorization", ["native", "sync"])
def test_the_present_info_belongs_to_the_present_observation(vectorization):
    config = EnvironmentConfig("BatteryRover", num_envs=3, vectorization=vectorization)
    environments = make_vector_environment(config)
    collector = Collector(environments, seed=0)
    pushes = np.array([[0.1, 0.1], [0.5, 0.5], [1.0, 1.0]])
    ended = 0
    for _ in range(250):
        ended += len(collector.step(pushes)[1])
        assert collector.present_info["energy"] == pytest.approx(collector.observation[:, -1])
    assert ended >= 3
    environments.close()
