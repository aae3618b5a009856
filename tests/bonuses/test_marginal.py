import math

import jaxtyping
import pytest
import torch
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal

from deep_curiosity.bonuses.marginal import NextStateMarginal, silverman_log_bandwidth
from deep_curiosity.gaussians import DiagonalMixture, kl_to_mixture_lower, kl_to_mixture_upper

HOLES = 1e-3  # a bandwidth that fills none


def log_var_of(std, *shape):
    return torch.full(shape, 2 * math.log(std))


def gaussian(loc, log_var):
    """Predictions of one component."""
    return DiagonalMixture(
        loc.unsqueeze(-2), log_var.unsqueeze(-2), torch.zeros(*loc.shape[:-1], 1)
    )


def numbered(start, stop):
    """Predicted next states that carry their own number."""
    loc = torch.arange(start, stop, dtype=torch.float32).unsqueeze(-1)
    return loc, torch.zeros_like(loc)


def held(marginal):
    filled = marginal.log_weight > -math.inf
    return sorted(marginal.loc[filled].flatten().tolist())


def test_silverman_bandwidth_by_hand():
    # (4 / 3)^(1/5) * 100^(-1/5) in one dimension: the rule of 1.06
    assert math.exp(silverman_log_bandwidth(100, 1)) == pytest.approx(
        1.05922 * 100**-0.2, rel=1e-5
    )
    assert math.exp(silverman_log_bandwidth(64, 2)) == pytest.approx(0.5)


def test_components_are_widened_by_the_bandwidth_times_their_std():
    marginal = NextStateMarginal(2, components=64, bandwidth="silverman")
    loc = torch.randn(64, 2) * torch.tensor([3.0, 0.1])
    marginal.refresh(loc, log_var_of(0.05, 64, 2))
    expected = 0.05**2 + 0.25 * loc.var(0, correction=0)  # h = 1/2
    torch.testing.assert_close(marginal.component_log_var.exp(), expected.expand(64, 2))


def test_a_number_is_the_bandwidth_itself():
    marginal = NextStateMarginal(1, components=8, bandwidth=0.3)
    loc, log_var = numbered(0, 8)
    marginal.refresh(loc, log_var)
    expected = 1 + 0.09 * loc.var(0, correction=0)
    torch.testing.assert_close(marginal.component_log_var.exp(), expected.expand(8, 1))


def test_silverman_counts_only_the_components_that_are_filled():
    marginal = NextStateMarginal(1, components=100, bandwidth="silverman")
    loc = torch.randn(10, 1)
    marginal.refresh(loc, log_var_of(1e-6, 10, 1))
    width = (0.5 * marginal.bandwidth_log_var).exp() / loc.std(0, correction=0)
    assert width.item() == pytest.approx(1.05922 * 10**-0.2, rel=1e-4)


def stretched(states, refreshes=40, **options):
    """A marginal whose components shall overlap, after some refreshes with sharp predictions."""
    marginal = NextStateMarginal(
        states.shape[1], components=len(states), bandwidth="overlap", **options
    )
    for _ in range(refreshes):
        marginal.replace(states, log_var_of(0.05, *states.shape))
    return marginal


def test_kernels_that_overlap_are_silverman_s():
    states = torch.randn(256, 2)
    marginal, silverman = stretched(states), NextStateMarginal(2, bandwidth="silverman")
    silverman.replace(states, log_var_of(0.05, 256, 2))
    assert silverman.perplexity() > 16
    assert marginal.bandwidth_log_var.equal(silverman.bandwidth_log_var)


@pytest.mark.parametrize(("components", "dim"), [(256, 8), (1024, 17), (256, 60)])
def test_kernels_are_stretched_until_each_resembles_half_the_root_of_them(components, dim):
    states = torch.randn(components, dim)
    silverman = NextStateMarginal(dim, components=components, bandwidth="silverman")
    silverman.replace(states, log_var_of(0.05, components, dim))
    assert silverman.perplexity() < 0.3 * components**0.5
    perplexity = stretched(states).perplexity().item()
    assert perplexity == pytest.approx(0.5 * components**0.5, rel=0.3)


@pytest.mark.parametrize("dim", [8, 60])
def test_a_stretched_mixture_keeps_the_variance_between_silverman_s_and_that_of_states(dim):
    states = torch.randn(256, dim)
    marginal = stretched(states)
    center, width = marginal.component_loc, marginal.component_log_var.exp()
    variance = center.var(0, correction=0) + width.mean(0) - 0.05**2
    silverman = math.exp(2 * silverman_log_bandwidth(256, dim))
    expected = 1 + silverman / math.exp(2 * marginal.log_stretch)
    torch.testing.assert_close(
        variance / states.var(0, correction=0), torch.full((dim,), expected)
    )


@pytest.mark.parametrize("dim", [17, 60])
def test_in_many_dimensions_a_divergence_is_nearly_that_of_the_density_itself(dim):
    state, log_var = torch.randn(256, dim), log_var_of(0.05, 256, dim)
    log_var = log_var + (1 / dim) ** 0.5 * torch.randn(256, 1)  # half of what differs is how sharp
    truth = 0.5 * (state.square() + log_var.exp() - 1 - log_var).sum(-1)
    states = torch.randn(1024, dim)
    nats = stretched(states).kl_upper(gaussian(state, log_var))
    assert (nats - truth).mean().abs() < 0.02 * truth.mean()
    assert nats.std() == pytest.approx(truth.std().item(), rel=0.15)
    assert torch.corrcoef(torch.stack([nats, truth]))[0, 1] > 0.98
    silverman = NextStateMarginal(dim, components=1024, bandwidth="silverman")
    silverman.replace(states, log_var_of(0.05, 1024, dim))
    crude = silverman.kl_upper(gaussian(state, log_var))
    assert torch.corrcoef(torch.stack([crude, truth]))[0, 1] < 0.95


def test_a_stretch_that_is_needed_no_more_goes():
    marginal = stretched(torch.randn(256, 8))
    assert marginal.log_stretch > 0.2
    flat = torch.randn(256, 1) * torch.randn(8)  # on a line all overlap
    for _ in range(40):
        marginal.replace(flat, log_var_of(0.05, 256, 8))
    assert marginal.log_stretch == 0


def test_a_stretch_is_not_lost_with_a_refresh_of_no_number():
    marginal = stretched(torch.randn(256, 8))
    before = marginal.log_stretch.clone()
    marginal.replace(torch.full((256, 8), math.inf), torch.zeros(256, 8))
    assert marginal.log_stretch.equal(before)


def test_less_of_a_divergence_is_the_draw_where_kernels_overlap():
    dim, number = 17, 512
    asked = gaussian(torch.randn(64, dim), log_var_of(0.05, 64, dim))

    def share_of_draw(bandwidth):
        marginal = NextStateMarginal(dim, components=number, bandwidth=bandwidth)
        for _ in range(20):
            marginal.replace(torch.randn(number, dim), log_var_of(0.05, number, dim))
        draws = []
        for _ in range(10):
            marginal.replace(torch.randn(number, dim), log_var_of(0.05, number, dim))
            nats = marginal.kl_upper(asked)
            draws.append(nats - nats.mean())
        nats = torch.stack(draws)
        return (nats.var(0).mean() / nats.var()).item()

    assert share_of_draw("overlap") < 0.3 * share_of_draw("silverman")


def test_a_state_of_before_there_was_a_stretch_is_taken():
    marginal = stretched(torch.randn(64, 8))
    silverman = NextStateMarginal(8, components=64, bandwidth="silverman")
    silverman.replace(torch.randn(64, 8), log_var_of(0.05, 64, 8))
    state = silverman.state_dict()
    del state["log_stretch"]
    marginal.load_state_dict(state)
    assert marginal.log_stretch == 0
    probe = gaussian(*torch.randn(2, 5, 8))
    assert marginal.kl_upper(probe).equal(silverman.kl_upper(probe))


def test_a_marginal_of_another_bandwidth_forgets_the_stretch():
    silverman = NextStateMarginal(8, components=64, bandwidth="silverman")
    silverman.load_state_dict(stretched(torch.randn(64, 8)).state_dict())
    states = torch.randn(64, 8), log_var_of(0.05, 64, 8)
    silverman.replace(*states)
    fresh = NextStateMarginal(8, components=64, bandwidth="silverman")
    fresh.replace(*states)
    probe = gaussian(*torch.randn(2, 5, 8))
    assert silverman.kl_upper(probe).equal(fresh.kl_upper(probe))


@pytest.mark.parametrize("refused", [torch.zeros(4, 2).double(), torch.zeros(4, 2).numpy()])
@pytest.mark.parametrize("name", ["loc", "log_var"])
@pytest.mark.parametrize("call", ["refresh", "replace"])
def test_states_of_another_kind_are_refused_and_lose_nothing(call, name, refused):
    marginal = NextStateMarginal(2, components=4)
    marginal.refresh(*torch.randn(2, 4, 2))
    before = {key: value.clone() for key, value in marginal.state_dict().items()}
    given = {"loc": torch.ones(4, 2), "log_var": torch.ones(4, 2)} | {name: refused}
    with pytest.raises(TypeError, match=rf"`{name}` must be a tensor of torch.float32, got"):
        getattr(marginal, call)(**given)
    assert not marginal.is_empty
    assert all(value.equal(before[key]) for key, value in marginal.state_dict().items())


def test_density_is_that_of_the_widened_mixture():
    marginal = NextStateMarginal(3, components=16)
    marginal.refresh(torch.randn(12, 3), torch.randn(12, 3))
    filled = marginal.log_weight > -math.inf
    assert filled.sum() == 12
    std = (0.5 * marginal.component_log_var[filled]).exp()
    components = Independent(Normal(marginal.loc[filled], std), 1)
    expected = MixtureSameFamily(Categorical(logits=torch.zeros(12)), components)
    value = torch.randn(20, 3)
    torch.testing.assert_close(
        marginal.log_density(value), expected.log_prob(value), atol=1e-4, rtol=1e-5
    )


def test_divergences_are_those_to_the_widened_mixture():
    marginal = NextStateMarginal(2, components=16)
    marginal.refresh(torch.randn(16, 2), torch.randn(16, 2))
    loc, log_var = torch.randn(2, 5, 2)
    mixture = marginal.loc, marginal.component_log_var
    torch.testing.assert_close(
        marginal.kl_upper(gaussian(loc, log_var)), kl_to_mixture_upper(loc, log_var, *mixture)
    )
    torch.testing.assert_close(
        marginal.kl_lower(gaussian(loc, log_var)), kl_to_mixture_lower(loc, log_var, *mixture)
    )


def test_a_bandwidth_closes_the_holes_of_a_mixture_of_spikes():
    spikes, elsewhere = torch.randn(2, 256, 17)
    sharp = log_var_of(0.05, 256, 17)
    prediction = gaussian(elsewhere, sharp)
    with_bandwidth = NextStateMarginal(17)
    with_holes = NextStateMarginal(17, bandwidth=HOLES)
    for marginal in (with_bandwidth, with_holes):
        marginal.refresh(spikes, sharp)
    assert with_bandwidth.kl_upper(prediction).mean() < 100
    assert with_holes.kl_upper(prediction).mean() > 1_000
    gap = with_bandwidth.kl_upper(prediction) - with_bandwidth.kl_lower(prediction)
    assert 0 <= gap.min() and gap.mean() < 2


@pytest.mark.parametrize("target", [2.0, 8.0, 40.0])
@pytest.mark.parametrize("dim", [1, 4])
def test_tuned_bandwidth_hits_its_target_perplexity(target, dim):
    marginal = NextStateMarginal(
        dim, components=128, bandwidth="perplexity", target_perplexity=target
    )
    marginal.refresh(torch.randn(128, dim), log_var_of(1e-3, 128, dim))
    assert marginal.perplexity().item() == pytest.approx(target, rel=0.05)


def test_perplexity_of_components_far_apart_is_one():
    marginal = NextStateMarginal(1, components=8, bandwidth=HOLES)
    loc, log_var = numbered(0, 8)
    marginal.refresh(loc, torch.full_like(log_var, -9.0))
    assert marginal.perplexity().item() == pytest.approx(1, abs=1e-4)


def test_perplexity_of_equal_components_is_their_number():
    marginal = NextStateMarginal(2, components=16)
    marginal.refresh(torch.ones(6, 2), torch.zeros(6, 2))
    assert marginal.perplexity().item() == pytest.approx(6, rel=1e-4)


def test_the_newest_replace_the_oldest():
    marginal = NextStateMarginal(1, components=8)
    marginal.refresh(*numbered(0, 3))
    assert held(marginal) == [0, 1, 2]
    marginal.refresh(*numbered(3, 8))
    assert held(marginal) == list(range(8))
    marginal.refresh(*numbered(8, 11))
    assert held(marginal) == list(range(3, 11))


def test_of_a_batch_larger_than_the_mixture_the_newest_stay():
    marginal = NextStateMarginal(1, components=8)
    marginal.refresh(*numbered(0, 3))
    marginal.refresh(*numbered(3, 23))
    assert held(marginal) == list(range(15, 23))
    marginal.refresh(*numbered(23, 25))
    assert held(marginal) == list(range(17, 25))


def test_components_weigh_alike_and_sum_to_one():
    marginal = NextStateMarginal(1, components=8)
    for stop in (3, 8, 20):
        marginal.refresh(*numbered(0, stop))
        weight = marginal.log_weight.exp()
        assert weight.sum().item() == pytest.approx(1)
        assert weight[weight > 0].unique().numel() == 1


def test_one_prediction_alone_is_the_whole_marginal():
    marginal = NextStateMarginal(2, components=4)
    marginal.refresh(torch.ones(1, 2), torch.zeros(1, 2))
    divergence = marginal.kl_upper(gaussian(torch.ones(1, 2), torch.zeros(1, 2)))
    assert divergence.item() == pytest.approx(0, abs=1e-6)


def test_a_feature_in_which_all_components_agree_gets_no_width():
    marginal = NextStateMarginal(2, components=8)
    loc = torch.stack([torch.randn(8), torch.zeros(8)], dim=-1)
    marginal.refresh(loc, log_var_of(0.1, 8, 2))
    torch.testing.assert_close(marginal.component_log_var[:, 1], log_var_of(0.1, 8))
    assert marginal.kl_upper(gaussian(loc, log_var_of(0.1, 8, 2))).isfinite().all()


def test_it_is_empty_until_it_is_refreshed():
    marginal = NextStateMarginal(1, components=4)
    assert marginal.is_empty
    marginal.refresh(*numbered(0, 1))
    assert not marginal.is_empty


def test_a_stretch_is_in_the_state_dict():
    states = torch.randn(64, 8)
    marginal, copy = stretched(states), stretched(states, refreshes=1)
    copy.load_state_dict(marginal.state_dict())
    for one in (marginal, copy):
        one.replace(states, log_var_of(0.05, 64, 8))
    assert copy.log_stretch.equal(marginal.log_stretch) and marginal.log_stretch > 0.2
    for name in ("component_loc", "component_log_var"):
        assert getattr(copy, name).equal(getattr(marginal, name))


def test_all_state_is_in_the_state_dict():
    marginal, copy = (NextStateMarginal(1, components=8) for _ in range(2))
    marginal.refresh(*numbered(0, 11))
    copy.load_state_dict(marginal.state_dict())
    probe = gaussian(*torch.randn(2, 5, 1))
    assert copy.kl_upper(probe).equal(marginal.kl_upper(probe))
    for one in (marginal, copy):
        one.refresh(*numbered(11, 14))
    assert copy.kl_upper(probe).equal(marginal.kl_upper(probe))
    assert held(copy) == list(range(6, 14))


def test_the_marginal_is_no_part_of_any_gradient():
    marginal = NextStateMarginal(1, components=4)
    loc, log_var = numbered(0, 4)
    marginal.refresh(loc.requires_grad_(), log_var.requires_grad_())
    assert not any(buffer.requires_grad for buffer in marginal.buffers())
    assert list(marginal.parameters()) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("components", 1),
        ("bandwidth", 0.0),
        ("bandwidth", -1.0),
        ("bandwidth", float("nan")),
        ("bandwidth", float("inf")),
    ],
)
def test_what_is_out_of_range_is_rejected_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=rf"`{name}`.*got {value}"):
        NextStateMarginal(2, **{"components": 16} | {name: value})


def test_an_unknown_bandwidth_is_rejected():
    with pytest.raises((ValueError, TypeError), match="bandwidth"):
        NextStateMarginal(2, bandwidth="scott")


@pytest.mark.parametrize("target", [1.0, 16.0])
def test_a_target_that_no_perplexity_can_reach_is_rejected(target):
    with pytest.raises(ValueError, match=rf"`target_perplexity`.*\(16\), got {target}"):
        NextStateMarginal(2, components=16, bandwidth="perplexity", target_perplexity=target)


def test_a_target_that_is_not_read_is_not_checked():
    assert NextStateMarginal(2, components=4, target_perplexity=8.0).is_empty


def linear_marginal(components, dim, signal, noise, **options):
    """A marginal of `x' = x + noise`, and the information that `x` carries about `x'`."""
    marginal = NextStateMarginal(dim, components=components, **options)
    marginal.refresh(signal * torch.randn(components, dim), log_var_of(noise, components, dim))
    return marginal, 0.5 * dim * math.log(1 + (signal / noise) ** 2)


@pytest.mark.parametrize(
    ("components", "dim", "noise", "within"),
    [(200, 1, 0.1, 0.15), (200, 2, 0.3, 0.2), (8, 1, 0.3, 0.6)],
)
def test_information_lies_between_its_estimates_on_average(components, dim, noise, within):
    pairs = [linear_marginal(components, dim, 1.0, noise) for _ in range(100)]
    estimates = [marginal.information(torch.randn(4, components, dim)) for marginal, _ in pairs]
    lower, upper = (torch.stack(values).mean() for values in zip(*estimates, strict=True))
    truth = pairs[0][1]
    assert truth - within < lower < truth - 0.01 < truth + 0.01 < upper < truth + within


def test_own_component_limits_the_lower_estimate_to_the_log_of_their_number():
    marginal, truth = linear_marginal(64, 10, 1.0, 0.01)
    lower, upper = marginal.information(torch.randn(2, 64, 10))
    assert lower.item() == pytest.approx(math.log(64), abs=1e-4) and lower < truth < upper


def test_equal_components_carry_no_information():
    marginal = NextStateMarginal(2, components=16)
    marginal.refresh(torch.ones(16, 2), torch.zeros(16, 2))
    lower, upper = marginal.information(torch.randn(3, 16, 2))
    torch.testing.assert_close(torch.stack([lower, upper]), torch.zeros(2), atol=1e-5, rtol=0)


def test_information_is_that_of_the_components_that_are_filled():
    part, whole = NextStateMarginal(2, components=50), NextStateMarginal(2, components=20)
    loc, log_var = torch.randn(2, 20, 2)
    noise = torch.randn(3, 50, 2)
    for marginal in (part, whole):
        marginal.refresh(loc, log_var)
    torch.testing.assert_close(part.information(noise), whole.information(noise[:, :20]))


def test_one_component_has_nothing_to_be_distinguished_from():
    marginal = NextStateMarginal(1, components=4)
    marginal.refresh(*numbered(0, 1))
    lower, upper = marginal.information(torch.randn(2, 4, 1))
    assert lower.item() == pytest.approx(0, abs=1e-6) and upper == math.inf


@pytest.mark.parametrize("change", ["refresh", "replace"])
@pytest.mark.parametrize(
    ("loc", "log_var", "message"),
    [
        ((5, 1), (5, 1), r"`loc` must have shape \(batch, 2\), got \(5, 1\)"),
        ((2,), (2,), r"`loc` must have shape \(batch, 2\), got \(2,\)"),
        ((0, 2), (0, 2), r"`loc` must have shape \(batch, 2\), got \(0, 2\)"),
        ((5, 2), (5, 1), r"`log_var` must have shape \(5, 2\), as `loc` has, got \(5, 1\)"),
        ((5, 2), (1, 2), r"`log_var` must have shape \(5, 2\), as `loc` has, got \(1, 2\)"),
    ],
)
def test_states_that_would_be_spread_over_the_components_are_rejected(
    change, loc, log_var, message
):
    jaxtyping.config.update("jaxtyping_disable", True)  # as for a user, whom nothing else tells
    marginal = NextStateMarginal(2, components=8)
    with pytest.raises(ValueError, match=message):
        getattr(marginal, change)(torch.zeros(loc), torch.zeros(log_var))
    assert marginal.is_empty and not marginal.loc.isnan().any()
