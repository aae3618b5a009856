import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal, kl_divergence

from deep_curiosity import gaussians
from deep_curiosity.gaussians import (
    DiagonalMixture,
    expected_log_density,
    gaussian_entropy,
    gaussian_kl,
    gaussian_log_prob,
    jensen_shannon_lower,
    jensen_shannon_upper,
    kl_to_mixture_lower,
    kl_to_mixture_sampled,
    kl_to_mixture_upper,
    mixture_log_density,
    sample_index,
)

BOUNDS = (kl_to_mixture_lower, kl_to_mixture_upper)


def random_problem(seed, *, batch=4, components=5, dim=2, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)

    def sample(*shape):
        return torch.randn(*shape, generator=generator, dtype=dtype)

    log_weight = torch.log_softmax(sample(components), 0)
    return (
        sample(batch, dim),
        sample(batch, dim),
        sample(components, dim),
        sample(components, dim),
        log_weight,
    )


def mixture(component_loc, component_log_var, component_log_weight):
    components = Independent(Normal(component_loc, (0.5 * component_log_var).exp()), 1)
    return MixtureSameFamily(Categorical(logits=component_log_weight), components)


def kl_by_quadrature(loc, log_var, *problem):
    """Divergence of one Gaussian to a mixture in one or two dimensions."""
    own = Independent(Normal(loc, (0.5 * log_var).exp()), 1)
    other = mixture(*problem)
    half_width = 9 * (0.5 * log_var).exp()
    low, high = (loc - half_width).tolist(), (loc + half_width).tolist()
    axes = [np.linspace(a, b, 801) for a, b in zip(low, high, strict=True)]
    grid = torch.from_numpy(np.stack(np.meshgrid(*axes, indexing="ij"), -1))
    log_own = own.log_prob(grid)
    integrand = (log_own.exp() * (log_own - other.log_prob(grid))).numpy()
    for axis in reversed(axes):
        integrand = integrate.simpson(integrand, x=axis)
    return float(integrand)


def test_entropy_of_a_unit_gaussian():
    assert gaussian_entropy(torch.zeros(1)).item() == pytest.approx(1.4189385)


def test_entropy_agrees_with_torch_distributions():
    log_var = torch.randn(3, 4, dtype=torch.float64)
    expected = Normal(torch.zeros_like(log_var), (0.5 * log_var).exp()).entropy().sum(-1)
    torch.testing.assert_close(gaussian_entropy(log_var), expected)


def test_kl_of_a_shifted_unit_gaussian_is_half_the_square_of_the_shift():
    zero, shift = torch.zeros(1, 1), torch.full((1, 1), 3.0)
    assert gaussian_kl(shift, zero, zero, zero).item() == pytest.approx(4.5)


def test_kl_of_two_gaussians_agrees_with_torch_distributions():
    loc, log_var, other_loc, other_log_var, _ = random_problem(0, components=4)
    expected = kl_divergence(
        Independent(Normal(loc, (0.5 * log_var).exp()), 1),
        Independent(Normal(other_loc, (0.5 * other_log_var).exp()), 1),
    )
    torch.testing.assert_close(gaussian_kl(loc, log_var, other_loc, other_log_var), expected)


def test_kl_to_itself_is_zero():
    loc, log_var, *_ = random_problem(1)
    assert gaussian_kl(loc, log_var, loc, log_var).abs().max() == 0


def test_mixture_log_density_agrees_with_torch_distributions():
    value, _, *problem = random_problem(2)
    torch.testing.assert_close(
        mixture_log_density(value, *problem), mixture(*problem).log_prob(value)
    )


def test_expected_log_density_is_minus_the_cross_entropy():
    loc, log_var, component_loc, component_log_var, _ = random_problem(3)
    own, other = (loc.unsqueeze(1), log_var.unsqueeze(1)), (component_loc, component_log_var)
    cross_entropy = gaussian_kl(*own, *other) + gaussian_entropy(own[1])
    actual = expected_log_density(loc, log_var, component_loc, component_log_var)
    torch.testing.assert_close(actual, -cross_entropy - math.log(5))


@pytest.mark.parametrize("bound", BOUNDS)
def test_bounds_meet_the_exact_divergence_where_the_mixture_has_one_component(bound):
    loc, log_var, component_loc, component_log_var, _ = random_problem(4, components=1)
    exact = gaussian_kl(loc, log_var, component_loc, component_log_var)
    actual = bound(loc, log_var, component_loc, component_log_var)
    if bound is kl_to_mixture_upper:
        torch.testing.assert_close(actual, exact)
    else:
        assert (actual <= exact).all()


@pytest.mark.parametrize("bound", BOUNDS)
def test_absent_weights_are_equal_weights(bound):
    loc, log_var, component_loc, component_log_var, _ = random_problem(5)
    equal = torch.full((5,), -math.log(5), dtype=torch.float64)
    arguments = loc, log_var, component_loc, component_log_var
    torch.testing.assert_close(bound(*arguments), bound(*arguments, equal))


@pytest.mark.parametrize("bound", BOUNDS)
def test_components_of_zero_weight_do_not_count(bound):
    loc, log_var, component_loc, component_log_var, _ = random_problem(6)
    log_weight = torch.tensor([-math.log(2)] * 2 + [-math.inf] * 3, dtype=torch.float64)
    actual = bound(loc, log_var, component_loc, component_log_var, log_weight)
    torch.testing.assert_close(
        actual, bound(loc, log_var, component_loc[:2], component_log_var[:2])
    )


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000), dim=st.sampled_from([1, 2]), components=st.integers(1, 6))
def test_quadrature_lies_between_the_bounds(seed, dim, components):
    problem = random_problem(seed, batch=1, components=components, dim=dim)
    truth = kl_by_quadrature(problem[0][0], problem[1][0], *problem[2:])
    lower, upper = (bound(*problem).item() for bound in BOUNDS)
    assert lower - 1e-6 <= truth <= upper + 1e-6


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10_000), dim=st.sampled_from([1, 2]))
def test_sampled_estimate_agrees_with_quadrature(seed, dim):
    loc, log_var, *problem = random_problem(seed, batch=1, dim=dim)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(200_000, 1, dim, dtype=torch.float64, generator=generator)
    samples = loc + (0.5 * log_var).exp() * noise
    estimate = kl_to_mixture_sampled(loc, log_var, *problem, samples=samples).item()
    truth = kl_by_quadrature(loc[0], log_var[0], *problem)
    assert estimate == pytest.approx(truth, abs=0.02 * (1 + abs(truth)))


@pytest.mark.parametrize("bound", BOUNDS)
def test_float32_is_within_a_thousandth_of_a_nat_at_17_dimensions(bound):
    generator = torch.Generator().manual_seed(0)
    loc = torch.randn(256, 17, generator=generator)
    component_loc = torch.randn(256, 17, generator=generator)
    component_loc[:128] = loc[:128]  # as when the mixture holds the same states
    log_var = torch.full((256, 17), 2 * math.log(0.05))
    arguments = (loc, log_var, component_loc, log_var)
    exact = bound(*(argument.double() for argument in arguments))
    assert exact.min() < 10 < 1_000 < exact.max()
    assert (bound(*arguments).double() - exact).abs().max() < 1e-3


def test_gradients_are_exact():
    loc, log_var, component_loc, component_log_var, log_weight = random_problem(
        7, batch=2, components=3
    )
    arguments = [loc, log_var, component_loc, component_log_var, log_weight]
    inputs = tuple(argument.requires_grad_() for argument in arguments)
    noise = torch.randn(3, 2, 2, dtype=torch.float64)

    def sampled(loc, log_var, *problem):
        samples = loc + (0.5 * log_var).exp() * noise
        return kl_to_mixture_sampled(loc, log_var, *problem, samples=samples)

    for divergence in (*BOUNDS, sampled):
        assert torch.autograd.gradcheck(divergence, inputs)


def test_members_are_a_leading_axis():
    loc, log_var, *problem = random_problem(8, batch=6)
    stacked = kl_to_mixture_upper(loc.unflatten(0, (2, 3)), log_var.unflatten(0, (2, 3)), *problem)
    torch.testing.assert_close(stacked.flatten(), kl_to_mixture_upper(loc, log_var, *problem))


def several(loc, std, weight):
    """A mixture over one dimension, in the arguments of the Jensen-Shannon bounds."""
    loc, std, weight = (torch.tensor(part, dtype=torch.float64) for part in (loc, std, weight))
    return loc.unsqueeze(-1), 2 * std.log().unsqueeze(-1), weight.log()


def jensen_shannon_by_quadrature(loc, log_var, log_weight):
    return sum(
        weight * kl_by_quadrature(loc[k], log_var[k], loc, log_var, log_weight)
        for k, weight in enumerate(log_weight.exp().tolist())
    )


@pytest.mark.parametrize("gap", [0.0, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("std", [[1.0, 1.0], [0.3, 1.0]])
@pytest.mark.parametrize("weight", [[0.5, 0.5], [0.1, 0.9]])
def test_the_information_about_the_component_lies_between_its_bounds(gap, std, weight):
    problem = several([0.0, gap], std, weight)
    truth = jensen_shannon_by_quadrature(*problem)
    assert jensen_shannon_lower(*problem).item() <= truth + 1e-9
    assert jensen_shannon_upper(*problem).item() >= truth - 1e-9


@pytest.mark.parametrize("bound", [jensen_shannon_lower, jensen_shannon_upper])
def test_the_information_about_the_component_is_exact_at_both_ends(bound):
    weight = [0.2, 0.3, 0.5]
    entropy = -sum(share * math.log(share) for share in weight)
    assert bound(*several([1.0] * 3, [0.4] * 3, weight)).item() == pytest.approx(0, abs=1e-12)
    assert bound(*several([0.0, 50.0, 99.0], [0.4] * 3, weight)).item() == pytest.approx(entropy)
    assert bound(*several([0.7], [0.4], [1.0])).item() == 0


@pytest.mark.parametrize("bound", [jensen_shannon_lower, jensen_shannon_upper])
def test_the_information_about_the_component_is_of_each_place(bound):
    loc, log_var, weight = torch.randn(4, 5, 3, 2), torch.randn(4, 5, 3, 2), torch.randn(4, 5, 3)
    log_weight = weight.log_softmax(-1)
    actual = bound(loc, log_var, log_weight)
    assert actual[2, 3].item() == pytest.approx(
        bound(loc[2, 3], log_var[2, 3], log_weight[2, 3]).item(), abs=1e-5
    )
    assert actual.shape == (4, 5) and (actual >= 0).all()


def test_log_density_at_the_centre_of_a_unit_gaussian():
    zero = torch.zeros(1, 2)
    assert gaussian_log_prob(zero, zero, zero).item() == pytest.approx(-math.log(2 * math.pi))


def test_gaussian_log_density_agrees_with_torch_distributions():
    value, loc, log_std = torch.randn(3, 5, 4, dtype=torch.float64)
    expected = Independent(Normal(loc, log_std.exp()), 1).log_prob(value)
    torch.testing.assert_close(gaussian_log_prob(value, loc, log_std), expected)


def test_log_density_under_a_mixture_agrees_with_torch_distributions():
    value = torch.randn(6, 3, dtype=torch.float64) * 3
    loc, log_std = torch.randn(2, 4, 3, dtype=torch.float64)
    log_weight = torch.log_softmax(torch.randn(4, dtype=torch.float64), 0)
    components = Independent(Normal(loc, log_std.exp()), 1)
    expected = MixtureSameFamily(Categorical(logits=log_weight), components).log_prob(value)
    actual = DiagonalMixture(loc, 2 * log_std, log_weight).log_prob(value)
    torch.testing.assert_close(actual, expected)


def test_a_mixture_far_from_its_components_stays_in_logs():
    loc, log_var = torch.zeros(2, 1), torch.zeros(2, 1)
    log_weight = torch.full((2,), -math.log(2))
    actual = DiagonalMixture(loc, log_var, log_weight).log_prob(torch.full((1, 1), 100.0))
    assert actual.item() == pytest.approx(-5_000 - 0.5 * math.log(2 * math.pi))


def one_component(loc, log_std):
    log_weight = torch.zeros(len(loc), 1, dtype=loc.dtype)
    return DiagonalMixture(loc.unsqueeze(-2), 2 * log_std.unsqueeze(-2), log_weight)


def column(value):
    return torch.tensor([[value]], dtype=torch.float64)


@pytest.mark.parametrize(("loc", "log_std"), [(0.0, 0.0), (2.0, -1.0), (-1.0, 0.5)])
def test_the_density_of_one_component_integrates_to_one(loc, log_std):
    mixture = one_component(column(loc), column(log_std))
    total, _ = integrate.quad(lambda u: mixture.log_prob(column(u)).exp().item(), -30, 30)
    assert total == pytest.approx(1, abs=1e-6)


def test_samples_of_components_follow_the_noise():
    loc, log_std = torch.tensor([[1.0]]), torch.tensor([[math.log(3)]])
    mixture = one_component(loc.requires_grad_(), log_std.requires_grad_())
    point = mixture.component_samples(torch.tensor([[[2.0]]]))
    assert point.item() == pytest.approx(7)
    point.sum().backward()
    assert loc.grad.item() == 1 and log_std.grad.item() == pytest.approx(6)


def two_components(weight, loc=(-2.0, 1.0), std=(0.5, 1.5)):
    """A mixture of two over one coordinate, at one place."""
    shape = (1, 2, 1)
    return DiagonalMixture(
        torch.tensor(loc).view(shape),
        2 * torch.tensor(std).log().view(shape),
        torch.tensor([[1 - weight, weight]]).log(),
    )


def components_of(mixture):
    """Its components, by torch's own distributions."""
    return Normal(mixture.loc.flatten(), (0.5 * mixture.log_var).exp().flatten())


def test_a_mixture_density_agrees_with_torch_distributions():
    mixture, value = two_components(0.3), torch.linspace(-5, 5, 21).unsqueeze(-1)
    reference = MixtureSameFamily(
        Categorical(logits=mixture.log_weight.flatten()), components_of(mixture)
    )
    torch.testing.assert_close(mixture.log_prob(value), reference.log_prob(value.squeeze(-1)))


def at_places(mixture, num_places):
    """The same mixture at many places."""
    return DiagonalMixture(*(part.expand(num_places, *part.shape[1:]) for part in mixture))


def test_a_mixture_samples_from_its_components_by_their_weights():
    samples = at_places(two_components(0.3), 40_000).sample().squeeze(-1)
    below = torch.tensor([-2.5, -1.0, 1.0, 2.0])
    cdf = components_of(two_components(0.3)).cdf(below[:, None])
    expected = cdf @ torch.tensor([0.7, 0.3])
    actual = (samples < below[:, None]).float().mean(-1)
    torch.testing.assert_close(actual, expected, atol=0.01, rtol=0)


def test_the_cumulative_probability_of_a_mixture_agrees_with_torch_distributions():
    mixture, value = two_components(0.3), torch.linspace(-5, 5, 21).unsqueeze(-1)
    expected = components_of(mixture).cdf(value) @ torch.tensor([0.7, 0.3])
    torch.testing.assert_close(mixture.cdf(value).squeeze(-1), expected)


@pytest.mark.parametrize("places", [(20_000,), (100, 200)])
def test_indices_are_sampled_by_their_probability(places):
    probability = torch.tensor([0.1, 0.6, 0.3])
    index = sample_index(probability.log().expand(*places, 3))
    assert index.shape == places
    share = torch.bincount(index.flatten(), minlength=3) / 20_000
    torch.testing.assert_close(share, probability, atol=0.015, rtol=0.0)


def test_expectations_component_by_component_are_those_of_the_mixture():
    mixture = at_places(two_components(0.3), 50_000)
    points = mixture.component_samples(torch.randn_like(mixture.loc)).transpose(0, 1)
    stratified = mixture.mean(mixture.log_prob(points).mT).mean()
    sampled = mixture.log_prob(mixture.sample()).mean()
    assert stratified.item() == pytest.approx(sampled.item(), abs=0.02)


def random_mixture(*shape):
    """A mixture for each place of a batch, in float64."""
    loc, log_var = torch.randn(2, *shape, dtype=torch.float64)
    return DiagonalMixture(loc, log_var, torch.randn_like(loc[..., 0]).log_softmax(-1))


def test_a_component_is_selected_for_each_place():
    mixture, component = random_mixture(4, 3, 2), torch.tensor([2, 0, 1, 2])
    loc, log_var = mixture.select(component)
    for place, chosen in enumerate(component):
        assert loc[place].equal(mixture.loc[place, chosen])
        assert log_var[place].equal(mixture.log_var[place, chosen])


def test_the_marginal_over_some_coordinates_is_exact():
    mixture, value = random_mixture(3, 3), torch.randn(5, 3, dtype=torch.float64)
    axis = torch.linspace(-12, 12, 2_001, dtype=torch.float64)
    everywhere = value.unsqueeze(1).repeat(1, len(axis), 1)
    everywhere[..., 1] = axis
    integrated = torch.trapezoid(mixture.log_prob(everywhere).exp(), axis)
    actual = mixture.coordinates([0, 2]).log_prob(value[:, [0, 2]])
    torch.testing.assert_close(actual.exp(), integrated)


@pytest.mark.parametrize("index", [[1], [0, 1, 2], [2, 0, 1], [-1, 1], [-2, -1, 0]])
def test_coordinates_are_those_named_in_their_order(index):
    mixture = random_mixture(3, 3)
    some = mixture.coordinates(index)
    assert some.loc.equal(mixture.loc[..., index])
    assert some.log_var.equal(mixture.log_var[..., index])


@pytest.mark.parametrize("index", [[3], [0, -4], []])
def test_coordinates_that_there_are_not_are_refused(index):
    with pytest.raises(ValueError, match=r"`index` must name coordinates of 3, got \["):
        random_mixture(3, 3).coordinates(index)


def test_entropy_of_a_mixture_is_below_that_of_quadrature_and_of_one_component_exact():
    axis = torch.linspace(-12, 12, 4_001).unsqueeze(-1)
    mixture = two_components(0.3)
    density = mixture.log_prob(axis).exp()
    exact = torch.trapezoid(torch.special.entr(density), axis.squeeze(-1)).item()
    assert exact - 0.2 < mixture.entropy().item() <= exact
    alone = one_component(column(2.0), column(-1.0))
    torch.testing.assert_close(alone.entropy(), gaussian_entropy(column(-2.0)))


def test_divergence_of_two_mixtures_lies_between_its_bounds():
    one, other = random_mixture(4, 3, 1), random_mixture(5, 1)
    axis = torch.linspace(-20, 20, 8_001, dtype=torch.float64).unsqueeze(-1)
    log_other = other.log_prob(axis)
    for place in range(4):
        own = DiagonalMixture(*(field[place] for field in one)).log_prob(axis)
        truth = torch.trapezoid(own.exp() * (own - log_other), axis.squeeze(-1))
        assert one.kl_lower(other)[place] - 1e-6 <= truth <= one.kl_upper(other)[place] + 1e-6


@pytest.mark.parametrize("bound", BOUNDS)
def test_divergence_of_a_mixture_of_one_is_that_of_its_component(bound):
    loc, log_var, *problem = random_problem(9)
    alone = DiagonalMixture(
        loc.unsqueeze(-2), log_var.unsqueeze(-2), torch.zeros(4, 1, dtype=torch.float64)
    )
    method = alone.kl_upper if bound is kl_to_mixture_upper else alone.kl_lower
    torch.testing.assert_close(method(DiagonalMixture(*problem)), bound(loc, log_var, *problem))


@pytest.mark.parametrize("bound", [kl_to_mixture_lower, kl_to_mixture_upper])
@pytest.mark.parametrize("loc", [None, [0.0], torch.zeros(4, 2, dtype=torch.long)])
def test_what_is_no_tensor_of_real_numbers_is_refused_by_name(bound, loc):
    component = torch.zeros(5, 2)
    with pytest.raises(TypeError, match="`loc` must be a tensor of real numbers, got"):
        bound(loc, torch.zeros(4, 2), component, component)


@pytest.mark.parametrize("value", [1e38, math.nan, math.inf])
def test_an_answer_that_is_no_number_is_refused_by_the_name_of_its_cause(value):
    log_var = torch.zeros(3, 2)
    log_var[1, 1] = value
    with pytest.raises(ValueError, match="`log_var` must be so small that the answer is a number"):
        gaussian_kl(torch.zeros(3, 2), log_var, torch.zeros(3, 2), torch.zeros(3, 2))


def test_a_component_of_no_weight_is_no_reason_to_refuse():
    log_weight = torch.tensor([0.0, -math.inf])
    value, component = torch.zeros(3, 2), torch.zeros(2, 2)
    density = mixture_log_density(value, component, component, log_weight)
    torch.testing.assert_close(density, torch.full((3,), -math.log(2 * math.pi)))
    assert (
        expected_log_density(value, value, component, component, log_weight)[:, 1] == -math.inf
    ).all()


@pytest.mark.parametrize("weighted", [True, False])
def test_one_gaussian_without_a_batch_is_answered_as_in_a_batch_of_one(weighted):
    loc, log_var, *problem = random_problem(6, batch=1)
    problem = problem if weighted else problem[:2]
    for function in (kl_to_mixture_upper, kl_to_mixture_lower, expected_log_density):
        alone = function(loc[0], log_var[0], *problem)
        torch.testing.assert_close(alone, function(loc, log_var, *problem)[0])
    alone = mixture_log_density(loc[0], *problem)
    torch.testing.assert_close(alone, mixture_log_density(loc, *problem)[0])
    assert alone.shape == ()


def test_half_precision_is_enough_for_weights_of_zero_and_others():
    loc, log_var, *problem = random_problem(7)
    problem[-1][0] = -math.inf
    exact = kl_to_mixture_upper(loc, log_var, *problem)
    halves = [each.half() for each in (loc, log_var, *problem)]
    rounded = kl_to_mixture_upper(*halves)
    assert rounded.dtype == torch.float16
    torch.testing.assert_close(rounded.double(), exact, rtol=1e-2, atol=2e-2)


def test_a_choice_without_weight_is_never_made(monkeypatch):
    monkeypatch.setattr(torch, "rand_like", torch.zeros_like)  # as once in 2^24 draws
    log_weight = torch.tensor([-torch.inf, 0.0, -torch.inf])
    assert sample_index(log_weight) == 1


@pytest.mark.parametrize("batch", [(), (7,), (2, 3), (0,)])
def test_a_bound_by_overlap_is_the_same_where_it_is_computed_piece_by_piece(batch, monkeypatch):
    monkeypatch.setattr(gaussians, "MOST_AT_ONCE", 25)  # a Gaussian, or two, at a time
    arguments = torch.randn(*batch, 3), torch.randn(*batch, 3), *torch.randn(2, 4, 3)
    whole = kl_to_mixture_lower(*arguments)
    with torch.no_grad():
        pieces = kl_to_mixture_lower(*arguments)
    assert pieces.shape == batch
    torch.testing.assert_close(pieces, whole)
