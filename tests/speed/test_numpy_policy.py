import pytest
import torch

from deep_curiosity.agent.networks import GaussianPolicy
from deep_curiosity.speed.numpy_policy import NumpyPolicy


def test_it_acts_as_its_policy_does_and_follows_it():
    policy = GaussianPolicy(3, 2, hidden_dims=(8, 8))
    numpy_policy, observation = NumpyPolicy(policy), torch.randn(1, 3)
    noise = torch.randn(1, 1, 2)
    for _ in range(2):
        expected = torch.tanh(policy(observation).component_samples(noise))
        action = numpy_policy.act(observation[0].numpy(), noise[0, 0].numpy())
        torch.testing.assert_close(torch.from_numpy(action), expected[0, 0].detach())
        with torch.no_grad():
            policy.network.layers[-1].bias.add_(1)


def test_a_policy_of_several_components_is_rejected():
    with pytest.raises(ValueError, match="`policy` must have one mixture component, got 2"):
        NumpyPolicy(GaussianPolicy(3, 2, mixture_components=2))
