import math

import pytest
import torch

from deep_curiosity.agent.action_information import action_information
from deep_curiosity.gaussians import DiagonalMixture


def linear_gaussian(num_states, std, dim=1, seed=0):
    """Policies `N(x, std^2)` over pre-actions at standard normal states, and a sample of each."""
    generator = torch.Generator().manual_seed(seed)
    loc = torch.randn(num_states, 1, dim, generator=generator, dtype=torch.float64)
    log_var = torch.full_like(loc, 2 * math.log(std))
    policy = DiagonalMixture(loc, log_var, torch.zeros(num_states, 1, dtype=torch.float64))
    noise = torch.randn(num_states, 1, dim, generator=generator, dtype=torch.float64)
    return policy, policy.component_samples(noise).squeeze(-2)


@pytest.mark.parametrize("std", [2.0, 0.5, 0.1])
@pytest.mark.parametrize("dim", [1, 3])
def test_linear_gaussian_information_lies_between_the_estimates(std, dim):
    exact = dim * 0.5 * math.log(1 + 1 / std**2)
    estimates = [action_information(*linear_gaussian(1_000, std, dim, seed)) for seed in range(8)]
    lower = sum(estimate.lower.item() for estimate in estimates) / 8
    upper = sum(estimate.upper.item() for estimate in estimates) / 8
    assert lower - 0.03 < exact < upper + 0.03
    if exact < 3:
        assert upper - lower < 0.1


def test_a_policy_that_ignores_the_state_carries_nothing():
    policy, _ = linear_gaussian(100, 1.0)
    same = policy._replace(loc=torch.zeros_like(policy.loc))
    estimate = action_information(same, same.sample())
    assert estimate.lower.item() == pytest.approx(0, abs=1e-9)
    assert estimate.upper.item() == pytest.approx(0, abs=1e-9)


def test_where_actions_reveal_the_state_the_lower_estimate_is_the_log_of_their_number():
    estimate = action_information(*linear_gaussian(50, 1e-6))
    assert estimate.lower.item() == pytest.approx(math.log(50), abs=1e-6)
    assert estimate.upper > math.log(50)


def test_one_state_is_refused():
    policy, pre_action = linear_gaussian(1, 1.0)
    with pytest.raises(ValueError, match="`pre_action` must have at least 2 rows, got 1"):
        action_information(policy, pre_action)
