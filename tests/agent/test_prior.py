import math

import pytest
import torch
from scipy import integrate
from torch.distributions import Categorical, MixtureSameFamily, Normal

from deep_curiosity.agent.prior import LOG_STD_FLOOR, LearnedPrior, UniformPrior
from deep_curiosity.losses import prior_loss


def density(prior, pre_action):
    with torch.no_grad():
        return prior.log_prob(torch.tensor([[pre_action]], dtype=torch.float64)).exp().item()


def log_uniform(pre_action):
    """Log density of a pre-action whose tanh is uniform on [-1, 1], in one dimension."""
    return math.log(0.5) - 2 * math.log(math.cosh(pre_action))


def random_marginal(action_dim=1, **options):
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
    marginal = random_marginal(uniform_share=uniform_share)
    peaks = marginal.loc.flatten().tolist()
    total, _ = integrate.quad(lambda u: density(marginal, u), -500, 500, points=peaks, limit=500)
    assert total == pytest.approx(1, abs=1e-6)


def test_the_density_is_the_mixture_it_says_it_is():
    marginal = LearnedPrior(1, components=1, uniform_share=0.25).double()
    marginal.loc.data.fill_(0.5)
    marginal.raw_log_std.data.fill_(math.log(0.95))  # plus the floor of 0.05: one
    for pre_action in (-2.0, 0.0, 3.0):
        habit = Normal(0.5, 1.0).log_prob(torch.tensor(pre_action)).exp().item()
        expected = 0.75 * habit + 0.25 * math.exp(log_uniform(pre_action))
        assert density(marginal, pre_action) == pytest.approx(expected, rel=1e-6)


def test_the_uniform_share_is_a_floor_of_the_density():
    marginal = random_marginal(action_dim=3, uniform_share=0.2)
    marginal.loc.data.fill_(50.0)  # habits far from everything asked about
    pre_action = torch.randn(100, 3, dtype=torch.float64) * 4
    uniform = UniformPrior(3).log_prob(pre_action) - 3 * math.log(2)
    floor = uniform + math.log(0.2)
    assert (marginal.log_prob(pre_action) >= floor - 1e-9).all()
    torch.testing.assert_close(marginal.log_prob(pre_action), floor)


def test_no_habit_is_narrower_than_the_floor():
    marginal = LearnedPrior(1, components=1).double()
    marginal.raw_log_std.data.fill_(-50.0)
    marginal.loc.data.zero_()
    peak = 0.9 / (math.sqrt(2 * math.pi) * math.exp(LOG_STD_FLOOR)) + 0.1 * 0.5
    assert density(marginal, 0.0) == pytest.approx(peak, rel=1e-6)


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
def test_what_is_out_of_range_is_rejected_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=rf"`{name}`.*got {value}"):
        LearnedPrior(1, **{name: value})
