import numpy as np
import pytest

from deep_curiosity.experiments.paper.samples import (
    Quantities,
    exact_quantities,
    fit_slope,
    measure_errors,
)
from deep_curiosity.tabular.environments import random_mdp

MDP = random_mdp(3, 2, np.random.default_rng(1), discount=0.5)


def test_slope_of_a_power_is_its_exponent_and_ignores_small_sizes():
    sizes = np.array([100, 1_000, 3_000, 10_000])
    error = np.array([7.0, *sizes[1:] ** -0.5])
    assert fit_slope(sizes, error) == pytest.approx(-0.5)


def test_exact_states_and_values_are_those_of_the_sampling_policy():
    exact = exact_quantities(MDP, np.full((3, 2), 0.5))
    assert exact.visits @ MDP.transition.mean(1) == pytest.approx(exact.visits)
    backup = MDP.reward + 0.5 * MDP.transition @ exact.sarsa.mean(1)
    np.testing.assert_allclose(exact.sarsa, backup)
    assert (exact.q_learning > exact.sarsa).all()


def test_every_error_falls_with_the_number_of_samples():
    errors = measure_errors(MDP, np.array([30, 3_000]), seed=0)
    assert errors.shape == (2, len(Quantities._fields))
    assert (errors[1] < errors[0]).all()
