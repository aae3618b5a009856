"""Goals in hindsight on a task of our own: reach a point, reward -1 at every other step."""

import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import Tensor

pytest.importorskip("stable_baselines3")
from stable_baselines3 import DDPG, SAC, TD3, HerReplayBuffer
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from deep_curiosity.bonuses import Bonus
from deep_curiosity.integrations.stable_baselines3 import (
    CuriosityCallback,
    CuriousHerReplayBuffer,
)
from deep_curiosity.transitions import Transition

BOX = spaces.Box(-10.0, 10.0, (2,), np.float64)
SMALL = {"bonus_kwargs": {"components": 8, "num_members": 2, "hidden_dims": (8,)}}
NUM_STEPS = 10  # of an episode


class Reach(gymnasium.Env):
    """A point in the plane that is pushed by actions, and a goal that it is to come near to."""

    observation_space = spaces.Dict(
        {"observation": BOX, "achieved_goal": BOX, "desired_goal": BOX}
    )
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, goal: tuple[float, float] = (0.9, 0.9)) -> None:
        self.goal = np.array(goal)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.place, self.num_steps = np.zeros(2), 0
        return self._observation(), {}

    def step(self, action: np.ndarray) -> Any:
        self.place = np.clip(self.place + 0.2 * action, -1, 1)
        self.num_steps += 1
        reward = float(self.compute_reward(self.place, self.goal, {}))
        return self._observation(), reward, reward == 0, self.num_steps == NUM_STEPS, {}

    def compute_reward(self, achieved: np.ndarray, desired: np.ndarray, info: Any) -> np.ndarray:
        return -(np.linalg.norm(achieved - desired, axis=-1) > 0.15).astype(np.float32)

    def _observation(self) -> dict[str, np.ndarray]:
        observation = self.place + 5.0  # so that no key is taken for another
        return {"observation": observation, "achieved_goal": self.place, "desired_goal": self.goal}


class Recorded(Bonus):
    """Ten times the first entry of what is observed, and a record of it."""

    def __init__(self, factor: float = 10.0) -> None:
        super().__init__()
        self.factor = torch.nn.Parameter(torch.tensor(factor), requires_grad=False)
        self.observed: list[Transition] = []
        self.fresh_actions: list[Tensor] = []

    def forward(self, observation: Tensor, action: Tensor, next_observation: Any = None) -> Tensor:
        return self.factor * observation[:, 0]

    def loss(self, transition: Transition) -> Tensor:
        return self.factor * 0

    def observe(self, transition: Transition, policy: Any = None, visited: Any = None) -> None:
        self.observed.append(transition)
        if policy is not None:
            self.fresh_actions.append(policy(transition.observation))

    def metrics(self) -> dict[str, Tensor]:
        return {}


def make_agent(kind: type = SAC, env: Any = None, buffer: Any = None, **options: Any) -> Any:
    curious = buffer is None
    if curious:
        options = {"observation_key": "observation", "bonus": Recorded()} | options
    return kind(
        "MultiInputPolicy",
        Reach() if env is None else env,
        buffer_size=200,
        learning_starts=20,
        batch_size=16,
        replay_buffer_class=CuriousHerReplayBuffer if curious else buffer,
        replay_buffer_kwargs=options,
        policy_kwargs={"net_arch": [8]},
        seed=0,
        device="cpu",
    )


def filled(**settings: Any) -> Any:
    """A buffer of some episodes, of which nothing has been learned."""
    agent = make_agent(**settings)
    agent.learning_starts = 1_000
    return agent.learn(60).replay_buffer


def rewards_of(samples: Any) -> np.ndarray:
    """Rewards of the task for the goals of a batch, as they were relabelled."""
    achieved, desired = (
        samples.next_observations[key].numpy() for key in ("achieved_goal", "desired_goal")
    )
    return Reach().compute_reward(achieved, desired, {})


def test_the_bonus_is_added_to_the_relabelled_rewards() -> None:
    buffer = filled()
    stored = buffer.rewards.copy()
    samples = buffer.sample(50)
    bonus = 10 * samples.observations["observation"][:, 0].float()
    expected = torch.from_numpy(rewards_of(samples)) + bonus
    torch.testing.assert_close(samples.rewards.flatten(), expected)
    assert (samples.observations["desired_goal"] != 0.9).any(1).sum() > 25  # of hindsight
    assert {-1.0, 0.0} == set(rewards_of(samples).tolist())
    assert np.array_equal(buffer.rewards, stored)


@pytest.mark.parametrize("key", ["observation", "achieved_goal", "desired_goal"])
def test_the_bonus_is_given_the_relabelled_batch(key: str) -> None:
    bonus = Recorded()
    samples = filled(bonus=bonus, observation_key=key).sample(50)
    (transition,) = bonus.observed
    torch.testing.assert_close(transition.observation, samples.observations[key].float())
    torch.testing.assert_close(transition.next_observation, samples.next_observations[key].float())
    torch.testing.assert_close(transition.action, samples.actions)
    assert transition.reward.tolist() == rewards_of(samples).tolist()


def test_the_clock_is_told_from_the_goal() -> None:
    bonus = Recorded()
    buffer = filled(bonus=bonus)
    for _ in range(5):
        buffer.sample(100)
    for transition in bonus.observed:
        achieved = transition.next_observation - 5
        at_goal = torch.from_numpy(
            Reach().compute_reward(achieved.numpy(), np.array([0.9, 0.9]), {})
        )
        assert torch.equal(transition.terminated, at_goal == 0)
        assert not (transition.terminated & transition.truncated).any()
    truncated = torch.cat([transition.truncated for transition in bonus.observed])
    assert truncated.float().mean() == pytest.approx(1 / NUM_STEPS, abs=0.05)


def test_without_a_bonus_it_is_the_librarys_own_buffer() -> None:
    curious = make_agent(bonus=Recorded(0.0)).learn(40)
    plain = make_agent(buffer=HerReplayBuffer).learn(40)
    for one, other in zip(curious.policy.parameters(), plain.policy.parameters(), strict=True):
        assert torch.equal(one, other)
    changed = make_agent().learn(40)
    pairs = zip(curious.policy.parameters(), changed.policy.parameters(), strict=True)
    assert not all(torch.equal(one, other) for one, other in pairs)


@pytest.mark.parametrize("factor", [0.0, 10.0])
def test_normalised_agents_are_given_a_raw_bonus(factor: float) -> None:
    def environment() -> VecNormalize:
        return VecNormalize(DummyVecEnv([Reach] * 2), norm_obs_keys=["observation"])

    bonus = Recorded(factor)
    batches = []
    for options in ({"bonus": bonus}, {"buffer": HerReplayBuffer}):
        agent = make_agent(env=environment(), **options)
        agent.learning_starts = 1_000
        agent.learn(60)
        np.random.seed(0)  # noqa: NPY002  # of the library
        batches.append(agent.replay_buffer.sample(32, agent.get_vec_normalize_env()))
    for key, value in batches[0].observations.items():
        torch.testing.assert_close(value, batches[1].observations[key])
    (transition,) = bonus.observed
    assert (transition.observation > 3).all()  # as the task gave it
    added = (batches[0].rewards - batches[1].rewards).flatten()
    torch.testing.assert_close(added, factor * transition.observation[:, 0], rtol=0, atol=1e-4)


def test_ends_that_are_clipped_are_refused_without_the_callback() -> None:
    environment = VecNormalize(DummyVecEnv([Reach]), norm_obs_keys=["observation"], clip_obs=0.1)
    with pytest.raises(ValueError, match=r"`callback` must be CuriosityCallback\(\)"):
        make_agent(env=environment).learn(60)


def test_no_end_is_kept_that_nothing_asks_for() -> None:
    agent = make_agent()
    agent.learning_starts = 1_000
    sizes = [len(pickle.dumps(agent.learn(steps).replay_buffer)) for steps in (30, 90)]
    assert sizes[0] == pytest.approx(sizes[1], abs=100)


def test_no_goal_is_taken_from_beyond_a_reset() -> None:
    agent = make_agent(env=DummyVecEnv([Reach] * 2))
    agent.learning_starts = 1_000
    for num_steps in (8, 80):  # four steps of each environment, and forty after a reset
        agent.learn(num_steps)
    buffer = agent.replay_buffer
    assert (buffer.ep_length[:4] == 4).all() and (buffer.ep_start[4] == 4).all()
    assert not buffer.dones[:3].any() and buffer.dones[3].all() and buffer.timeouts[3].all()


def test_an_episode_goes_on_where_nothing_was_reset() -> None:
    agent = make_agent()
    agent.learning_starts = 1_000
    for _ in range(2):
        agent.learn(4, reset_num_timesteps=False)
    assert not agent.replay_buffer.dones.any()


@pytest.mark.parametrize("kind", [SAC, TD3, DDPG])
def test_every_agent_learns_with_curiosity(kind: type) -> None:
    agent = make_agent(kind, DummyVecEnv([Reach] * 2), bonus="curiosity", **SMALL)
    agent.learn(40, callback=CuriosityCallback(log_interval=1))
    attachment = agent.replay_buffer.attachment
    assert attachment.actor is not None
    assert int(attachment.learner.every.num_calls) == 10
    assert all(torch.isfinite(parameter).all() for parameter in agent.policy.parameters())


def test_fresh_actions_are_asked_of_the_relabelled_goals() -> None:
    bonus = Recorded()
    make_agent(bonus=bonus).learn(40, callback=CuriosityCallback())
    assert len(bonus.fresh_actions) == len(bonus.observed) > 10
    assert all(action.shape == (16, 2) for action in bonus.fresh_actions)


def test_a_buffer_is_saved_and_loaded(tmp_path: Path) -> None:
    agent = make_agent(bonus="curiosity", **SMALL).learn(40)
    agent.save_replay_buffer(tmp_path / "buffer.pkl")
    other = make_agent(bonus="curiosity", **SMALL)
    other.load_replay_buffer(tmp_path / "buffer.pkl", truncate_last_traj=False)
    samples = []
    for each in (agent, other):
        np.random.seed(0)  # noqa: NPY002  # of the library
        torch.manual_seed(0)
        samples.append(each.replay_buffer.sample(16).rewards)
    torch.testing.assert_close(*samples)


def test_the_key_must_be_named() -> None:
    with pytest.raises(
        ValueError, match=r"`observation_key` must be one of .*'observation'.*None"
    ):
        make_agent(observation_key=None)
