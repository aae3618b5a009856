"""Behind any order of vector wrappers a bonus learns raw single steps, or says what is wrong."""

import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecCheckNan,
    VecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.integrations.stable_baselines3 import (
    CuriosityCallback,
    CuriousDictReplayBuffer,
    CuriousDictRolloutBuffer,
    CuriousReplayBuffer,
    CuriousRolloutBuffer,
)
from deep_curiosity.transitions import Transition

EPISODE, FAR = 10, 500.0


class Fall(gymnasium.Env):
    """Small observations, of which the last of an episode lies far outside the usual range.

    The second entry counts the steps, so that a successor can be told from its predecessor.
    """

    observation_space: spaces.Space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict]:
        super().reset(seed=seed)
        self.time = 0
        return self.observe(0.1), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict]:
        self.time += 1
        fallen = self.time == EPISODE
        observation = self.observe(FAR if fallen else 0.1 * self.np_random.normal())
        return observation, float(self.time), fallen, False, {}

    def observe(self, place: float) -> Any:
        return np.array([place, self.time / 100], np.float32)


class FallInDictionary(Fall):
    observation_space = spaces.Dict(
        {"state": Fall.observation_space, "other": spaces.Box(-1.0, 1.0, (3,), np.float32)}
    )

    def observe(self, place: float) -> Any:
        return {"state": super().observe(place), "other": np.zeros(3, np.float32)}


class Recorder(Bonus):
    """Zero everywhere; keeps what it was shown."""

    def __init__(self) -> None:
        super().__init__()
        self.observed: list[Transition] = []

    def forward(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None = None
    ) -> Tensor:
        return torch.zeros(len(observation))

    def loss(self, transition: Transition) -> Tensor:
        return torch.zeros(())

    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        self.observed.append(transition)

    def metrics(self) -> dict[str, Tensor]:
        return {}

    @property
    def shown(self) -> Transition:
        return Transition(*(torch.cat(field) for field in zip(*self.observed, strict=True)))


def learned(
    kind: type, env: Any, callback: Any = None, *, key: str | None = None, **options: Any
) -> Transition:
    """All that a bonus is shown while an agent learns."""
    bonus = Recorder()
    policy = "MlpPolicy" if key is None else "MultiInputPolicy"
    options = {"bonus": bonus, "observation_key": key} | options
    settings = {"policy_kwargs": {"net_arch": [8]}, "device": "cpu", "seed": 0}
    if kind is PPO:
        buffer = CuriousRolloutBuffer if key is None else CuriousDictRolloutBuffer
        agent: Any = PPO(
            policy,
            env,
            n_steps=32,
            batch_size=32,
            rollout_buffer_class=buffer,
            rollout_buffer_kwargs=options,
            **settings,
        )
    else:
        agent = SAC(
            policy,
            env,
            learning_starts=20,
            replay_buffer_class=CuriousReplayBuffer if key is None else CuriousDictReplayBuffer,
            replay_buffer_kwargs=options,
            **settings,
        )
    agent.learn(64, callback=CuriosityCallback() if callback is None else callback)
    return bonus.shown


def dummy(kind: type = Fall) -> VecEnv:
    return DummyVecEnv([kind])


def two(kind: type = Fall) -> VecEnv:
    return DummyVecEnv([kind, kind])


CLIPPED = {
    "normalised": lambda: VecNormalize(dummy()),
    "normalised, two": lambda: VecNormalize(two()),
    "normalised, tight": lambda: VecNormalize(dummy(), clip_obs=1.0),
    "normalised below what changes nothing": lambda: VecMonitor(VecCheckNan(VecNormalize(two()))),
    "normalised above what changes nothing": lambda: VecNormalize(VecMonitor(VecCheckNan(two()))),
    "normalised above a monitor of each": lambda: VecNormalize(
        DummyVecEnv([lambda: Monitor(Fall())])
    ),
    "normalised, in processes": lambda: VecNormalize(SubprocVecEnv([Fall, Fall])),
}
PLAIN = {
    "plain": dummy,
    "in processes": lambda: SubprocVecEnv([Fall, Fall]),
    "monitored": lambda: VecMonitor(VecCheckNan(two())),
    "rewards normalised": lambda: VecNormalize(dummy(), norm_obs=False),
}


@pytest.mark.parametrize("kind", [PPO, SAC])
@pytest.mark.parametrize(
    "make",
    [
        pytest.param(make, marks=pytest.mark.slow if name == "in processes" else (), id=name)
        for name, make in (CLIPPED | PLAIN).items()
    ],
)
def test_what_is_learned_is_the_raw_successor_of_one_step(kind: type, make: Callable) -> None:
    env = make()
    shown = learned(kind, env)
    env.close()
    one_step = shown.next_observation[:, 1] - shown.observation[:, 1]
    torch.testing.assert_close(one_step, torch.full_like(one_step, 0.01), atol=1e-4, rtol=0)
    assert torch.equal(shown.terminated, shown.next_observation[:, 0] == FAR)
    assert shown.terminated.any() and not shown.truncated.any()
    torch.testing.assert_close(
        shown.reward, 100 * shown.next_observation[:, 1], atol=1e-2, rtol=1e-4
    )


@pytest.mark.parametrize("kind", [PPO, SAC])
@pytest.mark.parametrize("keys", [None, ["state"]])
def test_an_entry_of_a_dictionary_is_raw_too(kind: type, keys: list[str] | None) -> None:
    env = VecNormalize(dummy(FallInDictionary), norm_obs_keys=keys)
    shown = learned(kind, env, key="state")
    assert shown.terminated.any()
    assert torch.equal(shown.terminated, shown.next_observation[:, 0] == FAR)


@pytest.mark.parametrize("kind", [PPO, SAC])
def test_a_stack_under_the_normalisation_is_learned_as_it_is(kind: type) -> None:
    shown = learned(kind, VecNormalize(VecFrameStack(dummy(), 3)))
    assert shown.observation.shape[1] == 6
    assert torch.equal(shown.terminated, shown.next_observation[:, -2] == FAR)
    goes_on = shown.observation[:, 3] > 0  # the older frames of a beginning are empty
    assert torch.equal(shown.next_observation[goes_on, 2:4], shown.observation[goes_on, 4:])


@pytest.mark.parametrize("kind", [PPO, SAC])
@pytest.mark.parametrize("callback", [None, []], ids=["with callback", "without"])
def test_a_stack_above_the_normalisation_is_refused(kind: type, callback: Any) -> None:
    if kind is PPO and callback == []:
        pytest.skip("PPO needs the callback")
    with pytest.raises(
        ValueError, match=r"`env` must .*VecNormalize\(VecFrameStack\(.*\)\).*got|VecNormalize"
    ):
        learned(kind, VecFrameStack(VecNormalize(dummy()), 3), callback)


def test_the_order_that_was_found_is_said() -> None:
    with pytest.raises(
        ValueError, match=r"got VecFrameStack\(VecMonitor\(VecNormalize\(DummyVecEnv\)\)\)"
    ):
        learned(SAC, VecFrameStack(VecMonitor(VecNormalize(dummy())), 3))


@pytest.mark.parametrize("kind", [PPO, SAC])
def test_two_normalisations_are_refused(kind: type) -> None:
    with pytest.raises(ValueError, match="`env` must hold VecNormalize at most once, got VecNorm"):
        learned(kind, VecNormalize(VecNormalize(dummy())))


def test_without_the_callback_a_clipped_end_is_refused_and_others_are_not() -> None:
    with pytest.raises(ValueError, match=r"`callback` must be CuriosityCallback\(\) .*clip_obs"):
        learned(SAC, VecNormalize(dummy(), clip_obs=1.0), [])
    shown = learned(SAC, VecNormalize(dummy(), clip_obs=1e4), [])
    ends = shown.next_observation[shown.terminated]
    assert len(ends) and ends[:, 0].tolist() == pytest.approx([FAR] * len(ends), rel=1e-3)


def test_a_buffer_that_holds_a_clipped_end_is_refused_whatever_comes_after() -> None:
    env = VecNormalize(dummy(), clip_obs=1.0)
    agent: Any = SAC("MlpPolicy", env, learning_starts=20, replay_buffer_class=CuriousReplayBuffer)
    agent.learn(20)
    agent.replay_buffer.sample(4)  # as it is stored, which asks nothing
    refused = pytest.raises(ValueError, match=r"`callback` must be .* 1\.0.*begin with a new one")
    with refused:
        agent.learn(5, reset_num_timesteps=False)
    env.clip_obs = 1e4
    for again in (
        lambda: agent.learn(5, reset_num_timesteps=False),
        lambda: agent.learn(5, callback=CuriosityCallback(), reset_num_timesteps=False),
        lambda: agent.replay_buffer.sample(4),
        lambda: pickle.loads(pickle.dumps(agent.replay_buffer)).sample(4, env),
    ):
        with refused:
            again()


def test_ends_are_kept_beside_an_evaluation_that_compares_wrappers() -> None:
    callbacks = [
        EvalCallback(VecNormalize(VecMonitor(dummy())), eval_freq=20, verbose=0),
        CuriosityCallback(),
    ]
    shown = learned(SAC, VecNormalize(VecMonitor(dummy())), callbacks)
    assert torch.equal(shown.terminated, shown.next_observation[:, 0] == FAR)


def test_ends_that_a_clock_cut_off_must_be_told_from_others() -> None:
    with pytest.raises(ValueError, match="`handle_timeout_termination` must be True, got False"):
        learned(SAC, dummy(), handle_timeout_termination=False)


@pytest.mark.parametrize(("kind", "known"), [(SAC, "bonus_kwargs"), (PPO, "epochs")])
def test_an_unknown_option_is_answered_with_those_there_are(kind: type, known: str) -> None:
    with pytest.raises(TypeError, match=f"`bonus_weight` must be one of .*{known}.* got 0.5"):
        learned(kind, dummy(), bonus_weight=0.5)
