"""Repeating an update of a policy: damping in log space, convergence and cycles."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import check_at_least, check_positive, check_range, checked
from deep_curiosity.tabular.policies import COLDEST, normalize_log

LONGEST_CYCLE = 8  # number of policies kept to recognise a cycle
ROUNDING = float(np.finfo(float).eps)  # of a probability: changes below it tell nothing


@dataclass(frozen=True)
class Solution:
    """Where an iteration ended, and its path there.

    Args:
        log_policy: Log of the last policy.
        objective: The objective of every policy on the way, the first and the last included.
        converged: Whether the last update changed no probability by more than the tolerance.
        cycle_length: Updates after which the iteration repeats itself, `None` if it does not.
    """

    log_policy: Float[np.ndarray, "states actions"]
    objective: Float[np.ndarray, " policies"]
    converged: bool
    cycle_length: int | None

    @property
    def policy(self) -> Float[np.ndarray, "states actions"]:
        """The last policy."""
        return np.exp(self.log_policy)


@checked
def safe_damping(temperature: float) -> float:
    r"""Largest damping that provably never lowers the objective (16) of one time step.

    Measured by the relative entropy of policies, the curvature of (16) is at most
    :math:`1 + \lambda`: one from the entropy of the next state, lambda from the coding cost. The
    mirror ascent step :math:`1 / (1 + \lambda)` that this allows is the update (25) damped with
    :math:`\eta = \lambda / (1 + \lambda)`. As written, with :math:`\eta = 1`, it may overshoot.
    """
    check_positive("temperature", temperature)
    temperature = max(temperature, COLDEST)
    return temperature / (1 + temperature)


@checked
def damp(
    log_policy: Float[np.ndarray, "states actions"],
    target: Float[np.ndarray, "states actions"],
    damping: float,
) -> Float[np.ndarray, "states actions"]:
    r"""Interpolates to a target in log space: :math:`q^{1 - \eta} \pi^\eta`."""
    if damping == 1:  # an action of probability zero would give infinity times zero
        return target.copy()
    return normalize_log((1 - damping) * log_policy + damping * target)


def turns_back(recent: deque[np.ndarray]) -> bool:
    """Whether the last step, of policies listed newest first, opposes the step before it."""
    if len(recent) < 3:
        return False
    last, middle, first = recent[0], recent[1], recent[2]
    return float(np.sum((last - middle) * (middle - first))) < 0


@checked
def iterate(
    step: Callable[[np.ndarray], tuple[np.ndarray, float]],
    log_policy: Float[np.ndarray, "states actions"],
    *,
    damping: float,
    halving: bool = False,
    tolerance: float = 1e-10,
    max_iterations: int = 20_000,
) -> Solution:
    """Repeats an update of the log policy until it converges, cycles or runs out of iterations.

    A policy that is no number ends it as well: nothing could come of it.

    Args:
        step: Maps a log policy to its undamped update and to the objective to trace.
        log_policy: Where to start.
        damping: Fraction of the step to the update in log space, 1 for the whole step.
        halving: Whether to halve the damping each time the policy reverses its direction.
        tolerance: Largest change of a probability that counts as convergence; it shrinks as
            the damping does. Where it is below rounding, a policy that stands still may only be
            too slow to be seen to move, and does not count as converged.
        max_iterations: Largest number of updates.
    """
    check_range("damping", damping, float(np.nextafter(0, 1)), 1.0)
    check_positive("tolerance", tolerance)
    check_at_least("max_iterations", max_iterations, 1)
    may_converge = tolerance >= ROUNDING
    trace, recent = [], deque([np.exp(log_policy)], LONGEST_CYCLE)
    for _ in range(max_iterations):
        target, objective = step(log_policy)
        trace.append(objective)
        log_policy = damp(log_policy, target, damping)
        is_number = not np.isnan(log_policy).any()
        changes = [np.abs(np.exp(log_policy) - policy).max() for policy in recent]
        recent.appendleft(np.exp(log_policy))
        converged, cycles = changes[0] <= tolerance, _cycles(changes, tolerance)
        if converged or cycles or not is_number:
            break
        if halving and turns_back(recent):
            damping, tolerance = damping / 2, tolerance / 2
    trace.append(step(log_policy)[1])
    cycle_length = int(np.argmin(changes)) + 1 if cycles else None
    return Solution(log_policy, np.array(trace), bool(converged) and may_converge, cycle_length)


def _cycles(changes: Sequence[float], tolerance: float) -> bool:
    """Whether a policy has come back while each step still goes far.

    Steps that alternate and slowly shrink come back as well, nearly; but they are short by then.

    Args:
        changes: From the newest policy to those before it, newest first.
        tolerance: Largest change that counts as none.
    """
    return bool(min(changes) <= tolerance and changes[0] > math.sqrt(tolerance))
