"""Mistakes that libraries and users have made, each of which the check must name."""

from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

import deep_curiosity_envs  # noqa: F401  # registers the task
from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.integrations.check import check_integration
from deep_curiosity.integrations.stable_baselines3 import (
    CuriousReplayBuffer,
    CuriousRolloutBuffer,
    StableBaselinesIntegration,
    StableBaselinesOnPolicyIntegration,
)
from deep_curiosity.transitions import Transition

NUM_STEPS = 250  # an episode of 200 is cut off by its clock


def make_env():
    return gymnasium.make("deep_curiosity/PendulumSwingup-v0", action_cost=0.1)


def bonus_of_step(buffer, observation, next_observation, action):
    """The bonus of one step as it now stands."""
    number = torch.zeros(1)
    step = Transition(
        *(torch.tensor(np.asarray(part), dtype=torch.float32) for part in (observation, action)),
        number,
        torch.tensor(next_observation, dtype=torch.float32),
        number.bool(),
        number.bool(),
    )
    if buffer.attachment.learner.every.num_calls < 2:  # components, and others to score
        buffer.attachment.learn(step)
    return buffer.attachment.compute(step).numpy()


class Dropping(CuriousReplayBuffer):
    """Computes the bonus, and returns the samples without it."""

    def _get_samples(self, batch_inds, env=None):
        super()._get_samples(batch_inds, env)
        return ReplayBuffer._get_samples(self, batch_inds, env)


class Stale(CuriousReplayBuffer):
    """Keeps the bonus of the moment of collection beside the reward."""

    def add(self, obs, next_obs, action, reward, done, infos):
        if self.pos == 0:
            self.kept = np.zeros((self.buffer_size, 1), np.float32)
        self.kept[self.pos] = bonus_of_step(self, obs, next_obs, action)
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds, env=None):
        samples = ReplayBuffer._get_samples(self, batch_inds, env)
        return samples._replace(rewards=samples.rewards + torch.tensor(self.kept[batch_inds]))


class StoringTwice(CuriousReplayBuffer):
    """Stores reward plus bonus, and adds the bonus again when sampling."""

    def add(self, obs, next_obs, action, reward, done, infos):
        bonus = bonus_of_step(self, obs, next_obs, action)
        super().add(obs, next_obs, action, reward + bonus, done, infos)


class AfterAdvantages(CuriousRolloutBuffer):
    """Adds the bonus to the rollout's rewards when advantages are already computed."""

    def compute_returns_and_advantage(self, last_values, dones):
        RolloutBuffer.compute_returns_and_advantage(self, last_values, dones)
        rollout = self.transition()
        self._learn(rollout)
        self.rewards = self.rewards + self.attachment.compute(rollout).numpy().reshape(-1, 1)


def sac(buffer=CuriousReplayBuffer, bonus="curiosity", make_env=make_env, buffer_size=1_000):
    options = {"bonus_kwargs": {"hidden_dims": (8,), "members": "round_robin"}}
    model = SAC(
        "MlpPolicy",
        make_env(),
        buffer_size=buffer_size,
        batch_size=64,
        policy_kwargs={"net_arch": [8]},
        replay_buffer_class=buffer,
        replay_buffer_kwargs=options if bonus == "curiosity" else {"bonus": bonus},
        device="cpu",
    )
    return StableBaselinesIntegration(model, make_env)


def ppo(buffer, make_env=make_env):
    model = PPO(
        "MlpPolicy",
        make_env(),
        n_steps=NUM_STEPS,
        batch_size=NUM_STEPS,
        policy_kwargs={"net_arch": [8]},
        rollout_buffer_class=buffer,
        rollout_buffer_kwargs={"bonus_kwargs": {"hidden_dims": (8,)}, "epochs": 1},
        device="cpu",
    )
    return StableBaselinesOnPolicyIntegration(model, make_env)


BROKEN = {
    "dropped": (lambda: sac(Dropping), "targets"),
    "added after advantages": (lambda: ppo(AfterAdvantages), "targets"),
    "stale": (lambda: sac(Stale), "fresh"),
    "stored twice": (lambda: sac(StoringTwice), "raw"),
    "not a number": (lambda: sac(bonus=_without_a_number()), "finite"),
    "constant": (lambda: sac(bonus=ConstantBonus(1.0)), "not constant"),
}


def _without_a_number():
    bonus = ConstantBonus(1.0)
    bonus.value.fill_(float("nan"))
    return bonus


@pytest.mark.parametrize("mistake", BROKEN)
def test_each_mistake_fails_by_its_own_line(mistake):
    make, question = BROKEN[mistake]
    report = check_integration(make(), num_steps=NUM_STEPS)
    assert [f.question for f in report.findings if f.passed is False] == [question], report
    assert f"-> {report[question].advice}" in str(report)


@pytest.mark.parametrize("make", [sac, lambda: ppo(CuriousRolloutBuffer)], ids=["SAC", "PPO"])
def test_without_the_mistake_all_lines_hold(make):
    report = check_integration(make(), num_steps=NUM_STEPS)
    assert all(finding.passed for finding in report.findings), report


def stacked():
    return VecFrameStack(DummyVecEnv([make_env] * 2), 2)


@pytest.mark.parametrize(
    "make_env",
    [
        pytest.param(stacked, marks=pytest.mark.slow),
        lambda: VecMonitor(VecNormalize(stacked())),
    ],
)
@pytest.mark.parametrize("make", [sac, partial(ppo, CuriousRolloutBuffer)], ids=["SAC", "PPO"])
def test_what_wrappers_change_below_the_normalisation_is_the_environment(make, make_env):
    report = check_integration(make(make_env=make_env), num_steps=NUM_STEPS)
    assert all(finding.passed for finding in report.findings), report


def test_more_steps_than_replay_has_room_for_are_refused():
    agent = sac(make_env=lambda: DummyVecEnv([make_env] * 2), buffer_size=60)
    with pytest.raises(ValueError, match=r"`num_steps` must be at most 30, .*replay.* got 80"):
        check_integration(agent, num_steps=80)
