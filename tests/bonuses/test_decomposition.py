import math

import jaxtyping
import pytest
import torch

from deep_curiosity.bonuses.decomposition import (
    DIVERGENCE,
    coefficients_of,
    information_gain,
)
from deep_curiosity.gaussians import DiagonalMixture


def predictions(*loc, std=1.0, components=1):
    """One pair; every member predicts its own places, with one width."""
    places = torch.tensor(loc).view(len(loc), 1, components, 1)
    weight = torch.full(places.shape[:-1], -math.log(components))
    return DiagonalMixture(places, torch.full_like(places, 2 * math.log(std)), weight)


def test_nothing_named_is_the_divergence_and_so_are_both_its_pairs():
    assert coefficients_of(None) == DIVERGENCE
    assert coefficients_of({"predictive_power": 1.0, "information_gain": 1.0}) == DIVERGENCE
    assert coefficients_of({"cross_entropy": 1.0, "negative_entropy": 1.0}) == DIVERGENCE


def test_weights_add_up_by_hand():
    coefficients = coefficients_of({"predictive_power": 2.0, "information_gain": 0.5})
    assert coefficients == (2.0, -1.5, 0.0)
    assert coefficients_of({"cross_entropy": 3.0, "negative_entropy": 1.0}) == (3.0, 0.0, 2.0)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({}, "`parts` must name at least one of predictive_power, .*got {}"),
        ({"surprise": 1.0}, "`parts` must be named predictive_power, .*got 'surprise'"),
        ({"cross_entropy": math.nan}, "`parts` must have finite weights, got nan for 'cross_ent"),
        ({"predictive_power": 0.0}, "`parts` must leave something"),
    ],
)
def test_parts_that_mean_nothing_are_rejected(parts, message):
    with pytest.raises(ValueError, match=message):
        coefficients_of(parts)


def test_a_weight_of_a_part_must_be_a_number():
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match=r"`parts\['cross_entropy'\]` must be an int or a float"):
        coefficients_of({"cross_entropy": "1"})


def test_entropy_of_components_far_apart_is_one_bit_more():
    wide = predictions((-50.0, 50.0), (0.0, 0.0), components=2)
    bits = (wide.entropy() - 0.5 * math.log(2 * math.pi * math.e)) / math.log(2)
    torch.testing.assert_close(bits, torch.tensor([[1.0], [0.0]]), atol=1e-5, rtol=0)


def test_members_that_agree_gain_nothing():
    torch.testing.assert_close(information_gain(predictions(1.0, 1.0, 1.0)), torch.zeros(1))
    alike = predictions((-3.0, 3.0), (-3.0, 3.0), components=2)
    torch.testing.assert_close(information_gain(alike), torch.zeros(1))


def test_members_far_apart_gain_the_log_of_their_number():
    gain = information_gain(predictions(-90.0, 0.0, 90.0))
    torch.testing.assert_close(gain, torch.tensor([math.log(3)]))
    apart = predictions((-90.0, -60.0), (60.0, 90.0), components=2)
    torch.testing.assert_close(information_gain(apart), torch.tensor([math.log(2)]))


def test_information_gain_is_below_that_of_quadrature_and_not_far():
    prediction = predictions(-1.0, 0.5, 1.5)
    grid = torch.linspace(-12, 12, 4_001)
    density = torch.distributions.Normal(prediction.loc.view(3, 1), 1.0).log_prob(grid).exp()
    mean = density.mean(0)
    entropy = torch.trapezoid(torch.special.entr(mean), grid)
    exact = entropy - 0.5 * math.log(2 * math.pi * math.e)
    assert 0.6 * exact < information_gain(prediction).item() < exact
