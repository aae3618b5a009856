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

from deep_curiosity.agent.networks import (
    LOG_STD_FLOOR,
    LOG_STD_RANGE,
    MOST_HABIT,
    Critics,
    GaussianPolicy,
    LearnedPrior,
    UniformPrior,
    log_abs_det_tanh,
)
from deep_curiosity.gaussians import DiagonalMixture, gaussian_log_prob
from deep_curiosity.losses import prior_loss


def test_policy_has_one_gaussian_for_each_observation():
    policy = GaussianPolicy(3, 2, hidden_dims=(8,))(torch.randn(5, 3))
    assert policy.loc.shape == policy.log_var.shape == (5, 1, 2)
    assert policy.log_weight.equal(torch.zeros(5, 1))


def test_log_std_stays_in_its_range_at_any_observation():
    policy = GaussianPolicy(3, 2, hidden_dims=(8,))(torch.randn(64, 3) * 1e4)
    (low, high), log_std = LOG_STD_RANGE, 0.5 * policy.log_var
    assert log_std.min() >= low and log_std.max() <= high
    assert log_std.max() - log_std.min() > 1  # and it uses the range


def test_where_the_network_says_zero_log_std_is_the_middle_of_its_range():
    policy = GaussianPolicy(3, 2, hidden_dims=())
    for parameter in policy.parameters():
        parameter.data.zero_()
    distribution = policy(torch.randn(4, 3))
    torch.testing.assert_close(0.5 * distribution.log_var, torch.full((4, 1, 2), -1.5))
    torch.testing.assert_close(distribution.loc, torch.zeros(4, 1, 2))


@pytest.mark.parametrize("components", [1, 3])
def test_gradients_reach_every_parameter_of_the_policy(components):
    policy = GaussianPolicy(3, 2, mixture_components=components, hidden_dims=(8,))
    distribution = policy(torch.randn(32, 3))
    points = distribution.component_samples(torch.randn(32, components, 2)).transpose(0, 1)
    log_prob = distribution.log_prob(points)  # components batch
    (distribution.log_weight.exp().mT * log_prob).sum().backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in policy.parameters())


def test_a_policy_of_several_components_weighs_them():
    policy = GaussianPolicy(3, 2, mixture_components=3, hidden_dims=(8,))(torch.randn(5, 3))
    assert policy.loc.shape == policy.log_var.shape == (5, 3, 2)
    torch.testing.assert_close(policy.log_weight.exp().sum(-1), torch.ones(5))


def test_a_policy_without_components_is_rejected():
    with pytest.raises(ValueError, match="`mixture_components` must be at least 1, got 0"):
        GaussianPolicy(3, 2, mixture_components=0)


@pytest.mark.parametrize("others", [0, 1, 2])
def test_rewards_value_is_estimated_twice_and_others_once(others):
    critics = Critics(3, 2, others=others, hidden_dims=(8,))
    value = critics(torch.randn(5, 3), torch.randn(5, 2))
    assert value.shape == (2 + others, 5)
    assert all((value[i] != value[j]).all() for i in range(len(value)) for j in range(i))


def test_of_rewards_value_the_smaller_estimate_counts():
    critics = Critics(3, 2, hidden_dims=(8,))
    observation, action = torch.randn(50, 3), torch.randn(50, 2)
    value = critics(observation, action)
    expected = torch.stack([torch.minimum(value[0], value[1]), value[2]])
    assert critics.lower(observation, action).equal(expected)
    assert 0 < (expected[0] == value[0]).float().mean() < 1  # neither estimate always wins


@pytest.mark.parametrize("rows", [1, 6, 7])
def test_values_alone_are_asked_of_their_own_critics(rows):
    critics = Critics(3, 2, hidden_dims=(8,))
    observation, action = torch.randn(rows, 3), torch.randn(rows, 2)
    both, other = critics(observation, action).split([2, 1])
    torch.testing.assert_close(critics.of_others(observation, action), other)
    torch.testing.assert_close(critics.of_reward(observation, action), both.amin(0))
    expected = torch.stack([both[row % 2, row] for row in range(rows)])
    found = critics.of_reward(observation, action, alternate=True)
    torch.testing.assert_close(found, expected)


def test_each_value_may_be_asked_at_a_state_and_action_of_its_own():
    critics = Critics(3, 2, hidden_dims=(8,))
    observation, action = torch.randn(2, 5, 3), torch.randn(2, 5, 2)
    together = critics.lower(observation, action)
    for number in range(2):
        alone = critics.lower(observation[number], action[number])[number]
        torch.testing.assert_close(together[number], alone)


def test_values_depend_on_observation_and_action():
    critics = Critics(3, 2, hidden_dims=(8,))
    observation = torch.randn(5, 3, requires_grad=True)
    action = torch.randn(5, 2, requires_grad=True)
    critics(observation, action).sum().backward()
    assert observation.grad.abs().sum() > 0 and action.grad.abs().sum() > 0


def density(prior, pre_action):
    with torch.no_grad():
        return prior.log_prob(torch.tensor([[pre_action]], dtype=torch.float64)).exp().item()


def log_uniform(pre_action):
    """Log density of a pre-action whose tanh is uniform on [-1, 1], in one dimension."""
    return math.log(0.5) - 2 * math.log(math.cosh(pre_action))


def random_prior(action_dim=1, **options):
    marginal = LearnedPrior(action_dim, **options).double()
    for parameter in marginal.parameters():
        parameter.data.normal_()
    return marginal


def two_habits():
    """Pre-actions of a policy that goes left or right and never rests."""
    return MixtureSameFamily(
        Categorical(torch.tensor([0.7, 0.3]).double()),
        Normal(torch.tensor([-1.5, 1.0]).double(), torch.tensor([0.3, 0.2]).double()),
    )


@pytest.fixture(scope="module")
def fitted():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        marginal = LearnedPrior(1).double()
        optimizer = torch.optim.Adam(marginal.parameters(), lr=0.03, fused=True)
        for _ in range(300):
            optimizer.zero_grad()
            prior_loss(marginal.log_prob(two_habits().sample((256, 1)))).backward()
            optimizer.step()
    return marginal


def test_the_marginal_learns_two_habits(fitted):
    truth = two_habits()

    def log_ratio(u):
        point = torch.tensor(u, dtype=torch.float64)
        return truth.log_prob(point).exp().item() * (
            truth.log_prob(point).item() - math.log(density(fitted, u))
        )

    divergence, _ = integrate.quad(log_ratio, -4, 4, points=[-1.5, 1.0])
    assert 0 <= divergence < -math.log1p(-0.1) + 0.03  # the uniform share costs a tenth


def test_the_learned_density_integrates_to_one(fitted):
    total, _ = integrate.quad(lambda u: density(fitted, u), -20, 20, points=[-1.5, 1.0], limit=200)
    assert total == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("uniform_share", [0.1, 0.9])
def test_any_density_integrates_to_one(uniform_share):
    marginal = random_prior(uniform_share=uniform_share)
    peaks = marginal.habit.loc.flatten().tolist()
    total, _ = integrate.quad(lambda u: density(marginal, u), -500, 500, points=peaks, limit=500)
    assert total == pytest.approx(1, abs=1e-6)


def test_the_density_is_the_mixture_it_says_it_is():
    marginal = LearnedPrior(1, components=1, uniform_share=0.25).double()
    marginal.raw_loc.data.fill_(MOST_HABIT * math.atanh(0.5 / MOST_HABIT))
    marginal.raw_std.data.fill_(math.log(0.55 / 0.45))  # plus the floor of 0.05: 0.6
    for pre_action in (-2.0, 0.0, 3.0):
        habit = Normal(0.5, 0.6).log_prob(torch.tensor(pre_action)).exp().item()
        expected = 0.75 * habit + 0.25 * math.exp(log_uniform(pre_action))
        assert density(marginal, pre_action) == pytest.approx(expected, rel=1e-6)


def test_the_uniform_share_is_a_floor_of_the_density():
    marginal = random_prior(action_dim=3, uniform_share=0.2)
    marginal.raw_loc.data.fill_(-50.0)  # habits far from every point
    marginal.raw_std.data.fill_(-50.0)
    pre_action = torch.rand(100, 3, dtype=torch.float64) * 4
    uniform = UniformPrior(3).log_prob(pre_action) - 3 * math.log(2)
    floor = uniform + math.log(0.2)
    assert (marginal.log_prob(pre_action) >= floor - 1e-9).all()
    torch.testing.assert_close(marginal.log_prob(pre_action), floor)


def test_no_habit_is_narrower_than_the_floor():
    marginal = LearnedPrior(1, components=1).double()
    marginal.raw_std.data.fill_(-50.0)
    marginal.raw_loc.data.zero_()
    peak = 0.9 / (math.sqrt(2 * math.pi) * math.exp(LOG_STD_FLOOR)) + 0.1 * 0.5
    assert density(marginal, 0.0) == pytest.approx(peak, rel=1e-6)


@pytest.mark.parametrize("edge", [-1e4, 1e4])
def test_no_habit_lies_where_actions_are_one_and_pre_actions_are_not(edge):
    """A policy that ran off to there with its prior would spend its rate on nothing."""
    marginal = LearnedPrior(1)
    for parameter in (marginal.raw_loc, marginal.raw_std):
        parameter.data.fill_(edge)
    assert marginal.habit.loc.abs().max() <= MOST_HABIT
    assert marginal.habit.log_var.max() <= 0.1  # and the floor
    beyond = torch.tensor([[4.0], [8.0], [12.0]])  # hardly another action
    assert (marginal.log_prob(beyond).diff() < -3).all()  # each costs as much as under uniform


def test_prior_and_policy_do_not_run_off_together():
    """Fitted to ever fuller actions, it stays a few nats from uniform."""
    marginal = LearnedPrior(1)
    optimizer = torch.optim.Adam(marginal.parameters(), lr=0.1)
    for _ in range(200):
        optimizer.zero_grad()
        prior_loss(marginal.log_prob(8 + torch.randn(64, 1))).backward()
        optimizer.step()
    assert marginal.metrics()["prior_kl_to_uniform"] < 4


def test_divergence_from_uniform_agrees_with_quadrature(fitted):
    def integrand(u):
        log_density = math.log(density(fitted, u))
        return math.exp(log_density) * (log_density - log_uniform(u))

    truth, _ = integrate.quad(integrand, -15, 15, points=[-1.5, 1.0], limit=200)
    noise = torch.randn(50_000, 1, dtype=torch.float64)
    with torch.no_grad():
        assert fitted.kl_to_uniform(noise).item() == pytest.approx(truth, abs=0.02)


def test_an_almost_uniform_marginal_does_not_diverge_from_uniform():
    marginal = LearnedPrior(2, uniform_share=1 - 1e-6)
    assert marginal.kl_to_uniform(torch.randn(500, 2)).item() == pytest.approx(0, abs=1e-4)


def test_divergence_from_uniform_is_finite_for_extreme_noise():
    noise = torch.tensor([[-8.0], [8.0], [0.0]])
    assert LearnedPrior(1).kl_to_uniform(noise).isfinite()


def test_flat_prior_integrates_to_the_volume_it_names():
    prior = UniformPrior(1)
    total, _ = integrate.quad(lambda u: density(prior, u), -20, 20)
    assert total == pytest.approx(math.exp(prior.log_volume), abs=1e-6)


def test_flat_prior_has_nothing_to_learn():
    assert list(UniformPrior(3).parameters()) == [] and len(UniformPrior(3).state_dict()) == 0


def test_gradients_reach_every_parameter_and_the_pre_action():
    marginal = LearnedPrior(2)
    pre_action = torch.randn(64, 2, requires_grad=True)
    prior_loss(marginal.log_prob(pre_action)).backward()
    assert all((parameter.grad != 0).any() for parameter in marginal.parameters())
    assert (pre_action.grad != 0).any()


@pytest.mark.parametrize("prior", [UniformPrior(2), LearnedPrior(2)])
def test_any_leading_shape_will_do(prior):
    pre_action = torch.randn(3, 4, 2)
    flat = prior.log_prob(pre_action.flatten(0, 1))
    torch.testing.assert_close(prior.log_prob(pre_action).flatten(), flat)


@pytest.mark.parametrize("prior", [UniformPrior(1), LearnedPrior(1)])
def test_log_density_is_finite_far_out(prior):
    assert prior.log_prob(torch.tensor([[-40.0], [40.0]])).isfinite().all()


@pytest.mark.parametrize(
    ("name", "value"), [("components", 0), ("uniform_share", 0.0), ("uniform_share", 1.0)]
)
def test_a_prior_out_of_range_is_rejected_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=rf"`{name}`.*got {value}"):
        LearnedPrior(1, **{name: value})


def column(value):
    return torch.tensor([[value]], dtype=torch.float64)


def one_component(loc, log_std):
    log_weight = torch.zeros(len(loc), 1, dtype=loc.dtype)
    return DiagonalMixture(loc.unsqueeze(-2), 2 * log_std.unsqueeze(-2), log_weight)


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


def squashed_log_prob(pre_log_prob, pre_action):
    """Log density of `tanh(pre_action)` on the action box, from that of the pre-action."""
    return pre_log_prob - log_abs_det_tanh(pre_action)


def test_squashed_log_density_agrees_with_torch_distributions():
    loc, log_std = torch.randn(2, 64, 3, dtype=torch.float64)
    pre_action = loc + log_std.exp() * torch.randn(64, 3, dtype=torch.float64)
    squash = TanhTransform(cache_size=1)  # the cache spares the inverse, which is not stable
    reference = TransformedDistribution(Independent(Normal(loc, log_std.exp()), 1), squash)
    action = squash(pre_action)
    actual = squashed_log_prob(gaussian_log_prob(pre_action, loc, log_std), pre_action)
    torch.testing.assert_close(actual, reference.log_prob(action), atol=1e-7, rtol=1e-7)


def test_single_precision_is_right_at_large_pre_actions():
    pre_action = torch.tensor([[9.0], [20.0], [-30.0]])
    policy = one_component(pre_action, torch.zeros(3, 1))
    actual = squashed_log_prob(policy.log_prob(pre_action), pre_action)
    expected = -0.5 * math.log(2 * math.pi) - math.log(4) + 2 * pre_action.abs().squeeze(-1)
    torch.testing.assert_close(actual, expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("loc", "log_std"), [(0.0, -1.0), (0.5, -1.5)])
def test_squashed_density_integrates_to_one_over_the_action_box(loc, log_std):
    policy = one_component(column(loc), column(log_std))

    def density(action):
        pre_action = column(math.atanh(action))
        return squashed_log_prob(policy.log_prob(pre_action), pre_action).exp().item()

    total, _ = integrate.quad(density, -1, 1)
    assert total == pytest.approx(1, abs=1e-6)


def test_flat_density_integrates_to_the_volume_of_the_box():
    total, _ = integrate.quad(lambda u: log_abs_det_tanh(column(u)).exp().item(), -20, 20)
    assert total == pytest.approx(2, abs=1e-6)


def test_flat_density_of_the_action_is_one_everywhere():
    pre_action = torch.randn(9, 4, dtype=torch.float64) * 5
    on_the_box = squashed_log_prob(log_abs_det_tanh(pre_action), pre_action)
    torch.testing.assert_close(on_the_box, torch.zeros(9, dtype=torch.float64))


def test_the_squash_cancels_from_a_difference_of_log_densities():
    pre_action = torch.randn(9, 2, dtype=torch.float64) * 2
    one, other = torch.randn(2, 9, dtype=torch.float64)
    squashed = squashed_log_prob(one, pre_action) - squashed_log_prob(other, pre_action)
    torch.testing.assert_close(squashed, one - other)


@pytest.mark.parametrize("components", [1, 3])
def test_a_policy_can_be_computed_from_its_last_hidden_layer(components):
    policy = GaussianPolicy(3, 2, mixture_components=components, hidden_dims=(8, 6))
    observation = torch.randn(5, 3)
    hidden = policy.hidden(observation)
    assert hidden.shape == (5, 6)
    for field, expected in zip(policy.at(hidden), policy(observation), strict=True):
        torch.testing.assert_close(field, expected)
