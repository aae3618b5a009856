import math

import pytest
import torch
from scipy import integrate
from torch.distributions import (
    Categorical,
    Independent,
    MixtureSameFamily,
    Normal,
    TransformedDistribution,
)
from torch.distributions.transforms import TanhTransform

from deep_curiosity.distributions import (
    SquashedMixture,
    drawn,
    flat_log_prob,
    gaussian_log_prob,
    log_abs_det_tanh,
    mixture_log_prob,
    squashed_log_prob,
)


def column(value):
    return torch.tensor([[value]], dtype=torch.float64)


def test_log_density_at_the_centre_of_a_unit_gaussian():
    zero = torch.zeros(1, 2)
    assert gaussian_log_prob(zero, zero, zero).item() == pytest.approx(-math.log(2 * math.pi))


def test_gaussian_log_density_agrees_with_torch_distributions():
    value, loc, log_std = torch.randn(3, 5, 4, dtype=torch.float64)
    expected = Independent(Normal(loc, log_std.exp()), 1).log_prob(value)
    torch.testing.assert_close(gaussian_log_prob(value, loc, log_std), expected)


def test_mixture_log_density_agrees_with_torch_distributions():
    value = torch.randn(6, 3, dtype=torch.float64) * 3
    loc, log_std = torch.randn(2, 4, 3, dtype=torch.float64)
    log_weight = torch.log_softmax(torch.randn(4, dtype=torch.float64), 0)
    components = Independent(Normal(loc, log_std.exp()), 1)
    expected = MixtureSameFamily(Categorical(logits=log_weight), components).log_prob(value)
    torch.testing.assert_close(mixture_log_prob(value, loc, log_std, log_weight), expected)


def test_a_mixture_far_from_its_components_stays_in_logs():
    loc, log_std = torch.zeros(2, 1), torch.zeros(2, 1)
    log_weight = torch.full((2,), -math.log(2))
    actual = mixture_log_prob(torch.full((1, 1), 100.0), loc, log_std, log_weight)
    assert actual.item() == pytest.approx(-5_000 - 0.5 * math.log(2 * math.pi))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("sign", [-1, 1])
def test_volume_change_at_thirty_is_exact(dtype, sign):
    pre_action = torch.tensor([[30.0 * sign]], dtype=dtype)
    expected = math.log(4) - 60  # 1 - tanh(u)^2 = 4 exp(-2|u|) to 26 digits
    assert log_abs_det_tanh(pre_action).item() == pytest.approx(expected, abs=1e-5)


def test_volume_change_agrees_with_its_definition_where_that_is_stable():
    pre_action = torch.linspace(-3, 3, 41, dtype=torch.float64).unsqueeze(-1)
    expected = torch.log1p(-pre_action.tanh().square()).squeeze(-1)
    torch.testing.assert_close(log_abs_det_tanh(pre_action), expected)


def test_volume_change_has_a_bounded_gradient_at_thirty():
    pre_action = torch.tensor([[30.0], [-30.0]], requires_grad=True)
    log_abs_det_tanh(pre_action).sum().backward()
    torch.testing.assert_close(pre_action.grad, torch.tensor([[-2.0], [2.0]]))


def test_squashed_log_density_agrees_with_torch_distributions():
    loc, log_std = torch.randn(2, 64, 3, dtype=torch.float64)
    pre_action = loc + log_std.exp() * torch.randn(64, 3, dtype=torch.float64)
    squash = TanhTransform(cache_size=1)  # the cache spares the inverse, which is not stable
    reference = TransformedDistribution(Independent(Normal(loc, log_std.exp()), 1), squash)
    action = squash(pre_action)
    actual = squashed_log_prob(gaussian_log_prob(pre_action, loc, log_std), pre_action)
    torch.testing.assert_close(actual, reference.log_prob(action), atol=1e-7, rtol=1e-7)


def one_mode(loc, log_std):
    return SquashedMixture(
        loc.unsqueeze(0), log_std.unsqueeze(0), torch.zeros(1, loc.shape[0], dtype=loc.dtype)
    )


def test_single_precision_is_right_at_large_pre_actions():
    pre_action = torch.tensor([[9.0], [20.0], [-30.0]])
    policy = one_mode(pre_action, torch.zeros(3, 1))
    actual = squashed_log_prob(policy.log_prob(pre_action), pre_action)
    expected = -0.5 * math.log(2 * math.pi) - math.log(4) + 2 * pre_action.abs().squeeze(-1)
    torch.testing.assert_close(actual, expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("loc", "log_std"), [(0.0, 0.0), (2.0, -1.0), (-1.0, 0.5)])
def test_policy_density_integrates_to_one(loc, log_std):
    policy = one_mode(column(loc), column(log_std))
    total, _ = integrate.quad(lambda u: policy.log_prob(column(u)).exp().item(), -30, 30)
    assert total == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(("loc", "log_std"), [(0.0, -1.0), (0.5, -1.5)])
def test_squashed_density_integrates_to_one_over_the_action_box(loc, log_std):
    policy = one_mode(column(loc), column(log_std))

    def density(action):
        pre_action = column(math.atanh(action))
        return squashed_log_prob(policy.log_prob(pre_action), pre_action).exp().item()

    total, _ = integrate.quad(density, -1, 1)
    assert total == pytest.approx(1, abs=1e-6)


def test_flat_density_integrates_to_the_volume_of_the_box():
    total, _ = integrate.quad(lambda u: flat_log_prob(column(u)).exp().item(), -20, 20)
    assert total == pytest.approx(2, abs=1e-6)


def test_flat_density_of_the_action_is_one_everywhere():
    pre_action = torch.randn(9, 4, dtype=torch.float64) * 5
    on_the_box = squashed_log_prob(flat_log_prob(pre_action), pre_action)
    torch.testing.assert_close(on_the_box, torch.zeros(9, dtype=torch.float64))


def test_the_squash_cancels_from_a_difference_of_log_densities():
    pre_action = torch.randn(9, 2, dtype=torch.float64) * 2
    one, other = torch.randn(2, 9, dtype=torch.float64)
    squashed = squashed_log_prob(one, pre_action) - squashed_log_prob(other, pre_action)
    torch.testing.assert_close(squashed, one - other)


def test_pre_actions_follow_the_noise():
    loc, log_std = torch.tensor([[1.0]]), torch.tensor([[math.log(3)]])
    policy = one_mode(loc.requires_grad_(), log_std.requires_grad_())
    pre_action = policy.pre_actions(torch.tensor([[[2.0]]]))
    assert pre_action.item() == pytest.approx(7)
    pre_action.sum().backward()
    assert loc.grad.item() == 1 and log_std.grad.item() == pytest.approx(6)


def test_mode_is_the_squashed_centre():
    policy = one_mode(torch.tensor([[0.5, -30.0]]), torch.zeros(1, 2))
    torch.testing.assert_close(policy.mode, torch.tensor([[math.tanh(0.5), -1.0]]))


def two_modes(weight, loc=(-2.0, 1.0), std=(0.5, 1.5)):
    """A mixture of two over one action, the same at every row."""
    shape = (2, 1, 1)
    return SquashedMixture(
        torch.tensor(loc).view(shape),
        torch.tensor(std).log().view(shape),
        torch.tensor([[1 - weight], [weight]]).log(),
    )


def test_a_mixture_density_agrees_with_torch_distributions():
    policy, pre_action = two_modes(0.3), torch.linspace(-5, 5, 21).unsqueeze(-1)
    modes = Normal(policy.loc.flatten(), policy.log_std.exp().flatten())
    reference = MixtureSameFamily(Categorical(logits=policy.log_weight.flatten()), modes)
    torch.testing.assert_close(
        policy.log_prob(pre_action), reference.log_prob(pre_action.squeeze(-1))
    )


def test_a_mixture_draws_from_its_modes_by_their_weights():
    modes = [part.expand(2, 40_000, *part.shape[2:]) for part in two_modes(0.3)]
    draws = SquashedMixture(*modes).draw().squeeze(-1)
    reference = two_modes(0.3)
    below = torch.tensor([-2.5, -1.0, 1.0, 2.0])
    cdf = Normal(reference.loc.flatten(), reference.log_std.exp().flatten()).cdf(below[:, None])
    expected = cdf @ torch.tensor([0.7, 0.3])
    actual = (draws < below[:, None]).float().mean(-1)
    torch.testing.assert_close(actual, expected, atol=0.01, rtol=0)


@pytest.mark.parametrize("dim", [0, 1])
def test_indices_are_drawn_by_their_probability(dim):
    probability = torch.tensor([0.1, 0.6, 0.3])
    log_weight = probability.log().expand(20_000, 3)
    index = drawn(log_weight if dim == 1 else log_weight.mT, dim=dim)
    share = torch.bincount(index, minlength=3) / 20_000
    torch.testing.assert_close(share, probability, atol=0.015, rtol=0.0)


def test_expectations_mode_by_mode_are_those_of_the_mixture():
    parts = [part.expand(2, 50_000, *part.shape[2:]) for part in two_modes(0.3)]
    policy = SquashedMixture(*parts)
    pre_action = policy.pre_actions(torch.randn_like(policy.loc))
    stratified = (policy.log_weight.exp() * policy.log_prob(pre_action)).sum(0).mean()
    drawn = policy.log_prob(policy.draw()).mean()
    assert stratified.item() == pytest.approx(drawn.item(), abs=0.02)


@pytest.mark.parametrize(("weight", "centre"), [(0.3, -2.0), (0.7, 1.0)])
def test_mode_of_a_mixture_is_the_centre_of_the_weightiest(weight, centre):
    torch.testing.assert_close(two_modes(weight).mode, torch.tensor([[math.tanh(centre)]]))
