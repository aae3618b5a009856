"""The dual problem (10): the rate-return curve of a random environment."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from deep_curiosity.experiments.paper.figures import BLUE, GREY, ORANGE, open_figure
from deep_curiosity.experiments.paper.tables import write_table
from deep_curiosity.tabular.environments import random_mdp
from deep_curiosity.tabular.information import action_information, to_bits, to_nats
from deep_curiosity.tabular.markov import (
    expected_return,
    optimal_action_values,
    stationary_distribution,
)
from deep_curiosity.tabular.policies import boltzmann
from deep_curiosity.tabular.rate_return import RatePoint, largest_return, rate_return_curve

HEADER = ("lambda", "rate_bits", "expected_return")
RATE = 0.5  # bits, of the point that the page describes


class RateReturnSummary(NamedTuple):
    """Numbers of the page.

    Args:
        value: Largest expected return at `RATE`.
        temperature: Slope of the curve there, return per nat.
        constant: Expected return of the best constant action.
        best: Expected return of the best policy.
        best_rate: Rate of the coldest policy of the curve, in bits.
    """

    value: float
    temperature: float
    constant: float
    best: float
    best_rate: float


def write_rate_return(folder: Path, seed: int, *, num_temperatures: int = 60) -> RateReturnSummary:
    """Writes the table and the figure.

    Args:
        folder: Existing folder of the files.
        seed: Seed of the random environment.
        num_temperatures: Number of points of the curve.
    """
    mdp = random_mdp(8, 4, np.random.default_rng(seed))
    action_value = optimal_action_values(mdp.transition, mdp.reward, mdp.discount)
    uniform = np.full(mdp.reward.shape, 1 / mdp.num_actions)
    states = stationary_distribution(mdp.transition, uniform, mdp.start)
    temperatures = np.geomspace(0.5, 0.005, num_temperatures) * np.ptp(action_value)
    curve = rate_return_curve(action_value, states, temperatures)
    rows = [(point.temperature, to_bits(point.rate), point.value) for point in curve]
    write_table(folder / "rate_return.csv", HEADER, rows)
    half = largest_return(action_value, states, to_nats(RATE))
    for point in (*curve, half):
        if not point.converged:
            raise RuntimeError(f"A point must have converged, got one at {point.temperature}.")
    softmax = boltzmann_curve(action_value, states, temperatures)
    with open_figure(folder / "rate_return.png", 5.6, 3.8) as figure:
        plot_curves(figure.subplots(), np.array(rows)[:, 1:], softmax, half)
    return RateReturnSummary(
        value=half.value,
        temperature=half.temperature,
        constant=float((states @ action_value).max()),
        best=float(states @ action_value.max(1)),
        best_rate=rows[-1][1],
    )


def boltzmann_curve(
    action_value: np.ndarray, states: np.ndarray, temperatures: np.ndarray
) -> np.ndarray:
    """Rates in bits and expected returns of plain softmax policies, one row each."""
    policies = [np.exp(boltzmann(action_value, t)) for t in temperatures]
    return np.array(
        [
            (
                to_bits(action_information(policy, states)),
                expected_return(states, policy, action_value),
            )
            for policy in policies
        ]
    )


def plot_curves(axis: Axes, curve: np.ndarray, softmax: np.ndarray, half: RatePoint) -> None:
    """Plots both curves, and the tangent at the point of the dual."""
    axis.plot(*curve.T, color=BLUE, label="largest return for the rate (13)")
    axis.plot(*softmax.T, color=GREY, ls="--", label="plain Boltzmann exploration")
    reach = to_bits(half.rate) + np.array([-0.2, 0.4])
    tangent = half.value + half.temperature * (to_nats(1.0) * reach - half.rate)
    axis.plot(reach, tangent, color=ORANGE, lw=1, label=r"tangent: slope $\lambda$ per nat")
    axis.plot(to_bits(half.rate), half.value, "o", color=ORANGE, label="dual (10) at 1/2 bit")
    axis.set(xlabel="I(A; X) in bits", ylabel="expected return (discounted reward)")
    axis.set_title("Rate and return, random environment of 8 states")
    axis.legend(frameon=False, loc="lower right")
