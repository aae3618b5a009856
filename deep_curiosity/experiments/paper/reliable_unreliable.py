"""Second illustration: the far-sighted agent, and the information it maximises."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from deep_curiosity.experiments.paper.figures import BLUE, GREY, ORANGE, open_figure
from deep_curiosity.experiments.paper.tables import settled, stationary_bits, write_table
from deep_curiosity.tabular.environments import STAY, FiniteMDP, reliable_unreliable
from deep_curiosity.tabular.information import predictive_information, to_bits, to_nats
from deep_curiosity.tabular.markov import stationary_distribution
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import solve_stationary

TEMPERATURES = (to_nats(0.1), 0.5, 2.0)  # nats; the page shows the first
CURIOSITY_DISCOUNTS = (0.0, 0.5, 0.9, 0.99, 0.999, 1.0)
LABEL_SHIFTS = {0.0: 0, 0.5: -9, 0.9: -4, 1.0: 9}  # points to the right, of the labelled discounts


class FarSightedRow(NamedTuple):
    """Solution at one temperature and one curiosity discount."""

    lambda_nats: float
    curiosity_discount: float
    pi_stay_given_0: float
    p_state_is_0: float
    bits: float


def write_reliable_unreliable(
    folder: Path, seed: int, *, num_discounts: int = 41
) -> list[FarSightedRow]:
    """Writes the table and the figure; returns the rows of the first temperature.

    Args:
        folder: Existing folder of the files.
        seed: Seed of the random initial policies.
        num_discounts: Number of points of the curve against the curiosity discount.
    """
    mdp, rng = reliable_unreliable(), np.random.default_rng(seed)
    rows = [
        solve_far_sighted(mdp, temperature, discount, rng)
        for temperature in TEMPERATURES
        for discount in CURIOSITY_DISCOUNTS
    ]
    write_table(folder / "reliable_unreliable.csv", FarSightedRow._fields, rows)
    shown = rows[: len(CURIOSITY_DISCOUNTS)]
    with open_figure(folder / "reliable_unreliable.png", 9.0, 3.7) as figure:
        left, right = figure.subplots(1, 2)
        plot_information(left, mdp, shown)
        plot_horizon(right, mdp, np.linspace(0, 1, num_discounts))
    return shown


def solve_far_sighted(
    mdp: FiniteMDP, temperature: float, curiosity_discount: float, rng: np.random.Generator
) -> FarSightedRow:
    """Row of the solution from a random initial policy."""
    solution = solve_stationary(
        mdp,
        random_log_policy(2, 2, rng),
        temperature=temperature,
        curiosity_discount=curiosity_discount,
    )
    policy = settled(solution)
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    bits = stationary_bits(mdp, policy)
    stay = policy[0, STAY]
    return FarSightedRow(temperature, curiosity_discount, stay, float(states[0]), bits)


def plot_information(axis: Axes, mdp: FiniteMDP, rows: Sequence[FarSightedRow]) -> None:
    """Plots information against pi(STAY | 0), with the solution of each curiosity discount."""
    stay = np.linspace(0, 1, 401)
    policies = [np.array([[share, 1 - share], [0.5, 0.5]]) for share in stay]
    own = [stationary_bits(mdp, policy) for policy in policies]
    held = [to_bits(predictive_information(mdp.transition, p, mdp.start)) for p in policies]
    axis.plot(stay, own, color=BLUE, label="in the policy's own stationary states")
    axis.plot(stay, held, color=GREY, ls="--", label="with p(X = 0) held at one half")
    labelled = [row for row in rows if row.curiosity_discount in LABEL_SHIFTS]
    for row in labelled:
        place = (row.pi_stay_given_0, row.bits)
        axis.annotate(
            f"{row.curiosity_discount:g}",
            place,
            (LABEL_SHIFTS[row.curiosity_discount], 8),
            textcoords="offset points",
            ha="center",
            color=ORANGE,
        )
    places = [(row.pi_stay_given_0, row.bits) for row in labelled]
    axis.plot(
        *zip(*places, strict=True),
        "o",
        color=ORANGE,
        ms=5,
        label="solution, by curiosity_discount",
    )
    axis.set(xlabel=r"probability $\pi(\mathrm{STAY}\,|\,0)$", ylim=(0, 0.68))
    axis.set_ylabel(r"$I(\{X, A\}; X')$ in bits")
    axis.set_title("Solution of each curiosity_discount")
    axis.legend(frameon=False, loc="lower center", fontsize=8)


def plot_horizon(axis: Axes, mdp: FiniteMDP, discounts: np.ndarray) -> None:
    """Plots pi(STAY | 0) against the curiosity discount."""
    solutions = [
        solve_stationary(mdp, temperature=0.5, curiosity_discount=float(d), tolerance=1e-8)
        for d in discounts
    ]
    axis.plot(discounts, [solution.policy[0, STAY] for solution in solutions], color=BLUE)
    axis.axhline(0.75, color=ORANGE, lw=1, ls="--")
    axis.text(0.02, 0.755, "the paper's text: 3/4", color=ORANGE, va="bottom")
    axis.axhline(0.5, color=GREY, lw=1, ls="--")
    axis.text(0.98, 0.495, "the paper's equations: 1/2", color=GREY, va="top", ha="right")
    axis.set(xlabel="curiosity_discount", ylim=(0.45, 0.8))
    axis.set_ylabel(r"probability $\pi(\mathrm{STAY}\,|\,0)$")
    axis.set_title("A longer horizon moves 1/2 to 3/4")
