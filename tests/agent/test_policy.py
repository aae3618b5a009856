import pytest
import torch

from deep_curiosity.agent.policy import LOG_STD_RANGE, Critics, GaussianPolicy, NumpyPolicy


def test_policy_has_one_gaussian_for_each_observation():
    policy = GaussianPolicy(3, 2, hidden_dims=(8,))(torch.randn(5, 3))
    assert policy.loc.shape == policy.log_std.shape == (1, 5, 2)
    assert policy.log_weight.equal(torch.zeros(1, 5))


def test_log_std_stays_in_its_range_at_any_observation():
    policy = GaussianPolicy(3, 2, hidden_dims=(8,))(torch.randn(64, 3) * 1e4)
    low, high = LOG_STD_RANGE
    assert policy.log_std.min() >= low and policy.log_std.max() <= high
    assert policy.log_std.max() - policy.log_std.min() > 1  # and it uses the range


def test_where_the_network_says_zero_log_std_is_the_middle_of_its_range():
    policy = GaussianPolicy(3, 2, hidden_dims=())
    for parameter in policy.parameters():
        parameter.data.zero_()
    distribution = policy(torch.randn(4, 3))
    torch.testing.assert_close(distribution.log_std, torch.full((1, 4, 2), -1.5))
    torch.testing.assert_close(distribution.loc, torch.zeros(1, 4, 2))


@pytest.mark.parametrize("modes", [1, 3])
def test_gradients_reach_every_parameter_of_the_policy(modes):
    policy = GaussianPolicy(3, 2, modes=modes, hidden_dims=(8,))
    distribution = policy(torch.randn(32, 3))
    log_prob = distribution.log_prob(distribution.pre_actions(torch.randn(modes, 32, 2)))
    (distribution.log_weight.exp() * log_prob).sum().backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in policy.parameters())


def test_a_policy_of_several_modes_weighs_them():
    policy = GaussianPolicy(3, 2, modes=3, hidden_dims=(8,))(torch.randn(5, 3))
    assert policy.loc.shape == policy.log_std.shape == (3, 5, 2)
    torch.testing.assert_close(policy.log_weight.exp().sum(0), torch.ones(5))


def test_a_policy_without_modes_is_rejected():
    with pytest.raises(ValueError, match="`modes` must be at least 1, got 0"):
        GaussianPolicy(3, 2, modes=0)


@pytest.mark.parametrize("pairs", [1, 2])
def test_every_value_is_estimated_twice(pairs):
    critics = Critics(3, 2, pairs=pairs, hidden_dims=(8,))
    value = critics(torch.randn(5, 3), torch.randn(5, 2))
    assert value.shape == (pairs, 2, 5)
    flat = value.flatten(0, 1)
    assert all((flat[i] != flat[j]).all() for i in range(2 * pairs) for j in range(i))


def test_lower_value_is_the_smaller_of_each_pair():
    critics = Critics(3, 2, pairs=2, hidden_dims=(8,))
    observation, action = torch.randn(50, 3), torch.randn(50, 2)
    value = critics(observation, action)
    expected = torch.stack([torch.minimum(*value[0]), torch.minimum(*value[1])])
    assert critics.lower(observation, action).equal(expected)
    assert 0 < (expected == value[:, 0]).float().mean() < 1  # neither estimate always wins


@pytest.mark.parametrize("rows", [1, 6, 7])
def test_in_turn_each_row_asks_one_critic_of_each_pair(rows):
    critics = Critics(3, 2, pairs=2, hidden_dims=(8,))
    observation, action = torch.randn(rows, 3), torch.randn(rows, 2)
    both = critics(observation, action)  # pairs 2 rows
    expected = torch.stack([both[:, row % 2, row] for row in range(rows)], dim=-1)
    torch.testing.assert_close(critics.in_turn(observation, action), expected)


def test_values_see_observation_and_action():
    critics = Critics(3, 2, hidden_dims=(8,))
    observation = torch.randn(5, 3, requires_grad=True)
    action = torch.randn(5, 2, requires_grad=True)
    critics(observation, action).sum().backward()
    assert observation.grad.abs().sum() > 0 and action.grad.abs().sum() > 0


def test_a_reflex_acts_as_its_policy_does_and_follows_it():
    policy = GaussianPolicy(3, 2, hidden_dims=(8, 8))
    reflex, observation, noise = NumpyPolicy(policy), torch.randn(1, 3), torch.randn(1, 1, 2)
    for _ in range(2):
        expected = torch.tanh(policy(observation).pre_actions(noise))
        action = reflex.act(observation[0].numpy(), noise[0, 0].numpy())
        torch.testing.assert_close(torch.from_numpy(action), expected[0, 0].detach())
        with torch.no_grad():
            policy.network.layers[-1].bias.add_(1)


def test_a_reflex_has_one_mode():
    with pytest.raises(ValueError, match="`policy` must have one mode, got 2"):
        NumpyPolicy(GaussianPolicy(3, 2, modes=2))
