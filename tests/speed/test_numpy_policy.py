import numpy as np
import pytest
import torch

from deep_curiosity.agent.networks import GaussianPolicy
from deep_curiosity.nn.statistics import InputScaling
from deep_curiosity.speed.numpy_policy import NumpyPolicy


def test_it_acts_as_its_policy_does_and_follows_its_updates():
    policy = GaussianPolicy(3, 2, hidden_dims=(8, 8))
    numpy_policy, observation, noise = NumpyPolicy(policy), torch.randn(1, 3), torch.randn(1, 1, 2)
    for _ in range(2):
        expected = torch.tanh(policy(observation).component_samples(noise))
        action = numpy_policy.act(observation[0].numpy(), noise[0, 0].numpy())
        torch.testing.assert_close(torch.from_numpy(action), expected[0, 0].detach())
        center = torch.from_numpy(numpy_policy.center(observation[0].numpy()))
        torch.testing.assert_close(center, torch.tanh(policy(observation).loc)[0, 0].detach())
        with torch.no_grad():
            policy.network.layers[-1].bias.add_(1)


@pytest.mark.parametrize("hunger", [[], [0.7]])
def test_it_sees_observations_in_their_units_and_the_hunger_as_it_is(hunger):
    scaling = InputScaling(3)
    policy = GaussianPolicy(3 + len(hunger), 2, hidden_dims=(8, 8))
    numpy_policy = NumpyPolicy(policy, scaling=scaling)
    observation, noise = torch.tensor([[300.0, 5.0, -0.01]]), torch.zeros(1, 1, 2)
    for _ in range(2):
        scaling.update(torch.randn(9, 3) * torch.tensor([100.0, 1.0, 2e-4]))
        seen = torch.cat([scaling(observation), torch.tensor([hunger])], dim=-1)
        assert seen[0, 0] < 300 and seen[0, 1:3].tolist() == [5, -1]  # cut at ten of its sizes
        expected = torch.tanh(policy(seen).component_samples(noise))[0, 0].detach()
        entered = np.array([*observation[0].tolist(), *hunger], dtype=np.float32)
        action = numpy_policy.act(entered, noise[0, 0].numpy())
        torch.testing.assert_close(torch.from_numpy(action), expected)


def test_an_action_is_left_as_it_is_by_the_next_one():
    numpy_policy = NumpyPolicy(GaussianPolicy(3, 2, hidden_dims=(8,)))
    observation, noise = np.ones(3, dtype=np.float32), np.zeros(2, dtype=np.float32)
    action = numpy_policy.act(observation, noise)
    before = action.copy()
    numpy_policy.act(-observation, noise)
    assert (action == before).all() and (observation == 1).all()


def test_a_policy_without_hidden_layers_leaves_the_observation_as_it_is():
    policy = GaussianPolicy(3, 2, hidden_dims=())
    observation, noise = -np.ones(3, dtype=np.float32), np.zeros(2, dtype=np.float32)
    action = NumpyPolicy(policy).act(observation, noise)
    expected = torch.tanh(policy(torch.from_numpy(observation)[None]).loc[0, 0]).detach()
    torch.testing.assert_close(torch.from_numpy(action), expected)
    assert (observation == -1).all()


def test_several_mixture_components_are_rejected():
    with pytest.raises(ValueError, match="`policy` must have one mixture component, got 2"):
        NumpyPolicy(GaussianPolicy(3, 2, mixture_components=2))
