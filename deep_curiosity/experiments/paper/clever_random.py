"""First illustration: the solutions of the damped iteration, and the undamped two-cycle."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from deep_curiosity.experiments.paper.figures import BLUE, GREY, ORANGE, open_figure
from deep_curiosity.experiments.paper.tables import settled, stationary_bits, write_table
from deep_curiosity.tabular.environments import FiniteMDP, clever_random
from deep_curiosity.tabular.information import (
    log_next_state_marginal,
    predictive_information,
    to_bits,
)
from deep_curiosity.tabular.iteration import damp, safe_damping
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import curious_score, curious_step, solve_stationary

TEMPERATURES = (0.05, 0.3, 1.5)  # nats
SHOWN_TEMPERATURE = 0.3  # nats; of the policies and of the iterations in the figure
SETTINGS = ((0.3, 1.0), (0.9, 1.0), (1.1, 1.0), (0.3, safe_damping(0.3)))  # nats and damping
NUM_UPDATES = 100
NUM_SHOWN_UPDATES = 30


class SolutionRow(NamedTuple):
    """Solution of the damped iteration from one random initial policy."""

    lambda_nats: float
    start: int
    pi_stay_given_0: float
    mass_on_0_and_1: float
    bits: float


class UpdateRow(NamedTuple):
    """Policy after one update, and the information it carries and is reported to carry."""

    lambda_nats: float
    damping: float
    update: int
    p_next_is_0: float
    bits_carried: float
    bits_reported: float


class CleverRandomSummary(NamedTuple):
    """Numbers of the page.

    Args:
        shortfall: Largest difference of a solution's information from one bit.
        least_split: Smallest pi(STAY | 0) of all solutions.
        largest_split: Largest pi(STAY | 0) of all solutions.
        least_mass: Smallest probability that a solution gives to STAY and FLIP together.
        bits_carried: Information of the tenth policy of the undamped iteration.
        bits_reported: Information that this iteration reports for it.
    """

    shortfall: float
    least_split: float
    largest_split: float
    least_mass: float
    bits_carried: float
    bits_reported: float


def write_clever_random(folder: Path, seed: int, *, num_starts: int = 25) -> CleverRandomSummary:
    """Writes both tables and the figure.

    Args:
        folder: Existing folder of the files.
        seed: Seed of the random initial policies.
        num_starts: Number of initial policies at each temperature.
    """
    mdp, rng = clever_random(), np.random.default_rng(seed)
    starts = [random_log_policy(2, mdp.num_actions, rng) for _ in range(num_starts)]
    policies = {t: solve_from(mdp, starts, t) for t in TEMPERATURES}
    solutions = [row for t in TEMPERATURES for row in describe_solutions(mdp, policies[t], t)]
    updates = [row for setting in SETTINGS for row in trace_updates(mdp, starts[0], *setting)]
    write_table(folder / "clever_random.csv", SolutionRow._fields, solutions)
    write_table(folder / "clever_random_courses.csv", UpdateRow._fields, updates)
    with open_figure(folder / "clever_random.png", 11.5, 3.6) as figure:
        left, middle, right = figure.subplots(1, 3)
        plot_policies(left, np.exp(starts[0][0]), policies[SHOWN_TEMPERATURE][:2])
        plot_splits(middle, solutions)
        plot_updates(right, updates)
    return summarize(solutions, updates)


def solve_from(
    mdp: FiniteMDP, starts: Sequence[np.ndarray], temperature: float
) -> list[np.ndarray]:
    """Solutions of the damped iteration, one for each initial log policy."""
    return [
        settled(solve_stationary(mdp, start, temperature=temperature, tolerance=1e-8))
        for start in starts
    ]


def describe_solutions(
    mdp: FiniteMDP, policies: Sequence[np.ndarray], temperature: float
) -> list[SolutionRow]:
    """Rows of the table of solutions at one temperature."""
    rows = []
    for start, policy in enumerate(policies):
        mass = policy[:, [0, -1]].sum(1).min()
        bits = stationary_bits(mdp, policy)
        rows.append(SolutionRow(temperature, start, policy[0, 0], mass, bits))
    return rows


def trace_updates(
    mdp: FiniteMDP, log_policy: np.ndarray, temperature: float, damping: float
) -> list[UpdateRow]:
    """Rows of the iteration (23)-(25), damped, or as written with a damping of 1.

    The reported information combines the new policy with the divergence from the next-state
    marginal of the previous policy.
    """
    rows, no_value = [], np.zeros(mdp.reward.shape)
    for update in range(1, NUM_UPDATES + 1):
        divergence = curious_score(mdp.transition, log_policy, mdp.start)
        target, _ = curious_step(mdp.transition, log_policy, mdp.start, no_value, temperature)
        log_policy = damp(log_policy, target, damping)
        policy = np.exp(log_policy)
        marginal = np.exp(log_next_state_marginal(mdp.transition, log_policy, mdp.start))
        carried = max(0.0, to_bits(predictive_information(mdp.transition, policy, mdp.start)))
        reported = to_bits(float(mdp.start @ (policy * divergence).sum(1)))
        rows.append(UpdateRow(temperature, damping, update, float(marginal[0]), carried, reported))
    return rows


def select_updates(rows: Sequence[UpdateRow], damping: float) -> list[UpdateRow]:
    """Rows of one iteration at the temperature of the figure."""
    return [row for row in rows if row[:2] == (SHOWN_TEMPERATURE, damping)]


def summarize(
    solutions: Sequence[SolutionRow], updates: Sequence[UpdateRow]
) -> CleverRandomSummary:
    """Numbers of the page, from the rows of both tables."""
    splits = [row.pi_stay_given_0 for row in solutions]
    tenth = select_updates(updates, 1.0)[9]
    return CleverRandomSummary(
        shortfall=1 - min(row.bits for row in solutions),
        least_split=min(splits),
        largest_split=max(splits),
        least_mass=min(row.mass_on_0_and_1 for row in solutions),
        bits_carried=tenth.bits_carried,
        bits_reported=tenth.bits_reported,
    )


def plot_policies(axis: Axes, start: np.ndarray, policies: Sequence[np.ndarray]) -> None:
    """Plots an initial policy in state 0, its solution, and a solution from another policy."""
    action = np.linspace(0, 1, len(start))
    axis.plot(action, start, color=GREY, lw=1, label="random initial policy")
    labels = ("its solution", "solution from another initial policy")
    for policy, color, label, shift in zip(
        policies, (BLUE, ORANGE), labels, (0, 0.012), strict=True
    ):
        ends = action[[0, -1]] + shift
        axis.vlines(ends, 0, policy[0, [0, -1]], color=color, lw=4, label=label)
    axis.set(xlabel="action a = probability to flip", ylim=(0, 1))
    axis.set_ylabel(r"probability $\pi(a\,|\,0)$")
    axis.set_title("Only STAY (0) and FLIP (1) remain")
    axis.legend(frameon=False, loc="upper center", fontsize=8)


def plot_splits(axis: Axes, rows: Sequence[SolutionRow]) -> None:
    """Plots pi(STAY | 0) of every solution, by temperature."""
    rng = np.random.default_rng(0)
    for place, temperature in enumerate(TEMPERATURES):
        chosen = [row for row in rows if row.lambda_nats == temperature]
        jitter = place + rng.uniform(-0.15, 0.15, len(chosen))
        axis.plot(
            jitter, [row.pi_stay_given_0 for row in chosen], "o", ms=4, color=BLUE, alpha=0.7
        )
        least = min(row.bits for row in chosen)
        axis.text(place, 1.04, f"{least:.3f} bit each", ha="center", fontsize=8, color=GREY)
    axis.set_xticks(range(len(TEMPERATURES)), [f"{t:g}" for t in TEMPERATURES])
    axis.axhline(0.5, color=ORANGE, lw=1.2)
    axis.text(-0.88, 0.51, "limit (22)", color=ORANGE, va="bottom", fontsize=8)
    axis.set(xlabel=r"$\lambda$ in nats", ylim=(0, 1.12), xlim=(-0.9, 2.5))
    axis.set_ylabel(r"probability $\pi(\mathrm{STAY}\,|\,0)$")
    axis.set_title("(21): every split is a fixed point")


def plot_updates(axis: Axes, rows: Sequence[UpdateRow]) -> None:
    """Plots the next-state marginal during the undamped and the damped iteration."""
    for label, damping, color in (
        ("as written", 1.0, ORANGE),
        ("damped", safe_damping(SHOWN_TEMPERATURE), BLUE),
    ):
        chosen = select_updates(rows, damping)[:NUM_SHOWN_UPDATES]
        update, marginal = [row.update for row in chosen], [row.p_next_is_0 for row in chosen]
        axis.plot(update, marginal, "o-", ms=2.5, lw=1, color=color, label=label)
    axis.set(xlabel="number of updates", ylim=(-0.03, 1.25), yticks=(0, 0.5, 1))
    axis.set_ylabel("probability p(X' = 0)")
    axis.set_title(rf"(23)-(25) as written cycle, $\lambda$ = {SHOWN_TEMPERATURE:g} nats")
    axis.legend(frameon=False, loc="upper right", ncol=2, fontsize=8)
