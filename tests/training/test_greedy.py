import numpy as np
import pytest
import torch

from deep_curiosity.training.collector import Step
from deep_curiosity.training.config import Config
from deep_curiosity.training.greedy import GreedyStretches
from deep_curiosity.training.learner import Learner


def walk(stretches, num_steps, share, *, end_every=10**9):
    seen = []
    for step in range(1, num_steps + 1):
        stretches.record(np.full(len(stretches.is_greedy), step % end_every == 0), share)
        seen.append(stretches.is_greedy)
    return np.array(seen)


@pytest.mark.parametrize(("share", "length"), [(0.25, 10.0), (0.5, 30.0), (0.8, 1.0)])
@pytest.mark.parametrize("end_every", [10**9, 7])
def test_as_many_steps_are_greedy_as_asked(share, length, end_every):
    torch.manual_seed(0)
    stretches = GreedyStretches(20, length)
    assert not stretches.is_greedy.any()
    seen = walk(stretches, 4_000, share, end_every=end_every)
    assert seen[100:].mean() == pytest.approx(share, abs=0.02)


def test_a_greedy_stretch_is_as_long_as_asked():
    torch.manual_seed(0)
    seen = walk(GreedyStretches(20, 10.0), 4_000, 0.25)
    begins = (seen[1:] & ~seen[:-1]).sum()
    assert seen.sum() / begins == pytest.approx(10, rel=0.05)


def test_without_a_share_none_is_greedy_and_no_random_number_is_taken():
    before = torch.get_rng_state()
    assert not walk(GreedyStretches(1, 10.0), 20, 0.0, end_every=5).any()
    assert torch.get_rng_state().equal(before)


def test_a_resumed_run_goes_on_with_the_same_stretches():
    stretches, other = GreedyStretches(3, 3.0), GreedyStretches(3, 3.0)
    walk(stretches, 10, 0.5)
    other.load_state_dict(stretches.state_dict())
    random_state = torch.get_rng_state()
    expected = walk(stretches, 50, 0.5)
    torch.set_rng_state(random_state)
    assert (walk(other, 50, 0.5) == expected).all()


@pytest.mark.parametrize(("curiosity_std", "share"), [(4.0, 0.25), (1.0, 0.75)])
def test_as_many_steps_of_a_run_are_greedy_as_the_agent_asks(curiosity_std, share):
    torch.manual_seed(0)
    learner = Learner(Config.of(hidden_dim=8, num_envs=20, replay_capacity=256), 3, 2)
    learner.agent.value_stds[:] = torch.tensor([4.0, curiosity_std])
    zeros, no = np.zeros((20, 3)), np.zeros(20, dtype=bool)
    step = Step(zeros, np.zeros((20, 2)), np.zeros(20), zeros, no, no)
    seen = []
    for _ in range(2_000):
        learner.store(step)
        seen.append(learner.greedy_stretches.is_greedy.mean())
    assert np.mean(seen[200:]) == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize(("num_envs", "numpy_policy"), [(1, True), (1, False), (2, True)])
def test_in_a_greedy_stretch_the_greedy_policy_acts(num_envs, numpy_policy):
    config = Config.of(hidden_dim=8, numpy_policy=numpy_policy, num_envs=num_envs)
    learner = Learner(config, 3, 2)
    layer = learner.agent.policy.network.layers[-1]
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias[:] = torch.tensor([[[2.0, 2.0, -9.0, -9.0]], [[-2.0, -2.0, -9.0, -9.0]]])
    observation = np.zeros((num_envs, 3))
    assert (learner.act(observation) < 0).all()
    learner.greedy_stretches.is_greedy[0] = True
    action = learner.act(observation)
    assert (action[0] > 0).all() and (action[1:] < 0).all()
    evaluated = learner.evaluation_policy(torch.zeros(1, 3), {})
    torch.testing.assert_close(evaluated, torch.tanh(torch.full((1, 2), 2.0)))


@pytest.mark.parametrize(("discount", "length"), [(0.97, 100 / 3), (0.9, 10.0)])
def test_a_greedy_stretch_of_a_run_is_as_long_as_curiosity_looks_ahead(discount, length):
    learner = Learner(Config.of(hidden_dim=8, curiosity_discount=discount), 3, 2)
    assert learner.greedy_stretches.length == pytest.approx(length)
