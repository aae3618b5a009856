"""Errors of the estimates from samples, against the number of samples."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from deep_curiosity.experiments.paper.figures import open_figure
from deep_curiosity.experiments.paper.tables import settled, write_table
from deep_curiosity.tabular.agent import FixedPolicy, run
from deep_curiosity.tabular.environments import FiniteMDP, random_mdp
from deep_curiosity.tabular.estimators import CountedModel, Experience, QLearning, Sarsa
from deep_curiosity.tabular.markov import (
    action_values,
    optimal_action_values,
    stationary_distribution,
)
from deep_curiosity.tabular.solvers import solve_stationary

NUM_RUNS = 6
FIRST_SIZE, NUM_SIZES = 100, 9  # samples, and points of the curves
FIRST_FITTED_SIZE = 1_000  # samples from which on the slopes are fitted
LABELS = ("p_t(x) from visits", "model", "curious policy", "Q by SARSA", "Q by Q-learning")


class Quantities(NamedTuple):
    """Everything that is estimated from samples, exact or estimated; also errors and slopes."""

    visits: np.ndarray | float
    model: np.ndarray | float
    policy: np.ndarray | float
    sarsa: np.ndarray | float
    q_learning: np.ndarray | float


class Estimates:
    """Estimates of all quantities from one sequence of transitions.

    Args:
        mdp: The environment.
    """

    def __init__(self, mdp: FiniteMDP) -> None:
        self.mdp = mdp
        self.model = CountedModel(mdp.num_states, mdp.num_actions)
        self.sarsa = Sarsa(mdp.num_states, mdp.num_actions, mdp.discount)
        self.q_learning = QLearning(mdp.num_states, mdp.num_actions, mdp.discount)
        self.visits = np.zeros(mdp.num_states)

    def observe(self, experience: Experience) -> None:
        """Learns from one transition."""
        for learner in (self.model, self.sarsa, self.q_learning):
            learner.observe(experience)
        self.visits[experience.state] += 1

    def quantities(self) -> Quantities:
        """The current estimates."""
        model = self.model
        learned = FiniteMDP(model.transition, model.reward, self.mdp.start, self.mdp.discount)
        return Quantities(
            visits=self.visits / self.visits.sum(),
            model=model.transition,
            policy=solve_policy(learned, tolerance=1e-6),
            sarsa=self.sarsa.action_value,
            q_learning=self.q_learning.action_value,
        )


def write_samples(folder: Path, seed: int, *, num_samples: int = 30_000) -> Quantities:
    """Writes the table and the figure; returns the slope of every error in log-log.

    Args:
        folder: Existing folder of the files.
        seed: Seed of the random environment and of the first run.
        num_samples: Number of samples at the end of the curves.
    """
    sizes = np.unique(np.geomspace(FIRST_SIZE, num_samples, NUM_SIZES).astype(int))
    mdp = random_mdp(6, 3, np.random.default_rng(seed), discount=0.5)
    runs = [measure_errors(mdp, sizes, seed + index) for index in range(NUM_RUNS)]
    errors = np.mean(runs, axis=0)
    rows = [(int(size), *map(float, row)) for size, row in zip(sizes, errors, strict=True)]
    write_table(folder / "samples.csv", ("samples", *Quantities._fields), rows)
    slopes = Quantities(*(fit_slope(sizes, error) for error in errors.T))
    with open_figure(folder / "samples.png", 7.8, 4.0) as figure:
        plot_errors(figure, sizes, errors, slopes)
    return slopes


def solve_policy(mdp: FiniteMDP, tolerance: float) -> np.ndarray:
    """The curious policy whose estimate is measured."""
    return settled(solve_stationary(mdp, temperature=1.0, hunger=1.0, tolerance=tolerance))


def exact_quantities(mdp: FiniteMDP, policy: np.ndarray) -> Quantities:
    """Limits of the estimates under the policy that samples."""
    return Quantities(
        visits=stationary_distribution(mdp.transition, policy, mdp.start),
        model=mdp.transition,
        policy=solve_policy(mdp, tolerance=1e-8),
        sarsa=action_values(mdp.transition, mdp.reward, policy, mdp.discount),
        q_learning=optimal_action_values(mdp.transition, mdp.reward, mdp.discount),
    )


def measure_errors(mdp: FiniteMDP, sizes: np.ndarray, seed: int) -> np.ndarray:
    """Root mean square errors of one run, one row for each number of samples."""
    uniform = np.full(mdp.reward.shape, 1 / mdp.num_actions)
    exact, estimates, rows = exact_quantities(mdp, uniform), Estimates(mdp), []
    history = run(FixedPolicy(uniform), mdp, int(sizes[-1]), np.random.default_rng(seed))
    for step, experience in enumerate(history, start=1):
        estimates.observe(experience)
        if step in sizes:
            pairs = zip(estimates.quantities(), exact, strict=True)
            rows.append([float(np.sqrt(np.mean((a - b) ** 2))) for a, b in pairs])
    return np.array(rows)


def fit_slope(sizes: np.ndarray, error: np.ndarray) -> float:
    """Slope of an error in log-log, from `FIRST_FITTED_SIZE` samples on."""
    tail = sizes >= FIRST_FITTED_SIZE
    return float(np.polyfit(np.log(sizes[tail]), np.log(error[tail]), 1)[0])


def plot_errors(figure: Figure, sizes: np.ndarray, errors: np.ndarray, slopes: Quantities) -> None:
    """Plots every error, with a guide of slope -1/2 and the legend beside the axes."""
    axis = figure.subplots()
    for label, slope, error in zip(LABELS, slopes, errors.T, strict=True):
        axis.loglog(sizes, error, "o-", ms=3, lw=1.2, label=f"{label}: slope {slope:.2f}")
    guide = errors[0].max() * (sizes / sizes[0]) ** -0.5
    axis.loglog(sizes, guide, color="black", lw=0.8, ls=":", label="guide: slope -1/2")
    axis.set(xlabel="number of samples (environment steps)", ylabel="root mean square error")
    axis.set_title("Errors of the estimates, random environment of 6 states")
    figure.legend(frameon=False, loc="outside right center", fontsize=8)
