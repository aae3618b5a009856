"""Goals in hindsight on a small task: push a point to a goal, at reward -1 until it is there."""

import csv
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.trained.model import load_bonus
from deep_curiosity.training import continue_run, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import make_environment, task_spaces
from deep_curiosity.training.failure import EnvironmentFailedError
from deep_curiosity.training.hindsight import GoalFunctionError, Hindsight, make_hindsight
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.log import read_progress
from deep_curiosity.training.spaces import Entry, TaskSpaces

BOX = spaces.Box(-10.0, 10.0, (2,), np.float64)
GOALS = {"achieved_goal": BOX, "desired_goal": BOX}
EPISODE = 12
RADIUS = 0.15


class Reach(gymnasium.Env):
    """A point in the plane, whose observation lies five from where it is."""

    observation_space = spaces.Dict({"observation": BOX, **GOALS})
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = np.zeros(2)
        self.goal = self.np_random.uniform(-1, 1, 2)
        return self.seen(), {}

    def step(self, action):
        self.place = np.clip(self.place + 0.2 * action, -1, 1)
        reward = self.compute_reward(self.place, self.goal, {})
        return self.seen(), float(reward), bool(reward == 0), False, {}

    def compute_reward(self, achieved, desired, info):
        return -(np.linalg.norm(achieved - desired, axis=-1) > RADIUS).astype(np.float64)

    def seen(self):
        return {
            "observation": self.place + 5,
            "achieved_goal": self.place,
            "desired_goal": self.goal,
        }


class Ends(Reach):
    """The same, which says for any goal whether it ends the episode."""

    def compute_terminated(self, achieved, desired, info):
        return self.compute_reward(achieved, desired, info) == 0


class EndsOneByOne(Ends):
    """The same, where what takes one goal at a time makes nonsense of a batch."""

    def compute_terminated(self, achieved, desired, info):
        return bool(np.linalg.norm(achieved - desired) <= RADIUS)


class RewardOneByOne(Reach):
    """The same, with a reward that fails for a batch."""

    def compute_reward(self, achieved, desired, info):
        return np.float64(0.0 if np.linalg.norm(achieved - desired) <= RADIUS else -1.0)

    def step(self, action):
        assert self.place.shape == (2,)
        return super().step(action)


def made(task=Reach, **settings):
    config = EnvironmentConfig("make_env", max_episode_steps=EPISODE, **settings)
    return make_environment(config, make_env=task)


# A replay whose achieved goals say to which step of which episode of which environment they belong

SPACES = TaskSpaces(
    7,
    (-1.0,),
    (1.0,),
    "float32",
    (
        Entry(("achieved_goal",), (3,)),
        Entry(("desired_goal",), (3,)),
        Entry(("observation",), ()),
    ),
)
ACHIEVED, DESIRED, OBSERVED = slice(0, 3), slice(3, 6), slice(6, 7)
REAL = (-1.0, -2.0, -3.0)


def distance(achieved, desired):
    return np.abs(achieved - desired).sum(-1)


def seen(environment, episode, step):
    return np.array([environment, episode, step, *REAL, 1000 * episode + step])


def filled(num_steps=200, capacity=150, num_envs=1, length=7):
    replay = ReplayBuffer(capacity, 7, 1, num_envs=num_envs)
    lengths = [length + number for number in range(num_envs)]
    for step in range(num_steps):
        at = [divmod(step, length) for length in lengths]
        now = np.array([seen(number, *each) for number, each in enumerate(at)])
        then = np.array([seen(number, *each) for number, each in enumerate(at)])
        then[:, 2] += 1
        then[:, -1] += 1
        ended = np.array([s == length - 1 for (_, s), length in zip(at, lengths, strict=True)])
        terminated = ended & (np.array([episode for episode, _ in at]) % 2 == 0)
        reward = np.full(num_envs, 77.0)
        replay.extend(now, np.zeros((num_envs, 1)), reward, then, terminated, ended & ~terminated)
    return replay


def relabelled(hindsight, replay, batch_size=100, num_steps=3):
    """Real steps and relabelled ones, `(num_steps, batch, ...)`, and which of these are alive."""
    rows, alive, slot = replay.sample_rows(batch_size, num_steps)
    before = rows.clone()
    found = hindsight.relabel(replay, rows, alive, slot)
    assert torch.equal(rows, before)
    real = replay.sequences(rows, alive).steps
    shape = (num_steps, batch_size)
    return (
        [field.unflatten(0, shape) for field in real],
        [field.unflatten(0, shape) for field in found.steps],
        found.alive,
        alive,
    )


def goals_of(fields):
    observation, *_ = fields
    return observation[..., DESIRED]


@pytest.mark.parametrize("num_envs", [1, 3])
def test_goals_are_of_the_same_episode_and_of_no_earlier_step(num_envs):
    hindsight, replay = Hindsight(4, SPACES, distance), filled(num_envs=num_envs)
    late = []
    for _ in range(20):
        real, found, *_ = relabelled(hindsight, replay)
        own, goal = real[3][0, :80, ACHIEVED], goals_of(found)[0, :80]
        assert torch.equal(goal[:, :2], own[:, :2])  # environment and episode
        assert (goal[:, 2] >= own[:, 2]).all()  # what the step itself achieves is the first
        late.append(goal[:, 2] - own[:, 2])
    assert torch.cat(late).unique().tolist() == list(range(7 + num_envs - 1))


def test_so_many_goals_are_relabelled_for_each_real_one():
    for number, share in ((1, 50), (4, 80)):
        _, found, *_ = relabelled(Hindsight(number, SPACES, distance), filled())
        is_real = (goals_of(found)[0] == torch.tensor(REAL)).all(-1)
        assert (~is_real).sum() == share


def test_a_sequence_has_one_goal_and_the_reward_of_every_step_is_for_it():
    real, found, alive, before = relabelled(Hindsight(4, SPACES, distance), filled())
    goal = goals_of(found)
    assert torch.equal(goal, found[3][..., DESIRED])
    assert torch.equal(goal[:, :80], goal[:1, :80].expand(3, -1, -1))
    expected = distance(found[3][:, :80, ACHIEVED].numpy(), goal[:, :80].numpy())
    assert torch.equal(found[2][:, :80], torch.from_numpy(expected))
    assert (found[2][:, 80:] == 77).all()
    assert torch.equal(alive, before)
    for name, own, other in zip("oarntt", real, found, strict=True):
        kept = [ACHIEVED, OBSERVED] if name in "on" else [slice(None)]
        if name != "r":
            for part in kept:
                assert torch.equal(own[..., part], other[..., part])


def test_a_goal_that_is_achieved_ends_the_sequence_where_it_ends_the_episode():
    hindsight = Hindsight(4, SPACES, distance, lambda *goals: distance(*goals) == 0)
    real, found, alive, before = relabelled(hindsight, filled(), batch_size=500)
    reached = (found[3][..., ACHIEVED] == goals_of(found)).all(-1)
    assert torch.equal(found[4][:, :400], reached[:, :400])  # and no longer at the real goal
    assert torch.equal(found[4][:, 400:], real[4][:, 400:])
    ended = found[4][:-1]
    assert (ended & before[1:])[:, :400].any()
    for step, (now, then) in enumerate(pairwise(alive)):
        assert torch.equal(then, now & before[step + 1] & ~ended[step])


def test_a_real_end_ends_the_sequence_whatever_the_goal():
    hindsight = Hindsight(4, SPACES, distance, lambda *goals: np.zeros(len(goals[0])))
    real, found, alive, before = relabelled(hindsight, filled())
    assert not found[4][:, :80].any() and real[4][:, :80].any()
    assert torch.equal(alive, before)


def test_a_reward_that_is_not_finite_is_refused():
    hindsight = Hindsight(4, SPACES, lambda *goals: np.full(len(goals[0]), np.nan))
    with pytest.raises(ValueError, match="`compute_reward` must be finite, got nan"):
        relabelled(hindsight, filled())


class FailsLater(Reach):
    """The same, whose reward fails once enough was asked for."""

    calls = 0

    def compute_reward(self, achieved, desired, info):
        type(self).calls += 1
        if self.calls == 60:
            raise OSError("the table of rewards is gone")
        return super().compute_reward(achieved, desired, info)


def test_a_function_of_goals_that_fails_in_an_update_loses_nothing(tiny):
    config = own(tiny, total_steps=40)
    FailsLater.calls = 0
    with pytest.raises(EnvironmentFailedError, match="an update after step") as raised:
        train(config, make_env=FailsLater, show_progress=False)
    assert (
        "`compute_reward` must give a number for each pair of goals, got OSError: the table"
        in (str(raised.value))
    )
    step = load_checkpoint(config.run.out)["run_log"]["step"]
    assert f"after step {step}; all up to step {step} is saved" in str(raised.value)
    summary = continue_run(config.run.out, make_env=FailsLater, show_progress=False)
    assert summary["total_steps"] == 40


class FailsNow(Reach):
    """The same, whose reward fails when it is told to."""

    is_failing = False

    def compute_reward(self, achieved, desired, info):
        if self.is_failing:
            raise OSError("the table of rewards is gone")
        return super().compute_reward(achieved, desired, info)


@pytest.mark.parametrize("failing_step", [30, 40])
def test_a_step_whose_updates_fail_is_evaluated_and_logged(tiny, monkeypatch, failing_step):
    """Also where it is the last one, after which there is nothing else to go on with."""
    config = own(tiny, total_steps=40, evaluation_interval=10, evaluation_episodes=1)
    update = Learner.update

    def failing(self):
        FailsNow.is_failing = len(self.replay) == failing_step
        try:
            return update(self)
        finally:
            FailsNow.is_failing = False

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", failing)
        with pytest.raises(EnvironmentFailedError, match=f"an update after step {failing_step}"):
            train(config, make_env=FailsNow, show_progress=False)
    summary = continue_run(config.run.out, make_env=FailsNow, show_progress=False)
    assert summary["total_steps"] == summary["evaluation_step"] == 40
    assert [int(row["step"]) for row in read_progress(config.run.out)] == [30, 40]
    assert load_checkpoint(config.run.out)["run_log"]["learning_steps"] == 20


@pytest.mark.parametrize("given", [np.ones(2), "no number", None], ids=repr)
def test_a_function_of_goals_that_gives_no_number_for_each_is_named(given):
    hindsight = Hindsight(4, SPACES, lambda *goals: given)
    with pytest.raises(GoalFunctionError, match="`compute_reward` must give a number for each"):
        relabelled(hindsight, filled())


# What a task must have


def test_goals_keep_their_shape_and_precision():
    shapes = []

    class Matrix(Reach):
        box = spaces.Box(-10.0, 10.0, (2, 1), np.float64)
        observation_space = spaces.Dict(
            {"observation": BOX, "achieved_goal": box, "desired_goal": box}
        )

        def compute_reward(self, achieved, desired, info):
            shapes.append(achieved.shape)
            assert achieved.dtype == desired.dtype == np.float64
            return super().compute_reward(achieved[..., 0], desired[..., 0], info)

        def seen(self):
            return {
                "observation": self.place,
                "achieved_goal": self.place[:, None],
                "desired_goal": self.goal[:, None],
            }

    class Flat(Matrix):
        def step(self, action):
            self.place = np.clip(self.place + 0.2 * action, -1, 1)
            reward = Matrix.compute_reward(self, self.place[:, None], self.goal[:, None], {})
            return self.seen(), float(reward), False, False, {}

    make_hindsight(4, made(Flat))
    assert shapes[-1] == (3, 2, 1)


@pytest.mark.parametrize("task", [Reach, RewardOneByOne, Ends, EndsOneByOne])
def test_what_takes_no_batches_is_called_for_one_goal_after_another(task):
    hindsight = make_hindsight(4, made(task))
    achieved, desired = np.random.default_rng(0).uniform(-0.2, 0.2, (2, 50, 2))
    expected = Reach().compute_reward(achieved, desired, {})
    assert set(expected) == {0, -1}
    assert hindsight.compute_reward(achieved, desired).tolist() == expected.tolist()
    if issubclass(task, Ends):
        ended = hindsight.compute_terminated(achieved, desired)
        assert ended.tolist() == (expected == 0).tolist()
    else:
        assert hindsight.compute_terminated is None


class Plain(Reach):
    observation_space = BOX

    def seen(self):
        return self.place


class WithoutReward(gymnasium.Wrapper):
    def has_wrapper_attr(self, name):
        return name != "compute_reward" and super().has_wrapper_attr(name)


class WithCount(Reach):
    observation_space = spaces.Dict({"observation": spaces.Discrete(3), **GOALS})

    def seen(self):
        return super().seen() | {"observation": 1}


class CountedGoal(Reach):
    observation_space = spaces.Dict({**GOALS, "desired_goal": spaces.Discrete(3)})

    def seen(self):
        return super().seen() | {"desired_goal": 1}


class Uneven(Reach):
    observation_space = spaces.Dict(
        {"observation": BOX, "achieved_goal": BOX, "desired_goal": spaces.Box(-1.0, 1.0, (1,))}
    )

    def seen(self):
        return super().seen() | {"desired_goal": self.goal[:1]}


class Failing(Reach):
    def compute_reward(self, achieved, desired, info):
        return info["bonus"]

    def step(self, action):
        return self.seen(), 0.0, False, False, {}


class Costly(Reach):
    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward - 0.1 * float(np.square(action).sum()), *rest


def test_choices_beside_the_goals_are_left_as_they_are():
    environment = made(WithCount)
    hindsight = make_hindsight(4, environment)
    replay = ReplayBuffer(100, 7, 2)
    for seed in range(4):
        observation, _ = environment.reset(seed=seed)
        for step in range(EPISODE):
            following, reward, terminated, _, _ = environment.step(np.full(2, 0.1, np.float32))
            flags = [terminated], [step == EPISODE - 1]
            action = np.full((1, 2), 0.1)
            replay.extend(observation[None], action, np.array([reward]), following[None], *flags)
            observation = following
    rows, alive, slot = replay.sample_rows(32, 1)
    before = replay.sequences(rows.clone(), alive).steps
    after = hindsight.relabel(replay, rows, alive, slot).steps
    goal = list(task_spaces(environment).places("desired_goal"))
    others = [place for place in range(7) if place not in goal]
    assert len(goal) == 2
    for old, new in (
        (before.observation, after.observation),
        (before.next_observation, after.next_observation),
    ):
        assert new[:, others].equal(old[:, others])
        assert not new[:, goal].equal(old[:, goal])


@pytest.mark.parametrize(
    ("task", "settings", "message"),
    [
        (Plain, {}, "`hindsight` must be left out where observations are no .* got vectors"),
        (
            CountedGoal,
            {},
            "no dictionary of boxes with achieved_goal and desired_goal.* got ",
        ),
        (
            Reach,
            {"observation_keys": ("observation", "desired_goal")},
            r"among `observation_keys` if these are set, got \['desired_goal', 'observation'\]",
        ),
        (
            lambda: WithoutReward(Reach()),
            {},
            "`hindsight` must be left out where the environment has no `compute_reward`.* got 4",
        ),
        (Uneven, {}, r"`hindsight` must be about goals of one shape, got \[\(2,\), \(1,\)\]"),
        (Failing, {}, "`compute_reward` must give a number .* empty info, got KeyError: 'bonus'"),
        (Costly, {}, "reward of a step is not `compute_reward` .* got -1.2 from a step and -1.0"),
    ],
)
def test_a_task_without_goals_is_refused_before_the_first_step(tiny, task, settings, message):
    with pytest.raises(ValueError, match=message):
        make_hindsight(4, made(task, **settings))
    config = own(tiny, **settings)
    with pytest.raises(ValueError, match=message):
        train(config, make_env=task, show_progress=False)
    assert not config.run.out.exists()


def test_without_the_setting_a_task_is_asked_for_nothing():
    assert make_hindsight(None, made(Plain)) is None


# Runs


def own(config, **changes):
    """Settings of a run on a task that is made here."""
    changes = {"env_kwargs": {}, "max_episode_steps": EPISODE, "hindsight": 4} | changes
    return config.override(**({"env_id": "make_env"} | changes))


def trained(config, task=Reach):
    train(config, make_env=task, show_progress=False)
    return load_checkpoint(config.run.out)["learner"]


def last_row(folder):
    *_, row = csv.DictReader((folder / "progress.csv").read_text().splitlines())
    return {name: value for name, value in row.items() if not name.startswith("time/")}


def differences(one, other):
    """Names of weights of the agent that differ."""
    return [name for name in one if not torch.equal(one[name], other[name])]


@pytest.mark.parametrize(
    ("task", "change"),
    [
        (Ends, {}),
        (Reach, {"reward_steps": 1}),
        (Ends, {"num_envs": 3}),
        (Reach, {"bonus": "none"}),
        (Reach, {"bonus": "rnd"}),
    ],
)
def test_goals_in_hindsight_change_what_is_learned(tiny, tmp_path, task, change):
    config = own(tiny, total_steps=36, **change)
    others = trained(config.override(hindsight=None, out=tmp_path / "without"), task)
    found = trained(config, task)
    name = "policy.network.layers.0.weight"
    assert name in differences(found["agent"], others["agent"])


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"num_envs": 3, "vectorization": "sync"},
        pytest.param({"num_envs": 3, "vectorization": "async"}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_a_resumed_run_equals_an_uninterrupted_one(tiny, tmp_path, change):
    config = own(tiny, replay_capacity=40, **change)
    whole = trained(config.override(out=tmp_path / "whole"), Ends)
    train(config.override(total_steps=33), make_env=Ends, show_progress=False)
    continue_run(config.run.out, total_steps=60, make_env=Ends, show_progress=False)
    halves = load_checkpoint(config.run.out)["learner"]
    assert differences(whole["agent"], halves["agent"]) == []
    assert torch.equal(whole["replay"]["generator"], halves["replay"]["generator"])
    assert last_row(tmp_path / "whole") == last_row(config.run.out)


def learner_of(config, task=Reach):
    environment = made(task)
    learner = Learner(config, 6, 2, hindsight=make_hindsight(config.run.hindsight, environment))
    generator = np.random.default_rng(0)
    for number in range(100):
        if number % EPISODE == 0:
            observation, _ = environment.reset(seed=number)
        action = generator.uniform(-1, 1, 2)
        after, reward, terminated, truncated, _ = environment.step(action)
        learner.replay.add(observation, action, reward, after, terminated, truncated)
        observation = after
    return learner


def test_the_bonus_is_about_what_was_whatever_was_desired(tiny, monkeypatch):
    """It is computed, and its models learn, as if there were no goals in hindsight."""
    learner = learner_of(own(tiny, reward_steps=3, members="all"))
    places = task_spaces(made()).places
    given, drawn, learned = [], [], []
    update, sample_rows = learner.agent.update, learner.replay.sample_rows
    loss = learner.bonus.loss
    monkeypatch.setattr(
        learner.agent,
        "update",
        lambda batch, bonus: given.append((batch, bonus)) or update(batch, bonus),
    )
    monkeypatch.setattr(
        learner.replay,
        "sample_rows",
        lambda *sizes: drawn.append(sample_rows(*sizes)) or drawn[-1],
    )

    def recorded(transition):
        with torch.no_grad():  # as the bonus stands when it is computed
            learned.append((transition, learner.bonus(*transition[:2])))
        return loss(transition)

    monkeypatch.setattr(learner.bonus, "loss", recorded)
    learner.update()
    (rows, alive, slot), (batch, bonus), (transition, expected) = drawn[0], given[0], learned[0]
    real = learner.replay.sequences(rows, alive).first
    seen = batch.first
    goal = list(places("desired_goal"))
    assert (real.observation[:, goal] != seen.observation[:, goal]).any(-1).sum() == 26
    assert torch.equal(transition.observation, real.observation)
    assert torch.equal(transition.next_observation, real.next_observation)
    torch.testing.assert_close(bonus[:32], expected)
    last = dict(zip(slot[:32].tolist(), expected.tolist(), strict=True))
    remembered = learner.replay.bonus[list(last)]
    torch.testing.assert_close(remembered, torch.tensor(list(last.values())))


def test_curiosity_is_about_all_but_the_goal_unless_told_otherwise(tiny):
    entries = learner_of(own(tiny)).bonus.entries
    assert sorted(entries) == [0, 1, 4, 5]
    assert learner_of(own(tiny, features=(3,))).bonus.entries == [3]
    assert learner_of(own(tiny, hindsight=None)).bonus.entries is None


def test_the_bonus_of_a_run_with_goals_is_loaded_again(tiny):
    config = own(tiny, total_steps=30)
    learned = trained(config)["bonus"]
    bonus = load_bonus(config.run.out)
    assert differences(learned, bonus.bonus.state_dict()) == []
    assert bonus(torch.zeros(4, 6), torch.zeros(4, 2)).shape == (4,)


def test_a_learner_that_is_given_nothing_to_relabel_with_refuses(tiny):
    with pytest.raises(ValueError, match="`spaces` must be those of the task where `hindsight`"):
        Learner(own(tiny), 6, 2)


def test_a_maze_of_gymnasium_robotics_has_goals_in_hindsight(tiny):
    pytest.importorskip("gymnasium_robotics")
    config = tiny.override(
        env_id="PointMaze_UMaze-v3",
        env_kwargs={"continuing_task": False},
        max_episode_steps=15,
        hindsight=4,
        total_steps=40,
    )
    train(config, show_progress=False)
    environment = make_environment(config.environment)
    hindsight = make_hindsight(4, environment)
    goals = np.array([[0.0, 0.0], [0.0, 0.0]]), np.array([[0.1, 0.1], [3.0, 0.0]])
    assert hindsight.compute_reward(*goals).tolist() == [1, 0]
    assert hindsight.compute_terminated(*goals).tolist() == [1, 0]
