"""CSV tables, and what most of them share: a measure, and that they hold no half-way policy."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.environments import FiniteMDP
from deep_curiosity.tabular.information import predictive_information, to_bits
from deep_curiosity.tabular.iteration import Solution
from deep_curiosity.tabular.markov import stationary_distribution


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence]) -> None:
    """Writes rows as CSV, floats to six decimals."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([[format_entry(entry) for entry in row] for row in rows])


def format_entry(entry: object) -> object:
    """Rounds a float to six decimals and leaves other entries unchanged."""
    return f"{entry:.6f}" if isinstance(entry, float) else entry


def stationary_bits(mdp: FiniteMDP, policy: Float[np.ndarray, "states actions"]) -> float:
    """Predictive information I({X, A}; X') in the stationary states of a policy, in bits."""
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    return to_bits(predictive_information(mdp.transition, policy, states))


def settled(solution: Solution) -> Float[np.ndarray, "states actions"]:
    """The policy of a solution that has converged: no other belongs in a table.

    Raises:
        RuntimeError: If it has not.
    """
    if not solution.converged:
        num_updates, cycle = len(solution.objective) - 1, solution.cycle_length
        raise RuntimeError(
            f"`solution` must have converged, got one after {num_updates} updates"
            + ("." if cycle is None else f" that repeats itself every {cycle}.")
        )
    return solution.policy
