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
from deep_curiosity.training.wrappers import SyncEnvironments


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
    with pytest.raises(RuntimeError, match="that repeats an episode from its seed and actions"):
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
    with pytest.raises(RuntimeError, match="that repeats an episode from its seed and actions"):
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


@pytest.mark.parametrize("num_envs", [1, 3])
def test_an_info_of_several_numbers_belongs_to_the_present_observation(num_envs):
    class Tells(Counter):
        def __init__(self):
            super().__init__(truncate_at=4)

        def reset(self, *, seed=None, options=None):
            observation, _ = super().reset(seed=seed)
            return observation, {"seen": np.array([*observation, 0.0])}

        def step(self, action):
            observation, *rest, _ = super().step(action)
            return observation, *rest, {"seen": np.array([*observation, 1.0])}

    environments = SyncVectorEnv([Tells] * num_envs, autoreset_mode=AutoresetMode.DISABLED)
    collector = Collector(environments if num_envs > 1 else Tells(), seed=0)
    starts = 0
    for _ in range(30):
        seen = collector.present_info["seen"]
        assert seen[:, :-1].tolist() == collector.observation.tolist()
        starts += (seen[:, -1] == 0).sum()
        collector.step(np.zeros((num_envs, 1), np.float32))
    assert starts > num_envs


@pytest.mark.parametrize("num_envs", [1, 3])
def test_what_an_episode_told_is_not_told_of_the_next(num_envs):
    """A reset that says nothing leaves nothing of the episode before."""

    class Telling(Counter):
        def __init__(self, length):
            super().__init__(truncate_at=length)

        def step(self, action):
            observation, *rest, _ = super().step(action)
            return observation, *rest, {"charge": 0.5, "name": "full"}

    lengths = [4, 5, 7][:num_envs]
    environments = SyncEnvironments(
        [lambda length=length: Telling(length) for length in lengths],
        autoreset_mode=AutoresetMode.DISABLED,
    )
    collector = Collector(environments if num_envs > 1 else Telling(4), seed=0)
    ended = 0
    for _ in range(15):
        collector.step(np.zeros((num_envs, 1), np.float32))
        began, told = collector._length == 0, collector.present_info
        ended += began.sum()
        if began.all():
            assert "charge" not in told
        elif num_envs > 1:
            assert told["_charge"].tolist() == (~began).tolist()
            assert np.array_equal(told["charge"], np.where(began, math.nan, 0.5), equal_nan=True)
            assert [name is None for name in told["name"]] == began.tolist()
    assert ended >= 3


class Fragile(Counter):
    """Counts as the others do, and shows what is not finite once in a while."""

    def __init__(self, *, breaks_at, shows=np.nan, in_reward=False, **ends):
        super().__init__(**ends)
        self.breaks_at, self.shows, self.in_reward = breaks_at, shows, in_reward
        self.breaks = False

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed)
        self.breaks = self.np_random.uniform() < 0.4
        return observation, info

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        if self.breaks and self.count == self.breaks_at:
            if self.in_reward:
                return observation, self.shows, True, truncated, info
            return observation * self.shows, reward, True, truncated, info
        return observation, reward, terminated, truncated, info


BREAKS = pytest.mark.filterwarnings("ignore:`observation` and `reward` must be finite")


def fragile(number, **settings):
    makers = [lambda: Fragile(breaks_at=3, truncate_at=5, **settings)] * number
    return SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED)


@BREAKS
@pytest.mark.parametrize("in_reward", [False, True])
@pytest.mark.parametrize("shows", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("number", [1, 3])
def test_an_episode_is_cut_off_before_a_step_that_is_not_finite(number, shows, in_reward):
    collector = Collector(fragile(number, shows=shows, in_reward=in_reward), seed=0)
    taken = vector_steps(collector, 60)
    episodes = [episode for _, finished in taken for episode in finished]
    broken = [episode for episode in episodes if episode.broken]
    assert 0 < len(broken) < len(episodes)
    assert {episode.length for episode in broken} == {3}
    assert {episode.length for episode in episodes if not episode.broken} == {5}
    assert sum(int((~step.sound).sum()) for step, _ in taken) == len(broken)
    for step, _ in taken:
        assert all(np.isfinite(field).all() for field in step)
        assert step.truncated[~step.sound].all() and not step.terminated[~step.sound].any()
        assert (step.reward[~step.sound] == 0).all()
        moved = (step.next_observation - step.observation)[:, 0]
        assert moved[step.sound] == pytest.approx(1) and (moved[~step.sound] == 0).all()
    assert all(np.isfinite(episode.episode_return) for episode in episodes)


def test_what_is_not_finite_is_told():
    collector = Collector(Fragile(breaks_at=1, truncate_at=5), seed=0)
    with pytest.warns(UserWarning, match="`observation` and `reward` must be finite, got NaN"):
        steps(collector, 60)


@BREAKS
@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("saved_at", range(12))
def test_environments_that_broke_go_on_as_saved(saved_at, number):
    collector = Collector(fragile(number), seed=1)
    vector_steps(collector, saved_at)
    restored = Collector(fragile(number), seed=1)
    restored.load_state_dict(collector.state_dict())
    for one, other in zip(vector_steps(collector, 30), vector_steps(restored, 30), strict=True):
        for field, other_field in zip(one[0], other[0], strict=True):
            assert np.array_equal(field, other_field)
        assert str(one[1]) == str(other[1])  # NaN is not NaN


@BREAKS
def test_an_environment_that_always_breaks_is_an_error():
    class Broken(Counter):
        def step(self, action):
            return np.full(1, np.nan), *super().step(action)[1:]

    class NeverStarts(Counter):
        def _observation(self):
            return np.full(1, np.nan, np.float32)

    message = "`observation` and `reward` must be finite, got NaN .* 20 episodes one after another"
    with pytest.raises(ValueError, match=message):
        steps(Collector(Broken(), seed=0), 100)
    with pytest.raises(ValueError, match=message):
        Collector(NeverStarts(), seed=0)
    with pytest.raises(ValueError, match=message):
        evaluate(lambda x, info: torch.zeros(1, 1), Broken(), episodes=25, seed=0)


@BREAKS
@pytest.mark.parametrize("number", [1, 3])
def test_a_start_that_is_not_finite_is_left_for_the_next(number):
    class Stumbles(Counter):
        def reset(self, *, seed=None, options=None):
            observation, info = super().reset(seed=seed)
            stumbles = self.np_random.uniform() < 0.5
            return (observation * np.nan if stumbles else observation), info

    makers = [lambda: Stumbles(truncate_at=2)] * number
    collector = Collector(SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED), seed=0)
    for step, _ in vector_steps(collector, 40):
        assert np.isfinite(step.observation).all() and step.sound.all()
        assert step.next_observation == pytest.approx(step.observation + 1)


@pytest.mark.parametrize("number", [1, 2])
def test_absurd_numbers_are_cut_told_once_and_restored(number):
    class Spiked(Counter):
        def step(self, action):
            observation, reward, *rest = super().step(action)
            spike = self.count == 5
            return observation * np.float32(1e12 if spike else 1), reward + 1e30 * spike, *rest

    def collector():
        makers = [lambda: Spiked(truncate_at=9)] * number
        return Collector(SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED), seed=0)

    first = collector()
    with pytest.warns(UserWarning, match="should stay within 100 times") as told:
        taken = [first.step(np.full((number, 1), 1.0, np.float32)) for _ in range(30)]
    assert sorted(str(each.message).split("`")[1] for each in told) == ["observation", "reward"]
    assert "entry 0" in str(told[0].message)
    assert max(float(step.next_observation.max()) for step, _ in taken) < 1e5
    assert max(float(step.reward.max()) for step, _ in taken) < 1e5
    assert taken[8][1][0].episode_return > 1e29  # of the rewards as they came
    after = taken[5][0]  # begins where the cut step ended
    assert np.array_equal(after.observation, taken[4][0].next_observation)
    second = collector()
    second.load_state_dict(first.state_dict())
    assert np.array_equal(first.observation, second.observation)
    second._cut_names = first._cut_names  # told already
    for _ in range(6):
        one, other = (each.step(np.full((number, 1), 1.0)) for each in (first, second))
        assert np.array_equal(one[0].next_observation, other[0].next_observation)
        assert np.array_equal(one[0].reward, other[0].reward)


def test_success_that_is_told_at_a_success_alone_is_unknown_in_the_others():
    class Told(Counter):
        def step(self, action):
            *rest, info = super().step(action)
            return *rest, info if info["is_success"] else {}

    makers = [lambda: Told(truncate_at=2, succeed_at=1), lambda: Told(truncate_at=2, succeed_at=9)]
    collector = Collector(SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED), seed=0)
    finished = vector_steps(collector, 2)[-1][1]
    assert finished[0].success == 1.0 and math.isnan(finished[1].success)


def test_a_state_that_is_older_than_the_cuts_is_taken():
    collector = Collector(Counter(truncate_at=5), seed=0)
    steps(collector, 8)
    old = {"num_episodes", "number", "length", "actions", "observation"}
    state = {name: value for name, value in collector.state_dict().items() if name in old}
    restored = Collector(Counter(truncate_at=5), seed=0)
    restored.load_state_dict(state)
    assert np.array_equal(collector.observation, restored.observation)
    assert np.array_equal(steps(collector, 1)[0][0].reward, steps(restored, 1)[0][0].reward)


def test_what_a_task_begins_with_is_usual():
    collector = Collector(Counter(truncate_at=9, drift=5_000.0), seed=0)
    assert collector.observation > 5_000
    for step, _ in steps(collector, 30):
        assert step.observation > 5_000


class Jumps(Counter):
    """Is far from where it began right after the first step."""

    def _observation(self):
        return np.array([500.0 if self.count else 0.0], np.float32)


@pytest.mark.filterwarnings("ignore:`observation` should stay within")
def test_a_policy_is_evaluated_on_what_it_was_shown_in_training():
    def shown(**options):
        seen = []

        def act(observation, info):
            seen.append(observation.item())
            return torch.zeros(1, 1)

        evaluate(act, Jumps(truncate_at=3), episodes=2, seed=0, **options)
        return seen

    collector = Collector(Jumps(truncate_at=100), seed=0)
    steps(collector, 400)
    assert collector.observation == 0 and collector._raw_observation == 0
    assert shown(usual_observation=collector.usual_observation) == [0.0, 500.0, 500.0] * 2
    assert max(shown()) < 500  # where nothing is known of the task
    known = set(shown(usual_observation=np.array([1.0])))
    assert known == {0.0, 1.0}  # what is usual stays what the policy has learned with
