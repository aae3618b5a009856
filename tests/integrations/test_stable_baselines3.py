import pickle
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from sb3_contrib import TQC, CrossQ
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.save_util import load_from_pkl, save_to_pkl
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)
from torch import Tensor, nn

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.frozen import FrozenBonus
from deep_curiosity.bonuses.registry import BONUSES
from deep_curiosity.integrations.stable_baselines3 import (
    CuriosityCallback,
    CuriousDictReplayBuffer,
    CuriousDictRolloutBuffer,
    CuriousNStepReplayBuffer,
    CuriousReplayBuffer,
    CuriousRolloutBuffer,
    StableBaselinesIntegration,
    StableBaselinesOnPolicyIntegration,
)
from deep_curiosity.integrations.stable_baselines3.spaces import bounded_space, scaled
from deep_curiosity.transitions import Transition

SMALL = {
    "bonus_kwargs": {"hidden_dims": (8,), "num_members": 2, "components": 8, "refresh_interval": 2}
}
OFF_POLICY = [SAC, TD3, DDPG, TQC, CrossQ]
TERMINATES_AFTER, CUT_OFF_AFTER = 3, 5


class Clock(gymnasium.Env):
    """Observes time and episode, pays the time; terminates and is cut off by turns."""

    action_space = spaces.Box(-2.0, 2.0, (1,))
    observation_space = spaces.Box(-1e6, 1e6, (2,))

    def __init__(self, start: float = 0.0) -> None:
        self.start, self.episode = start, -1

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.episode = 0 if seed is not None else self.episode + 1
        self.time = 0
        return self.observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        self.time += 1
        even = self.episode % 2 == 0
        terminated = even and self.time == TERMINATES_AFTER
        truncated = not even and self.time == CUT_OFF_AFTER
        return self.observe(), float(self.time), terminated, truncated, {}

    def observe(self) -> np.ndarray:
        return np.array([self.start + self.time, self.episode], dtype=np.float32)


class TwoClocks(Clock):
    """A dictionary, of which the entry `clock` is what a `Clock` observes."""

    observation_space = spaces.Dict(
        {"clock": Clock.observation_space, "other": spaces.Box(-1.0, 1.0, (3,))}
    )

    def observe(self) -> dict[str, np.ndarray]:
        return {"clock": super().observe(), "other": np.full(3, 0.5, dtype=np.float32)}


class Time(Bonus):
    """The first coordinate of the observation, times a factor that is learned or not."""

    def __init__(self, factor: float = 1.0, *, learns: bool = False) -> None:
        super().__init__()
        self.factor = nn.Parameter(torch.tensor(factor), requires_grad=learns)
        self.register_buffer("num_rows", torch.zeros(()))
        self.observed: list[Transition] = []
        self.fresh_actions: list[Tensor] = []

    def forward(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None = None
    ) -> Tensor:
        return self.factor * observation[:, 0]

    def loss(self, transition: Transition) -> Tensor:
        return -self.factor * 1.0

    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        self.num_rows += len(transition.reward)
        self.observed.append(transition)
        if policy is not None:
            self.fresh_actions.append(policy(transition.observation))

    def metrics(self) -> dict[str, Tensor]:
        return {"factor": self.factor.detach()}


def make_agent(
    kind: type = SAC,
    env: Any = None,
    *,
    policy: str = "MlpPolicy",
    buffer: type = CuriousReplayBuffer,
    options: dict[str, Any] | None = None,
    **settings: Any,
) -> Any:
    settings = {"policy_kwargs": {"net_arch": [8]}, "batch_size": 16, "seed": 0} | settings
    return kind(
        policy,
        Clock() if env is None else env,
        buffer_size=100,
        learning_starts=10,
        replay_buffer_class=buffer,
        replay_buffer_kwargs={"bonus": Time()} if options is None else options,
        device="cpu",
        **settings,
    )


def make_rollout_agent(
    env: Any = None, kind: type = PPO, *, policy: str = "MlpPolicy", **options: Any
) -> Any:
    dictionary = policy == "MultiInputPolicy"
    return kind(
        policy,
        Clock() if env is None else env,
        n_steps=20,
        gamma=0.5,
        gae_lambda=0.5,
        seed=0,
        policy_kwargs={"net_arch": [8]},
        rollout_buffer_class=CuriousDictRolloutBuffer if dictionary else CuriousRolloutBuffer,
        rollout_buffer_kwargs={"bonus": Time()} | options,
        device="cpu",
        **({"batch_size": 20} if kind is PPO else {}),
    )


def clocks(*starts: float, kind: type = Clock) -> DummyVecEnv:
    return DummyVecEnv([lambda start=start: kind(start) for start in starts])


def filled(*, env: Any = None, steps: int = 40, **settings: Any) -> Any:
    """An agent that has stored some steps and learned nothing."""
    agent = make_agent(env=env, **settings)
    agent.learning_starts = 1_000
    return agent.learn(steps)


def parameters(agent: Any) -> list[Tensor]:
    return [parameter.detach().clone() for parameter in agent.policy.parameters()]


def assert_equal(one: list[Tensor], other: list[Tensor]) -> None:
    assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


# what a sample is


@pytest.mark.parametrize("kind", OFF_POLICY)
def test_every_agent_learns_from_a_curious_buffer(kind: type) -> None:
    agent = make_agent(kind, options=SMALL)
    agent.learn(20, callback=CuriosityCallback())
    assert int(agent.replay_buffer.attachment.learner.every.num_calls) == 10
    assert all(torch.isfinite(parameter).all() for parameter in parameters(agent))


@pytest.mark.parametrize("name", BONUSES)
def test_every_bonus_serves_by_its_name(name: str) -> None:
    buffer = filled(options={"bonus": name}).replay_buffer
    for _ in range(3):
        samples = buffer.sample(16)
    assert torch.isfinite(samples.rewards).all()
    assert not torch.equal(samples.rewards, samples.observations[:, :1] + 1)


def test_a_sample_holds_reward_plus_bonus_and_leaves_the_stored_reward_alone() -> None:
    buffer = filled(options={"bonus": Time(10.0)}).replay_buffer
    stored = buffer.rewards.copy()
    samples = buffer.sample(50)
    # a step from time t pays t + 1, and its bonus is 10 t
    time = samples.observations[:, :1]
    torch.testing.assert_close(samples.rewards, time + 1 + 10 * time)
    assert np.array_equal(buffer.rewards, stored)


@pytest.mark.parametrize("kind", [SAC, TD3])
def test_an_agent_whose_bonus_is_zero_is_the_plain_agent_bit_for_bit(kind: type) -> None:
    curious = make_agent(kind, options={"bonus": Time(0.0)}).learn(30, CuriosityCallback())
    plain = make_agent(kind, buffer=None, options={}).learn(30)
    if kind is SAC:  # whose fresh actions take random numbers
        curious = make_agent(kind, options={"bonus": Time(0.0)}).learn(30)
    assert_equal(parameters(curious), parameters(plain))


def test_the_bonus_reaches_the_critic() -> None:
    agents = [make_agent(options={"bonus": Time(factor)}).learn(20) for factor in (0.0, 1.0)]
    one, other = [parameters(agent) for agent in agents]
    assert any(not torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_the_bonus_is_computed_after_it_has_learned_from_the_same_batch() -> None:
    bonus = Time(1.0, learns=True)
    buffer = filled(options={"bonus": bonus, "learning_rate": 0.5}).replay_buffer
    for factor in (1.5, 2.0):  # Adam's first steps are as long as the learning rate
        samples = buffer.sample(50)
        time = samples.observations[:, :1]
        torch.testing.assert_close(samples.rewards, time + 1 + factor * time)


def test_the_bonus_takes_gradient_steps_at_its_own_pace() -> None:
    bonus = Time(1.0, learns=True)
    options = {"bonus": bonus, "learning_rate": 0.5, "update_interval": 3}
    buffer = filled(options=options).replay_buffer
    factors = []
    for _ in range(4):
        buffer.sample(10)
        factors.append(bonus.factor.item())
    assert factors == pytest.approx([1.5, 1.5, 1.5, 2.0])
    assert bonus.num_rows == 40


def test_the_bonus_is_given_the_true_end_of_each_episode() -> None:
    bonus = Time()
    filled(options={"bonus": bonus}).replay_buffer.sample(400)
    (batch,) = bonus.observed
    time, episode = batch.next_observation.T
    assert torch.equal(batch.terminated, (episode % 2 == 0) & (time == TERMINATES_AFTER))
    assert torch.equal(batch.truncated, (episode % 2 == 1) & (time == CUT_OFF_AFTER))
    assert torch.equal(time, batch.observation[:, 0] + 1)
    assert torch.equal(episode, batch.observation[:, 1])
    assert batch.terminated.any() and batch.truncated.any()


def test_the_bonus_is_given_actions_between_minus_one_and_one() -> None:
    bonus = Time()
    filled(options={"bonus": bonus}).replay_buffer.sample(400)
    bound = bonus.observed[0].action.abs().max()
    assert 0.8 < bound <= 1.0  # the environment takes them up to 2


def test_each_row_gets_the_bonus_of_its_own_environment() -> None:
    buffer = filled(env=clocks(0.0, 100.0, 200.0)).replay_buffer
    samples = buffer.sample(200)
    time = samples.observations[:, :1]
    torch.testing.assert_close(samples.rewards, time % 100 + 1 + time)
    assert len(torch.unique(time // 100)) == 3


def test_under_normalisation_the_bonus_is_raw_and_added_after() -> None:
    bonus = Time()
    agent = filled(env=VecNormalize(clocks(100.0)), options={"bonus": bonus})
    normalize = agent.get_vec_normalize_env()
    samples = agent.replay_buffer.sample(200, normalize)
    (batch,) = bonus.observed
    normalized = torch.tensor(normalize.normalize_reward(batch.reward.numpy()))
    assert batch.observation[:, 0].min() >= 100
    torch.testing.assert_close(batch.reward, batch.next_observation[:, 0] - 100)
    torch.testing.assert_close(samples.rewards[:, 0], normalized + batch.observation[:, 0])
    assert samples.observations.abs().max() <= 10


def test_fresh_actions_are_what_the_agent_would_do_at_the_batch() -> None:
    bonus = Time()
    env = VecNormalize(clocks(100.0))
    agent = make_agent(TD3, env, options={"bonus": bonus}).learn(12, CuriosityCallback())
    bonus.fresh_actions.clear()
    samples = agent.replay_buffer.sample(16, agent.get_vec_normalize_env())
    (fresh,) = bonus.fresh_actions
    assert torch.equal(fresh, agent.actor(samples.observations))


def test_without_the_callback_the_actions_of_the_batch_are_taken() -> None:
    bonus = Time()
    make_agent(options={"bonus": bonus}).learn(12)
    assert bonus.observed and not bonus.fresh_actions


def test_agents_that_share_a_callback_are_each_asked_for_their_own_actions() -> None:
    callback = CuriosityCallback()
    agents = [make_agent(TD3, seed=seed).learn(12, callback) for seed in (0, 1)]
    observation = torch.ones(4, 2)
    for agent in agents:
        asked = agent.replay_buffer.attachment.actor(observation)
        assert torch.equal(asked, agent.actor(observation))


def test_the_policy_is_known_at_the_batch_only() -> None:
    class Curious(Time):
        def observe(
            self,
            transition: Transition,
            policy: Policy | None = None,
            visited: Transition | None = None,
        ) -> None:
            assert policy is not None
            policy(transition.next_observation)

    agent = make_agent(options={"bonus": Curious()})
    with pytest.raises(
        ValueError, match=r"`policy` must be called with `transition\.observation`"
    ):
        agent.learn(12, CuriosityCallback())


def test_fresh_actions_leave_batch_normalisation_as_it_was() -> None:
    agent = make_agent(CrossQ).learn(12, callback=CuriosityCallback())
    agent.policy.set_training_mode(True)
    before = {name: value.clone() for name, value in agent.actor.state_dict().items()}
    agent.replay_buffer.sample(16)
    assert_equal(list(before.values()), list(agent.actor.state_dict().values()))
    assert all(part.training for part in agent.actor.modules())


# several steps


def test_several_steps_sum_discounted_bonuses_within_the_episode() -> None:
    options = {"bonus": Time(10.0), "n_steps": 3, "gamma": 0.5}
    buffer = filled(buffer=CuriousNStepReplayBuffer, options=options).replay_buffer
    # the first episode lasts 3 steps, the second 5: rows 0-2 and 3-7
    rows = np.array([0, 1, 2, 3, 6, 7])
    expected = [
        (1 + 0) + 0.5 * (2 + 10) + 0.25 * (3 + 20),
        (2 + 10) + 0.5 * (3 + 20),
        3 + 20,
        (1 + 0) + 0.5 * (2 + 10) + 0.25 * (3 + 20),
        (4 + 30) + 0.5 * (5 + 40),
        5 + 40,
    ]
    samples = buffer._get_samples(rows)
    assert samples.rewards[:, 0].tolist() == pytest.approx(expected)


def test_several_steps_stop_at_the_newest_one_also_in_a_full_buffer() -> None:
    options = {"bonus": Time(10.0), "n_steps": 3, "gamma": 0.5}
    agent = filled(buffer=CuriousNStepReplayBuffer, options=options, steps=142)
    buffer = agent.replay_buffer
    time = buffer.observations[:, 0, 0]
    newest = buffer.pos - 1  # 142 steps: 17 pairs of episodes of 8 steps, and 6 more
    samples = buffer._get_samples(np.array([newest - 1, newest]))
    assert buffer.full and time[newest] == 2
    assert samples.rewards[:, 0].tolist() == [(2 + 10) + 0.5 * (3 + 20), 3 + 20]


def test_several_steps_without_bonus_are_those_of_the_library() -> None:
    options = {"n_steps": 3, "gamma": 0.9}
    settings = {"env": clocks(0.0, 100.0), "steps": 260}
    zero = options | {"bonus": Time(0.0)}
    curious = filled(buffer=CuriousNStepReplayBuffer, options=zero, **settings)
    plain = filled(buffer=NStepReplayBuffer, options=options, **settings)
    samples = []
    for agent in (curious, plain):
        set_random_seed(1)
        samples.append([*agent.replay_buffer.sample(200), *agent.replay_buffer.sample(200)])
    assert_equal(*samples)


def test_an_agent_learns_from_several_steps() -> None:
    options = SMALL | {"n_steps": 3, "gamma": 0.99}
    agent = make_agent(TQC, buffer=CuriousNStepReplayBuffer, options=options)
    agent.learn(20, callback=CuriosityCallback())
    assert all(torch.isfinite(parameter).all() for parameter in parameters(agent))


def test_several_steps_refuse_another_discount_than_the_agents() -> None:
    options = {"bonus": Time(), "n_steps": 3, "gamma": 0.9}
    agent = make_agent(buffer=CuriousNStepReplayBuffer, options=options)
    with pytest.raises(ValueError, match=r"`gamma` .* must be that of the agent, 0.99, got 0.9"):
        agent.learn(1, callback=CuriosityCallback())


@pytest.mark.parametrize("normalized", [False, True])
def test_several_steps_end_where_the_environment_was_reset(normalized: bool) -> None:
    env = clocks(0.0)
    agent = filled(
        env=VecNormalize(env) if normalized else env,
        buffer=CuriousNStepReplayBuffer,
        options={"bonus": Time(10.0), "n_steps": 3, "gamma": 0.5},
        steps=2,
    )
    buffer = agent.learn(20).replay_buffer
    samples = buffer._get_samples(np.array([0, 1]))
    assert buffer.next_observations[1, 0, 0] == 2 and buffer.observations[2, 0, 0] == 0
    assert samples.rewards[:, 0].tolist() == [(1 + 0) + 0.5 * (2 + 10), 2 + 10]
    assert samples.next_observations[:, 0].tolist() == [2, 2]
    assert samples.dones[:, 0].tolist() == [0, 0]
    assert samples.discounts[:, 0].tolist() == [0.25, 0.5]


def test_what_has_terminated_is_not_cut_off_by_a_reset() -> None:
    options = {"bonus": Time(), "n_steps": 3, "gamma": 0.5}
    agent = filled(buffer=CuriousNStepReplayBuffer, options=options, steps=TERMINATES_AFTER)
    buffer = agent.learn(20).replay_buffer
    end = TERMINATES_AFTER - 1
    assert buffer.dones[end] and not buffer.timeouts[end]
    assert buffer._get_samples(np.array([end])).dones == 1


def test_several_steps_go_on_where_nothing_was_reset() -> None:
    options = {"bonus": Time(10.0), "n_steps": 3, "gamma": 0.5}
    agent = filled(buffer=CuriousNStepReplayBuffer, options=options, steps=2)
    buffer = agent.learn(20, reset_num_timesteps=False).replay_buffer
    samples = buffer._get_samples(np.array([0]))
    assert samples.rewards.item() == (1 + 0) + 0.5 * (2 + 10) + 0.25 * (3 + 20)


def test_several_steps_end_before_a_step_that_a_callback_dropped() -> None:
    options = {"bonus": Time(10.0), "n_steps": 3, "gamma": 0.5}
    agent = make_agent(gamma=0.5, buffer=CuriousNStepReplayBuffer, options=options)
    agent.learn(6, callback=[StopAt(6), CuriosityCallback()])  # row 4 is from time 1 to 2
    buffer = agent.learn(20, CuriosityCallback(), reset_num_timesteps=False).replay_buffer
    assert buffer.observations[4:6, 0, 0].tolist() == [1, 3]
    samples = buffer._get_samples(np.array([4]))
    assert samples.rewards.item() == 2 + 10 and samples.next_observations[0, 0] == 2


def test_a_discount_of_one_may_be_whole() -> None:
    options = {"bonus": Time(10.0), "n_steps": 3, "gamma": 1}
    agent = make_agent(gamma=1, buffer=CuriousNStepReplayBuffer, options=options)
    buffer = agent.learn(20, CuriosityCallback()).replay_buffer
    assert buffer._get_samples(np.array([0])).rewards.item() == 1 + (2 + 10) + (3 + 20)


class Precise(Time):
    """The same in float64."""

    def forward(self, *arguments: Any) -> Tensor:
        return super().forward(*arguments).double()


@pytest.mark.parametrize("kind", ["replay", "several steps", "rollout"])
def test_a_bonus_may_be_more_precise_than_rewards(kind: str) -> None:
    options: dict[str, Any] = {"bonus": Precise(10.0)}
    if kind == "rollout":
        agent = make_rollout_agent(**options)
    elif kind == "several steps":
        options |= {"n_steps": 3, "gamma": 0.99}
        agent = make_agent(buffer=CuriousNStepReplayBuffer, options=options)
    else:
        agent = make_agent(options=options)
    agent.learn(20, CuriosityCallback())
    assert all(torch.isfinite(parameter).all() for parameter in parameters(agent))


# dictionaries


def test_of_a_dictionary_the_bonus_is_given_one_entry() -> None:
    bonus = Time()
    agent = make_agent(
        env=VecNormalize(clocks(0.0, 100.0, kind=TwoClocks)),
        policy="MultiInputPolicy",
        buffer=CuriousDictReplayBuffer,
        options={"bonus": bonus, "observation_key": "clock"},
    )
    agent.learn(30, callback=CuriosityCallback())
    samples = agent.replay_buffer.sample(200)
    time = samples.observations["clock"][:, :1]
    torch.testing.assert_close(samples.rewards, time % 100 + 1 + time)
    assert bonus.observed[-1].observation.shape == (200, 2)
    assert bonus.fresh_actions[0].shape == (16, 1)


# saving


def test_a_loaded_buffer_goes_on_bit_for_bit(tmp_path: Path) -> None:
    agent = make_agent(options=SMALL).learn(20, callback=CuriosityCallback())
    agent.save_replay_buffer(tmp_path / "buffer.pkl")
    other = make_agent(options=SMALL)
    other.load_replay_buffer(tmp_path / "buffer.pkl")
    agent.replay_buffer.attachment.actor = None  # the agent is not saved with the buffer
    samples = []
    for buffer in (agent.replay_buffer, other.replay_buffer):
        set_random_seed(1)
        samples.append([buffer.sample(16).rewards for _ in range(5)])
    assert_equal(*samples)
    states = [
        b.attachment.learner.state_dict() for b in (agent.replay_buffer, other.replay_buffer)
    ]
    assert states[0].keys() == states[1].keys()
    assert_equal(*(list(state.values()) for state in states))


def test_the_agent_is_not_pickled_with_its_buffer() -> None:
    agent = make_agent(options=SMALL).learn(12, callback=CuriosityCallback())
    buffer = pickle.loads(pickle.dumps(agent.replay_buffer))
    assert agent.replay_buffer.attachment.actor is not None
    assert buffer.attachment.actor is None


def test_a_saved_agent_is_made_again_with_its_buffer_class_and_options(tmp_path: Path) -> None:
    agent = make_agent(options=SMALL | {"bonus": "rnd", "bonus_kwargs": {"hidden_dims": (8,)}})
    agent.learn(12, callback=CuriosityCallback())
    agent.save(tmp_path / "agent")
    loaded = SAC.load(tmp_path / "agent", env=Clock())
    assert type(loaded.replay_buffer) is CuriousReplayBuffer
    assert type(loaded.replay_buffer.bonus) is type(agent.replay_buffer.bonus)
    loaded.learn(12, callback=CuriosityCallback())


@pytest.mark.parametrize("make", [make_rollout_agent, make_agent], ids=["PPO", "SAC"])
def test_a_saved_agent_holds_a_bonus_of_ones_own_as_it_was_trained(
    make: Callable[..., Any], tmp_path: Path
) -> None:
    bonus = Time(learns=True)
    options = {"bonus": bonus} if make is make_rollout_agent else {"options": {"bonus": bonus}}
    agent = make(**options).learn(20, callback=CuriosityCallback())
    agent.save(tmp_path / "agent")
    loaded = type(agent).load(tmp_path / "agent", env=Clock())
    buffer = getattr(loaded, "replay_buffer", None) or loaded.rollout_buffer
    assert bonus.factor != 1 and torch.equal(buffer.bonus.factor, bonus.factor)


def test_an_agent_that_was_resumed_is_saved_with_the_bonus_of_its_loaded_buffer(
    tmp_path: Path,
) -> None:
    agent = make_agent(options={"bonus": Time(learns=True)}).learn(20, CuriosityCallback())
    agent.save(tmp_path / "agent"), agent.save_replay_buffer(tmp_path / "buffer")
    resumed = SAC.load(tmp_path / "agent", env=Clock())
    resumed.load_replay_buffer(tmp_path / "buffer")
    options = resumed.replay_buffer_kwargs
    resumed.learn(20, CuriosityCallback(), reset_num_timesteps=False).save(tmp_path / "resumed")
    trained = resumed.replay_buffer.bonus.factor
    assert SAC.load(tmp_path / "resumed").replay_buffer.bonus.factor == trained
    assert options["bonus"].factor == agent.replay_buffer.bonus.factor != trained


def test_a_rollout_agent_that_was_resumed_is_saved_with_the_bonus_of_its_loaded_buffer(
    tmp_path: Path,
) -> None:
    agent = make_rollout_agent(bonus=Time(learns=True)).learn(20, CuriosityCallback())
    agent.save(tmp_path / "agent"), save_to_pkl(tmp_path / "buffer", agent.rollout_buffer)
    resumed = PPO.load(tmp_path / "agent", env=Clock())
    resumed.rollout_buffer = load_from_pkl(tmp_path / "buffer")
    resumed.learn(20, CuriosityCallback(), reset_num_timesteps=False).save(tmp_path / "resumed")
    trained = resumed.rollout_buffer.bonus.factor
    assert PPO.load(tmp_path / "resumed").rollout_buffer.bonus.factor == trained
    assert agent.rollout_buffer.bonus.factor != trained


def test_the_bonus_follows_the_device_of_the_buffer() -> None:
    attachment = filled(options=SMALL).replay_buffer.attachment
    attachment.to(torch.device("meta"))
    tensors = [*attachment.learner.parameters(), *attachment.learner.buffers()]
    assert {tensor.device.type for tensor in tensors} == {"meta"}


# logging


def logged(agent: Any, steps: int, callback: CuriosityCallback) -> list[dict[str, float]]:
    """What the agent's logger holds at each of its dumps."""
    dumps: list[dict[str, float]] = []

    class Memory(Logger):
        def dump(self, step: int = 0) -> None:
            dumps.append(dict(self.name_to_value))
            super().dump(step)

    agent.set_logger(Memory(None, []))
    agent.learn(steps, callback=callback, log_interval=1)
    return dumps


def test_the_callback_logs_the_bonus_with_the_librarys_own_logs() -> None:
    dumps = logged(make_agent(), 30, CuriosityCallback(log_interval=1))
    assert dumps[-1]["curiosity/factor"] == 1.0
    assert dumps[-1]["curiosity/bonus"] > 0
    assert "curiosity/bonus" not in dumps[0]  # the bonus has observed nothing yet


def test_the_callback_logs_no_more_often_than_its_interval() -> None:
    dumps = logged(make_agent(), 40, CuriosityCallback(log_interval=1_000))
    assert sum("curiosity/bonus" in dump for dump in dumps) == 1


# rollouts


def reference_advantages(rewards: list[float], ends: list[bool], discount: float) -> list[float]:
    """Advantages where all values are zero: sums discounted by `discount` within the episode."""
    advantages, later = [], 0.0
    for reward, end in zip(reversed(rewards), reversed(ends), strict=True):
        later = reward + (0.0 if end else discount * later)
        advantages.append(later)
    return advantages[::-1]


def test_advantages_come_from_reward_plus_bonus_and_rewards_stay() -> None:
    agent = make_rollout_agent(bonus=Time(10.0))
    for parameter in agent.policy.value_net.parameters():
        nn.init.zeros_(parameter)
    agent.train = lambda: None  # the rollout stays as it was collected
    agent.learn(20, callback=CuriosityCallback())
    buffer = agent.rollout_buffer
    times = [0, 1, 2, *range(5)] * 2 + [0, 1, 2, 0]
    rewards = [time + 1 + 10 * time for time in times]
    ends = [*([False] * 2), True, *([False] * 4), True] * 2 + [False, False, True, False]
    expected = reference_advantages(rewards, ends, discount=0.25)
    assert buffer.advantages[:, 0].tolist() == pytest.approx(expected)
    assert buffer.rewards[:, 0].tolist() == [time + 1 for time in times]


@pytest.mark.parametrize("kind", [PPO, A2C])
def test_rollouts_hold_the_true_next_observation_and_how_an_episode_ended(kind: type) -> None:
    agent = make_rollout_agent(clocks(0.0, 100.0), kind)
    agent.learn(40, callback=CuriosityCallback())
    rollout = agent.rollout_buffer.transition()
    time, episode = rollout.next_observation.T
    assert torch.equal(time, rollout.observation[:, 0] + 1)
    assert torch.equal(episode, rollout.observation[:, 1])
    assert torch.equal(rollout.terminated, (episode % 2 == 0) & (time % 100 == TERMINATES_AFTER))
    assert torch.equal(rollout.truncated, (episode % 2 == 1) & (time % 100 == CUT_OFF_AFTER))
    assert torch.equal(rollout.reward, time % 100)  # no value of the next state is in it


def test_rollouts_go_on_where_the_last_one_stopped() -> None:
    agent = make_rollout_agent()
    agent.learn(20, callback=CuriosityCallback())
    last = agent.rollout_buffer.transition().next_observation[-1]
    agent.learn(20, callback=CuriosityCallback(), reset_num_timesteps=False)
    assert torch.equal(agent.rollout_buffer.transition().observation[0], last)


class StopAt(BaseCallback):
    """Stops learning after so many steps."""

    def __init__(self, num_steps: int) -> None:
        super().__init__()
        self.num_steps = num_steps

    def _on_step(self) -> bool:
        return self.num_timesteps != self.num_steps


@pytest.mark.parametrize("stop", [26, 27])  # within an episode, and at the end of one
@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("kind", [PPO, SAC])
def test_what_a_callback_stops_goes_on_in_single_steps(
    kind: type, normalized: bool, stop: int
) -> None:
    bonus = Time()
    env = VecNormalize(clocks(0.0)) if normalized else clocks(0.0)
    agent = make_rollout_agent(env, bonus=bonus)
    if kind is SAC:
        agent = make_agent(env=env, options={"bonus": bonus})
    agent.learn(40, callback=[StopAt(stop), CuriosityCallback()])
    agent.learn(40, callback=CuriosityCallback(), reset_num_timesteps=False)
    shown = Transition(*(torch.cat(field) for field in zip(*bonus.observed, strict=True)))
    torch.testing.assert_close(shown.next_observation[:, 0], shown.observation[:, 0] + 1)
    torch.testing.assert_close(shown.next_observation[:, 1], shown.observation[:, 1])


def test_rollouts_clip_actions_and_scale_them() -> None:
    agent = make_rollout_agent()
    nn.init.constant_(agent.policy.log_std, 1.0)
    agent.train = lambda: None
    agent.learn(20, callback=CuriosityCallback())
    buffer = agent.rollout_buffer
    sampled = torch.tensor(buffer.actions[:, 0])
    torch.testing.assert_close(buffer.transition().action, sampled.clamp(-2, 2) / 2)
    assert sampled.abs().max() > 2


def test_rollouts_are_raw_under_normalisation() -> None:
    agent = make_rollout_agent(VecNormalize(clocks(100.0)))
    agent.learn(40, callback=CuriosityCallback())
    rollout = agent.rollout_buffer.transition()
    assert rollout.observation[:, 0].min() >= 100
    torch.testing.assert_close(rollout.next_observation[:, 0], rollout.observation[:, 0] + 1)
    torch.testing.assert_close(rollout.reward, rollout.next_observation[:, 0] - 100)
    assert not np.allclose(agent.rollout_buffer.rewards.max(), CUT_OFF_AFTER)


def test_of_a_dictionary_in_a_rollout_the_bonus_is_given_one_entry() -> None:
    bonus = Time()
    agent = make_rollout_agent(
        TwoClocks(), policy="MultiInputPolicy", bonus=bonus, observation_key="clock"
    )
    agent.learn(20, callback=CuriosityCallback())
    rollout = agent.rollout_buffer.transition()
    assert torch.equal(rollout.next_observation[:, 0], rollout.observation[:, 0] + 1)


@pytest.mark.parametrize(("ready", "shown"), [(True, [20]), (False, [8, 12])])
def test_the_bonus_goes_through_a_rollout_in_minibatches_and_observes_every_step_once(
    monkeypatch: pytest.MonkeyPatch, ready: bool, shown: list[int]
) -> None:
    monkeypatch.setattr(Time, "ready", ready)
    bonus = Time(learns=True)
    agent = make_rollout_agent(bonus=bonus, batch_size=8, epochs=3)
    agent.learn(20, callback=CuriosityCallback())
    assert [len(batch.reward) for batch in bonus.observed] == shown
    for batch, action in zip(bonus.observed, bonus.fresh_actions, strict=True):
        assert torch.equal(batch.action, action)
    assert bonus.factor.item() == pytest.approx(1 + 3 * 3 * 1e-3)  # Adam's steps, three an epoch
    times = torch.cat([batch.observation[:, 0] for batch in bonus.observed])
    assert torch.equal(
        times.sort().values, agent.rollout_buffer.transition().observation[:, 0].sort().values
    )


def test_a_rollout_without_the_callback_says_what_is_missing() -> None:
    with pytest.raises(RuntimeError, match=r"20 steps has 0 on record.*CuriosityCallback\(\)"):
        make_rollout_agent().learn(20)


def test_two_callbacks_on_a_rollout_are_one_too_many() -> None:
    callbacks = [CuriosityCallback(), CuriosityCallback()]
    with pytest.raises(RuntimeError, match=r"20 steps has 40 .*give one CuriosityCallback only"):
        make_rollout_agent().learn(20, callback=callbacks)


def test_a_rollout_is_paid_a_bonus_that_is_centred_over_it_and_scaled() -> None:
    """None of its states is a component when it is scored, and all are scored alike."""
    paid = []

    class Watched(CuriousRolloutBuffer):
        def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
            super().compute_returns_and_advantage(last_values, dones)
            paid.append(self.attachment.compute(self.transition()) / 0.1)

    agent = PPO(
        "MlpPolicy",
        "HalfCheetah-v5",
        n_steps=1_024,
        n_epochs=1,
        seed=0,
        rollout_buffer_class=Watched,
        rollout_buffer_kwargs={"bonus_kwargs": {"hidden_dims": (16,)}},
        device="cpu",
    )
    agent.learn(4 * 1_024, callback=CuriosityCallback(log_interval=10_000))
    for bonus in paid[1:]:
        assert bonus.mean().abs() < 0.1 and 0.8 < bonus.std() < 1.25


def test_a_bonus_of_ones_own_looks_at_rollouts_at_its_pace_in_minibatches() -> None:
    observed = []

    class Watched(CuriosityBonus):
        def observe(self, transition: Transition, *args: Any) -> None:
            observed.append(not self.should_skip)
            super().observe(transition, *args)

    parts = CuriosityBonus.default(2, 1, hidden_dims=(8,), refresh_interval=5)
    bonus = Watched(parts.dynamics, parts.marginal, refresh_interval=5)
    agent = make_rollout_agent(bonus=bonus, batch_size=10)
    agent.learn(120, callback=CuriosityCallback())
    # the first rollout in two parts, each later one whole: calls 0, 1; 3; 5; 7; 9; 10
    assert observed == [True, False, False, True, False, False, True]


@pytest.mark.parametrize("tuned", [1e4, "past"])
def test_the_weight_of_a_bonus_is_tuned_by_rollouts(tuned: float | str) -> None:
    agent = make_rollout_agent(bonus="curiosity", bonus_kwargs={"tune_bonus_weight": tuned})
    agent.learn(200, callback=CuriosityCallback())
    assert agent.rollout_buffer.bonus.tuned_weight.factor.item() != 1


def make_replay_agent(**options: Any) -> Any:
    return make_agent(options=options)


@pytest.mark.parametrize("make", [make_replay_agent, make_rollout_agent])
def test_a_bonus_that_could_not_be_computed_here_is_refused_at_once(
    make: Callable[..., Any],
) -> None:
    small = {"hidden_dims": (8,), "num_members": 2}
    for sizes in ((3, 1), (2, 2)):
        with pytest.raises(ValueError, match=r"`bonus` must be for spaces with .*observation_dim"):
            make(bonus=CuriosityBonus.default(*sizes, **small))
    frozen = FrozenBonus(CuriosityBonus.default(2, 1, **small))
    with pytest.raises(
        ValueError, match="`bonus` must observe batches, or be ready, got a Frozen"
    ):
        make(bonus=frozen)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"n_steps": 0}, ValueError, "`n_steps` must be at least 1, got 0"),
        ({"n_steps": 2.5}, TypeError, "`n_steps` must be a whole number, got 2.5"),
        ({"gamma": -2.0}, ValueError, "`gamma` must be a number from 0 to 1, got -2.0"),
        ({"gamma": float("nan")}, ValueError, "`gamma` must be a number from 0 to 1, got nan"),
        ({"gamma": "0.9"}, ValueError, "`gamma` must be a number from 0 to 1, got '0.9'"),
    ],
)
def test_returns_of_several_steps_have_a_number_of_them_and_a_discount(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        make_agent(buffer=CuriousNStepReplayBuffer, options=options)


@pytest.mark.parametrize("name", ["curiosity", "rnd"])
def test_a_named_bonus_looks_at_every_batch_of_a_rollout_unless_told_otherwise(name: str) -> None:
    def interval_of(**settings: Any) -> int:
        agent = make_rollout_agent(bonus=name, bonus_kwargs=settings)
        return int(agent.rollout_buffer.bonus.every.interval)

    assert interval_of() == 1 and interval_of(refresh_interval=3) == 3


@pytest.mark.slow
def test_short_rollouts_are_paid_a_bonus_of_about_its_weight() -> None:
    paid = []

    class Watched(CuriousRolloutBuffer):
        def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
            super().compute_returns_and_advantage(last_values, dones)
            paid.append(self.attachment.compute(self.transition()))

    agent = A2C("MlpPolicy", "Pendulum-v1", seed=0, rollout_buffer_class=Watched, device="cpu")
    agent.learn(2_000, callback=CuriosityCallback())
    late = torch.cat(paid)[-1_500:] / 0.1
    assert late.mean().abs() < 0.5 and 0.4 < late.std() < 1.5


def test_the_default_bonus_serves_a_rollout_and_is_logged() -> None:
    agent = make_rollout_agent(bonus="curiosity", **SMALL)
    dumps = logged(agent, 40, CuriosityCallback(log_interval=1))
    assert all("curiosity/nats" in dump for dump in dumps)


def test_a_saved_rollout_buffer_brings_its_bonus(tmp_path: Path) -> None:
    agent = make_rollout_agent(bonus="curiosity", **SMALL)
    agent.learn(20, callback=CuriosityCallback())
    agent.save(tmp_path / "agent"), save_to_pkl(tmp_path / "buffer", agent.rollout_buffer)
    loaded = PPO.load(tmp_path / "agent", env=Clock())
    loaded.rollout_buffer = load_from_pkl(tmp_path / "buffer")
    states = [a.rollout_buffer.attachment.learner.state_dict() for a in (agent, loaded)]
    assert_equal(*(list(state.values()) for state in states))
    loaded.learn(20, callback=CuriosityCallback())


# what is refused


class Image(Clock):
    observation_space = spaces.Box(0, 255, (3, 36, 36), dtype=np.uint8)


class Discrete(Clock):
    action_space = spaces.Discrete(2)


class Bytes(Clock):
    action_space = spaces.Box(0, 255, (2,), dtype=np.uint8)


FLAT = np.array([0.0, 1.0], np.float32)
WIDTH = "`action_space` must have a finite and positive `high - low` in float32, got Box"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: make_rollout_agent(Discrete()), "`action_space` must be a Box of vectors"),
        (
            lambda: CuriousRolloutBuffer(
                20, Clock.observation_space, spaces.Box(-np.inf, np.inf, (1,))
            ),
            "`action_space` must be bounded",
        ),
        (
            lambda: CuriousRolloutBuffer(
                20, Clock.observation_space, spaces.Box(np.zeros(2, np.float32), FLAT)
            ),
            "`action_space` must have `low` below `high`",
        ),
        (lambda: bounded_space(spaces.Box(-3e38, 3e38, (2,))), WIDTH),
        (lambda: bounded_space(spaces.Box(-1e300, 1.0, (1,), np.float64)), WIDTH),
        (lambda: bounded_space(spaces.Box(1.0, 1.0 + 1e-12, (1,), np.float64)), WIDTH),
        (
            lambda: bounded_space(spaces.Box(-100, 100, (2,), np.int8)),
            r"`action_space` must be of a floating dtype, got Box\(-100, 100, \(2,\), int8\)",
        ),
        (
            lambda: make_agent(env=Bytes()),
            "`action_space` must be of a floating dtype, got Box.*uint8",
        ),
        (
            lambda: make_agent(env=Image(), policy="CnnPolicy"),
            "`observation_space` must be a Box of vectors",
        ),
        (
            lambda: make_agent(env=TwoClocks(), policy="MultiInputPolicy"),
            "`replay_buffer_class` must be CuriousDictReplayBuffer",
        ),
        (
            lambda: make_agent(
                env=TwoClocks(), policy="MultiInputPolicy", buffer=CuriousDictReplayBuffer
            ),
            "`observation_key` must be one of 'clock', 'other', got None",
        ),
        (
            lambda: make_agent(options={"observation_key": "clock"}),
            "`observation_key` is for dictionary observations, got 'clock'",
        ),
        (
            lambda: make_agent(
                options={"handle_timeout_termination": False}, optimize_memory_usage=True
            ),
            "`optimize_memory_usage` must be False, got True",
        ),
        (lambda: make_agent(options={"bonus": "boredom"}), "`bonus` must be one of .*'boredom'"),
        (
            lambda: make_agent(options={"bonus": Time(), "bonus_kwargs": {"bonus_weight": 1.0}}),
            "`bonus_kwargs` is for a bonus given by name",
        ),
        (lambda: make_agent(options={"learning_rate": 0.0}), "`learning_rate` must be positive"),
        (lambda: make_agent(options={"update_interval": 0}), "`update_interval` must be at least"),
        (lambda: make_rollout_agent(epochs=0), "`epochs` must be at least 1, got 0"),
        (lambda: CuriosityCallback(log_interval=0), "`log_interval` must be at least 1, got 0"),
    ],
)
def test_what_cannot_work_is_refused_at_the_door(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_actions_are_scaled_by_a_width_that_their_dtype_may_not_hold(dtype: type) -> None:
    space = spaces.Box(dtype(-6e4), dtype(6e4), (1,), dtype)
    action = np.array([space.low, np.zeros(1, dtype), space.high])
    assert scaled(action, space).flatten().tolist() == [-1.0, 0.0, 1.0]


@pytest.mark.parametrize("name", ["model_learning_rate", "marginal_half_life"])
def test_a_setting_that_only_the_trainer_reads_is_refused(name: str) -> None:
    with pytest.raises(TypeError, match=f"`{name}` must be left out, got 0.5: only the trainer"):
        make_agent(options={"bonus_kwargs": {name: 0.5}})


def test_an_unknown_setting_of_the_bonus_is_answered_with_those_there_are() -> None:
    for name in ("members_per_row", "hidden_dim", "weight"):
        with pytest.raises(
            TypeError, match=f"`{name}` is no setting here[;,] .*members.*hidden_dims"
        ):
            make_agent(options={"bonus_kwargs": {name: 2}})


def test_a_bonus_must_be_a_name_or_a_bonus() -> None:
    with pytest.raises(TypeError, match="bonus"):
        make_agent(options={"bonus": Time})


def test_the_callback_refuses_an_agent_without_a_curious_buffer() -> None:
    with pytest.raises(TypeError, match="needs a curious buffer"):
        make_agent(buffer=None, options={}).learn(1, callback=CuriosityCallback())


class WithoutEnds(DummyVecEnv):
    """Resets at the end of an episode and leaves nothing of it."""

    def step_wait(self) -> Any:
        *step, infos = super().step_wait()
        for info in infos:
            info.pop("terminal_observation", None)
        return *step, infos


@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("make", [make_rollout_agent, make_agent], ids=["PPO", "SAC"])
def test_an_episode_without_its_last_observation_is_refused(
    make: Callable[..., Any], normalized: bool
) -> None:
    env: Any = WithoutEnds([Clock])
    agent = make(env=VecNormalize(env) if normalized else env)
    with pytest.raises(ValueError, match=r"`terminal_observation` .*got \['TimeLimit.truncated'"):
        agent.learn(20, callback=CuriosityCallback())


# as the check handles it


WRAPPED: dict[str, Callable[[DummyVecEnv], Any]] = {
    "plain": lambda env: env,
    "normalised": VecNormalize,
    "stacked": lambda env: VecFrameStack(env, 2),
    "normalised stack": lambda env: VecNormalize(VecFrameStack(env, 2)),
    "monitored": lambda env: VecMonitor(VecNormalize(VecMonitor(VecFrameStack(env, 2)))),
}


@pytest.mark.parametrize("kind", [SAC, TD3])
@pytest.mark.parametrize("wrap", WRAPPED.values(), ids=WRAPPED.keys())
def test_what_is_stored_is_what_the_environments_gave(
    kind: type, wrap: Callable[[DummyVecEnv], Any]
) -> None:
    agent = make_agent(kind, wrap(clocks(0.0, 100.0)))
    integration = StableBaselinesIntegration(agent, Clock)
    truth = integration.collect(40, seed=0)
    assert len(truth.reward) == 80
    for one, other in zip(truth, integration.stored(), strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("wrap", WRAPPED.values(), ids=WRAPPED.keys())
def test_what_is_on_record_is_what_the_environments_gave(
    wrap: Callable[[DummyVecEnv], Any],
) -> None:
    agent = make_rollout_agent(wrap(clocks(0.0, 100.0)))
    integration = StableBaselinesOnPolicyIntegration(agent, Clock)
    truth = integration.collect(20, seed=0)
    for one, other in zip(truth, integration.stored(), strict=True):
        torch.testing.assert_close(one, other)


def test_collecting_leaves_an_environment_keeping_its_raw_ends() -> None:
    env = VecNormalize(clocks(0.0))
    agent = make_agent(env=env).learn(4, CuriosityCallback())
    keeping = env.venv.step_wait
    StableBaselinesIntegration(agent, Clock).collect(20, seed=0)
    assert env.venv.step_wait is keeping


def test_what_the_check_collects_stays_in_replay_and_statistics_but_not_in_the_count() -> None:
    env = VecNormalize(clocks(0.0))
    agent = make_agent(env=env).learn(12, CuriosityCallback())
    num_rows, num_observed = agent.replay_buffer.size(), env.obs_rms.count
    checked = StableBaselinesIntegration(agent, Clock)
    checked.collect(30, seed=0)
    checked.release()
    assert agent.replay_buffer.size() == num_rows + 30
    assert env.obs_rms.count == pytest.approx(num_observed + 1 + 30)  # and the reset
    assert agent.num_timesteps == 12


def without_environment() -> Any:
    agent = make_agent()
    agent.env = None
    return agent


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (
            lambda: StableBaselinesIntegration(make_agent(buffer=None, options={}), Clock),
            TypeError,
            "`model` must have `replay_buffer_class=CuriousReplayBuffer`.*, got SAC with Replay",
        ),
        (
            lambda: StableBaselinesIntegration(make_rollout_agent(), Clock),
            TypeError,
            "`model` must .*StableBaselinesOnPolicyIntegration.*, got PPO without `replay_buffer`",
        ),
        (
            lambda: StableBaselinesOnPolicyIntegration(make_agent(), Clock),
            TypeError,
            "`model` must .*StableBaselinesIntegration.*, got SAC without `rollout_buffer`",
        ),
        (
            lambda: StableBaselinesIntegration(make_agent(), Clock()),
            TypeError,
            "`make_env` must be a function .*, got <.*Clock object",
        ),
        (
            lambda: StableBaselinesIntegration(without_environment(), Clock),
            ValueError,
            "`model` must have an environment.*, got None",
        ),
    ],
)
def test_what_cannot_be_checked_is_refused_at_the_door(
    make: Callable[[], Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        make()


def test_a_full_buffer_is_read_oldest_first() -> None:
    integration = StableBaselinesIntegration(make_agent(), Clock)
    truth = integration.collect(130, seed=0)
    newest = Transition(*(field[-100:] for field in truth))
    for one, other in zip(newest, integration.stored(), strict=True):
        torch.testing.assert_close(one, other)


def integrations(kind: str, **options: Any) -> Any:
    if kind == "PPO":
        return StableBaselinesOnPolicyIntegration(make_rollout_agent(**options), Clock)
    agent = make_agent({"SAC": SAC, "TD3": TD3}[kind], options=options)
    return StableBaselinesIntegration(agent, Clock)


@pytest.mark.parametrize("kind", ["SAC", "TD3", "PPO"])
def test_collecting_learns_nothing_and_learning_moves_critic_actor_and_bonus(kind: str) -> None:
    integration = integrations(kind, **(SMALL | {"bonus": "curiosity"}))
    parts = {
        "critic": integration.critic(),
        "actor": integration.actor(),
        "bonus": list(integration.bonus.dynamics.parameters()),
    }
    before = {name: [value.clone() for value in part] for name, part in parts.items()}
    truth = integration.collect(30, seed=0)
    for name, part in parts.items():
        assert_equal(before[name], part)
    integration.learn(seed=0)
    for name, part in parts.items():
        assert any(not torch.equal(a, b) for a, b in zip(before[name], part, strict=True)), name
    for one, other in zip(truth, integration.stored(), strict=True):
        torch.testing.assert_close(one, other)


@pytest.mark.parametrize("kind", ["SAC", "PPO"])
def test_the_check_gives_logger_counts_and_length_of_rollouts_back(kind: str) -> None:
    integration = integrations(kind)
    agent = integration.model
    agent.learn(40, callback=CuriosityCallback())
    own = StableBaselinesOnPolicyIntegration if kind == "PPO" else StableBaselinesIntegration
    names = ("num_timesteps", "n_steps", "logger")
    before = [getattr(agent, name, None) for name in names]
    checked = own(agent, Clock)
    checked.collect(30, seed=0)
    checked.learn(seed=0)
    checked.release()
    assert [getattr(agent, name, None) for name in names] == before
    agent.learn(8, callback=CuriosityCallback(), reset_num_timesteps=False)
    if kind == "PPO":
        assert agent.num_timesteps == before[0] + agent.n_steps * agent.n_envs


@pytest.mark.parametrize("kind", ["SAC", "PPO"])
def test_an_agent_keeps_its_logger_its_random_actions_and_its_bonus_the_actor(kind: str) -> None:
    checked = integrations(kind)
    agent, attachment = checked.model, checked._attachment
    agent.set_logger(own := Logger(None, []))
    agent.action_space.seed(3)
    expected = deepcopy(agent.action_space).sample()
    for part in (lambda: checked.collect(30, seed=0), lambda: checked.learn(seed=0)):
        assert agent.logger is own
        part()
    assert agent.logger is own and agent._custom_logger
    checked.release()
    assert attachment.actor is None
    assert np.array_equal(agent.action_space.sample(), expected)


def test_an_agent_without_a_logger_stays_without() -> None:
    checked = integrations("SAC")
    before = set(vars(checked.model))
    checked.collect(30, seed=0)
    checked.learn(seed=0)
    assert "_logger" not in before and not checked.model._custom_logger


@pytest.mark.parametrize("kind", ["SAC", "TD3", "PPO"])
def test_a_loaded_integration_learns_and_collects_the_same(kind: str, tmp_path: Path) -> None:
    integration = integrations(kind, **(SMALL | {"bonus": "curiosity"}))
    integration.collect(30, seed=0)
    integration.learn(seed=0)
    integration.save(tmp_path)
    loaded = integration.load(tmp_path)
    assert loaded.bonus is not integration.bonus
    if kind != "PPO":  # whose rollout needs no fresh actions
        assert loaded.model.replay_buffer.attachment.actor is not None
    for one, other in zip(integration.stored(), loaded.stored(), strict=True):
        assert torch.equal(one, other)
    for each in (integration, loaded):
        each.learn(seed=1)
    assert_equal(integration.critic(), loaded.critic())
    assert_equal(integration.actor(), loaded.actor())
    collected = [each.collect(30, seed=2) for each in (integration, loaded)]
    assert_equal(*(list(each) for each in collected))
