import math

import numpy as np
import pytest
import torch

from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collector import Step
from deep_curiosity.training.learner import Learner, make_evaluation_policy
from deep_curiosity.training.loop import train


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ["computed for 8", "learns"]),
        # no critic learns the bonus: the policy maximises it, as the models now stand
        ({"curiosity_discount": 0.0}, ["learns", "computed for 8"]),
    ],
)
def test_the_bonus_is_computed_for_a_batch_once_and_before_its_models_learn(
    tiny, monkeypatch, changes, expected
):
    learner = Learner(tiny.override(batch_size=8, actor_batch_fraction=1.0, **changes), 3, 1)
    for observation, next_observation in np.random.default_rng(0).normal(size=(40, 2, 3)):
        learner.replay.add(observation, np.zeros(1), 0.0, next_observation, False, False)
    bonus, calls = learner.bonus, []
    forward, loss = bonus.forward, bonus.loss

    def computed(observation, *args):
        calls.append(f"computed for {len(observation)}")
        return forward(observation, *args)

    def learns(transition):
        calls.append("learns")
        return loss(transition)

    monkeypatch.setattr(bonus, "forward", computed)
    monkeypatch.setattr(bonus, "loss", learns)
    learner.update()
    assert calls == expected


def test_later_steps_count_by_the_bonus_that_they_last_had(tiny, monkeypatch):
    """What was never drawn ends the sum; each update keeps the bonus of its first steps."""
    learner = Learner(tiny.override(batch_size=8, curiosity_steps=3), 3, 1)
    for observation, next_observation in np.random.default_rng(0).normal(size=(40, 2, 3)):
        learner.replay.add(observation, np.zeros(1), 0.0, next_observation, False, False)
    given, drawn = [], []
    update, sample_rows = learner.agent.update, learner.replay.sample_rows
    monkeypatch.setattr(
        learner.agent, "update", lambda batch, bonus: given.append(bonus) or update(batch, bonus)
    )
    monkeypatch.setattr(
        learner.replay,
        "sample_rows",
        lambda *sizes: drawn.append(sample_rows(*sizes)) or drawn[-1],
    )
    last = torch.full((40,), math.nan)
    for number in range(30):
        learner.update()
        first, later = drawn[number][2][:24].split([8, 16])
        torch.testing.assert_close(given[number][8:], last[later], equal_nan=True)
        last[first] = given[number][:8]
        torch.testing.assert_close(learner.replay.bonus[:40], last, equal_nan=True)
    assert given[0][8:].isnan().all() and not given[-1].isnan().all()


def actions_of(config, steps=60):
    """Actions at as many observations, which end an episode now and then."""
    torch.manual_seed(1)
    learner, generator = Learner(config, 3, 2), np.random.default_rng(0)
    actions, was_greedy = [], []
    for number in range(steps):
        observation = generator.normal(size=(1, 3))
        was_greedy.append(bool(learner.greedy_stretches.is_greedy[0]))
        actions.append(learner.act(observation))
        ended = np.array([number % 7 == 6])
        learner.store(
            Step(observation, actions[-1], np.zeros(1), observation, ended, np.zeros(1, bool))
        )
    return np.concatenate(actions), was_greedy


def test_torch_and_numpy_act_alike_but_for_rounding_where_stretches_are_greedy(tiny):
    config = tiny.override(greedy_share=0.5, curiosity_discount=0.8, adaptive_greedy_share=False)
    by_numpy, was_greedy = actions_of(config)
    by_torch, also_greedy = actions_of(config.override(numpy_policy=False))
    assert 10 < sum(was_greedy) < 50 and was_greedy == also_greedy
    np.testing.assert_allclose(by_torch, by_numpy, atol=1e-5)


@pytest.mark.parametrize("hunger", [1.0, "conditioned:0.3"])
def test_torch_and_numpy_are_evaluated_alike_but_for_rounding(tiny, hunger):
    config = tiny.override(hunger=hunger)
    learner, observation = Learner(config, 3, 2), torch.randn(1, 3)
    by_torch = make_evaluation_policy(
        config.override(numpy_policy=False), learner.agent, learner.hunger_controller
    )
    for _ in range(2):
        action = learner.evaluation_policy(observation, {})
        expected = learner.agent.act(observation, deterministic=True, greedy=True, hunger=1.0)
        torch.testing.assert_close(action, expected)
        assert torch.equal(by_torch(observation, {}), expected)
        several = torch.cat([observation, torch.randn(2, 3)])
        torch.testing.assert_close(learner.evaluation_policy(several, {})[:1], expected)
        with torch.no_grad():  # as an update does
            learner.agent.policy.network.layers[-1].bias.add_(0.1)


def test_one_environment_is_evaluated_without_torch(tiny, monkeypatch):
    learner = Learner(tiny, 3, 2)
    monkeypatch.setattr(learner.agent, "act", None)
    assert learner.evaluation_policy(torch.zeros(1, 3), {}).shape == (1, 2)


@pytest.mark.parametrize("components", [1, 3])
def test_each_environment_is_acted_in_by_the_policy_whose_turn_it_is(tiny, components):
    config = tiny.override(num_envs=4, policy_mixture_components=components)
    learner = Learner(config, 3, 2)
    layer = learner.agent.policy.network.layers[-1]
    with torch.no_grad():
        layer.weight.zero_()
        for bias, loc in zip(layer.bias[:, 0], (2.0, -2.0), strict=True):
            of_component = torch.tensor([loc, loc, -9.0, -9.0])
            bias[: 4 * components] = of_component.repeat(components)
    learner.greedy_stretches.is_greedy = np.array([True, False, False, True])
    action = learner.act(np.zeros((4, 3)))
    assert ((action > 0).all(-1) == learner.greedy_stretches.is_greedy).all()
    assert ((action < 0).all(-1) != learner.greedy_stretches.is_greedy).all()


def test_a_run_of_another_device_goes_on_with_a_generator_of_its_own(tiny):
    """The state of one on a GPU is shorter, and nothing to one on the CPU."""
    train(tiny, show_progress=False)
    state = load_checkpoint(tiny.run.out)["learner"]
    state["replay"]["generator"] = torch.zeros(16, dtype=torch.uint8)
    learner = Learner(tiny, 3, 1)
    learner.load_state_dict(state)
    assert len(learner.replay) == 60
    learner.update()
