"""The related methods that the paper names, compared in four environments."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from deep_curiosity.experiments.paper.figures import BLUE, GREY, open_figure
from deep_curiosity.experiments.paper.tables import stationary_bits, write_table
from deep_curiosity.tabular.agent import run
from deep_curiosity.tabular.environments import (
    FiniteMDP,
    chain,
    clever_random,
    grid_world,
    reliable_unreliable,
)
from deep_curiosity.tabular.information import (
    action_information,
    state_predictive_information,
    to_bits,
)
from deep_curiosity.tabular.iteration import Solution
from deep_curiosity.tabular.markov import expected_return, stationary_distribution
from deep_curiosity.tabular.neighbours import (
    EpsilonGreedy,
    PredictionErrorCuriosity,
    RMax,
    dynamic_policy_programming,
    information_to_go,
    predictive_states,
)
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import solve_stationary


class NeighbourRow(NamedTuple):
    """Information and reward per step of one method in one environment.

    Args:
        environment: Where.
        method: By which the policy was found.
        bits_state_and_action: Predictive information I({X, A}; X') of the policy.
        bits_state_alone: I(X; X') of the policy.
        bits_cost: I(A; X) of the policy.
        pay: Reward per step.
        converged: Whether the iteration that found the policy did; `None` where it was learned.
    """

    environment: str
    method: str
    bits_state_and_action: float
    bits_state_alone: float
    bits_cost: float
    pay: float
    converged: bool | None


def write_neighbours(folder: Path, seed: int, *, num_steps: int = 5_000) -> list[NeighbourRow]:
    """Writes the table and the figure.

    Args:
        folder: Existing folder of the files.
        seed: Seed of the learners and of the random initial policy.
        num_steps: Number of steps for which the learners learn.
    """
    environments = {
        "clever random": clever_random(11),
        "reliable / unreliable": reliable_unreliable(),
        "grid 4 x 4": grid_world(),
        "chain of 8": chain(8),
    }
    rows = [
        measure(environment, method, mdp, *found)
        for environment, mdp in environments.items()
        for method, found in solve_all(mdp, seed, num_steps).items()
    ]
    write_table(folder / "neighbours.csv", NeighbourRow._fields, rows)
    with open_figure(folder / "neighbours.png", 12.0, 4.0) as figure:
        axes = figure.subplots(1, len(environments), sharey=True)
        for axis, environment in zip(axes, environments, strict=True):
            plot_environment(axis, [row for row in rows if row.environment == environment])
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", frameon=False, ncol=2)
    return rows


def measure(
    environment: str,
    method: str,
    mdp: FiniteMDP,
    policy: np.ndarray,
    converged: bool | None = None,
) -> NeighbourRow:
    """Row of one policy, in its stationary states."""
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    alone = to_bits(state_predictive_information(mdp.transition, policy, states))
    return NeighbourRow(
        environment,
        method,
        bits_state_and_action=max(0.0, stationary_bits(mdp, policy)),
        bits_state_alone=max(0.0, alone),
        bits_cost=max(0.0, to_bits(action_information(policy, states))),
        pay=expected_return(states, policy, mdp.reward),
        converged=converged,
    )


def solve_all(
    mdp: FiniteMDP, seed: int, num_steps: int
) -> dict[str, tuple[np.ndarray, bool | None]]:
    """The final policy of each method, and whether it converged, where it was planned."""
    rng = np.random.default_rng(seed)
    learned = learn_policies(mdp, num_steps, rng)
    start = random_log_policy(mdp.num_states, mdp.num_actions, rng)
    planned = plan_policies(mdp, start)
    return {name: (policy, None) for name, policy in learned.items()} | {
        name: (solution.policy, solution.converged) for name, solution in planned.items()
    }


def learn_policies(
    mdp: FiniteMDP, num_steps: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Final policies of the methods that learn from samples."""
    shape = mdp.reward.shape
    learners: dict[str, EpsilonGreedy | RMax] = {
        "epsilon-greedy": EpsilonGreedy(*shape, discount=mdp.discount),
        "R-MAX": RMax(*shape, discount=mdp.discount, largest_reward=1.0),
        "prediction error": PredictionErrorCuriosity(*shape, discount=mdp.discount),
    }
    for learner in learners.values():
        run(learner, mdp, num_steps, rng)
    return {name: learner.policy for name, learner in learners.items()}


def plan_policies(mdp: FiniteMDP, start: np.ndarray) -> dict[str, Solution]:
    """Solutions of the methods that know the environment, from an initial log policy."""
    uniform = np.full(mdp.num_states, 1 / mdp.num_states)
    solve = partial(solve_stationary, mdp, start, temperature=0.3, tolerance=1e-7)
    return {
        "information to go": information_to_go(mdp, uniform, reward_weight=10.0),
        "dynamic policy progr.": dynamic_policy_programming(mdp, temperature=1.0),
        "predictive states": predictive_states(mdp, start, curiosity_discount=0.9),
        "curious": solve(),
        "curious, far-sighted": solve(curiosity_discount=0.95),
        "curious and hungry": solve(hunger=10.0),
    }


def plot_environment(axis: Axes, rows: Sequence[NeighbourRow]) -> None:
    """Plots the information of every method, with the reward per step in a column beside it."""
    rows = rows[::-1]
    place = np.arange(len(rows))
    both = [row.bits_state_and_action for row in rows]
    alone = [row.bits_state_alone for row in rows]
    axis.barh(place + 0.2, both, 0.38, color=BLUE, label="state and action: I({X, A}; X')")
    axis.barh(place - 0.2, alone, 0.38, color=GREY, label="state alone: I(X; X')")
    axis.set_yticks(place, [row.method for row in rows])
    axis.set(title=rows[0].environment, xlabel="information in bits", ylim=(-0.6, len(rows)))
    if any(row.pay > 0 for row in rows):
        write_rewards(axis, rows, 1.5 * max(both))


def write_rewards(axis: Axes, rows: Sequence[NeighbourRow], right: float) -> None:
    """Writes the reward per step of every method at the right end of the axis."""
    axis.set_xlim(0, right)
    axis.text(right, len(rows) - 0.4, "reward per step", ha="right", va="center", fontsize=8)
    for height, row in enumerate(rows):
        axis.text(right, height, f"{row.pay:.3f}", ha="right", va="center")
