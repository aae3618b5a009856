"""The algorithm of section 4, with a choice of variants for each of its estimates."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.checks import (
    check_at_least,
    check_finite,
    check_index,
    check_number,
    check_positive,
    check_range,
    check_shape,
    checked,
    fixed_copy,
)
from deep_curiosity.tabular.environments import FiniteMDP
from deep_curiosity.tabular.estimators import (
    ActionValues,
    Experience,
    Model,
    StateEstimate,
    check_experience,
)
from deep_curiosity.tabular.iteration import Solution
from deep_curiosity.tabular.policies import uniform_log_policy
from deep_curiosity.tabular.solvers import anneal, solve_time_step


class Learner(ABC):
    """An agent that acts in an environment and learns from every step."""

    @abstractmethod
    def act(self, state: int, rng: np.random.Generator) -> int:
        """Chooses an action."""

    @abstractmethod
    def observe(self, experience: Experience) -> None:
        """Learns from one transition."""


@checked
def sample(probability: Float[np.ndarray, " outcomes"], rng: np.random.Generator) -> int:
    """Samples the index of an outcome."""
    cumulative = np.cumsum(probability)
    return int(np.searchsorted(cumulative, rng.random() * cumulative[-1], side="right"))


@checked
def run(
    learner: Learner, mdp: FiniteMDP, num_steps: int, rng: np.random.Generator
) -> list[Experience]:
    """Runs a learner in an environment and returns its transitions."""
    check_at_least("num_steps", num_steps, 0)
    state, history = sample(mdp.start, rng), []
    for _ in range(num_steps):
        action = learner.act(state, rng)
        check_index("action", action, mdp.num_actions)
        next_state = sample(mdp.transition[state, action], rng)
        reward = float(mdp.reward[state, action])
        history.append(Experience(state, action, reward, next_state))
        learner.observe(history[-1])
        state = next_state
    return history


class FixedPolicy(Learner):
    """Follows one fixed policy, to collect a batch or to serve as a baseline.

    Args:
        policy: The policy to follow.
    """

    @checked
    def __init__(self, policy: Float[np.ndarray, "states actions"]) -> None:
        self.policy = fixed_copy(policy)

    def act(self, state: int, rng: np.random.Generator) -> int:
        """Samples an action."""
        check_index("state", state, len(self.policy))
        return sample(self.policy[state], rng)

    def observe(self, experience: Experience) -> None:
        """Learns nothing."""


class CuriousAgent(Learner):
    """The curious agent: solves (21) with (20) at every time step and acts on it.

    The algorithm is exact throughout with an exact model, propagated states and exact values;
    each of the three may be replaced by an estimate from samples.

    Args:
        model: Model of the environment.
        states: Estimate of p_t(x).
        values: Estimate of Q(x, a).
        temperature: The price lambda(t); `decreasing` with a least value gives lambda_min.
        hunger: The weight alpha(t) of the reward, one number or one for each state.
        curiosity_discount: Discount of curiosity, 0 for the paper as written.
        annealing: Multiples of lambda(t) to solve at in sequence at every time step, the last one
            1; falling multiples are deterministic annealing.
        period: Steps between plans; the estimates learn at every step.
        only_current_state: Whether a plan changes the policy in the current state only.
        tolerance: Largest change of a probability that ends a plan.
        max_iterations: Largest number of updates at each temperature.

    Attributes:
        solution: What the last plan came to, converged or not; `None` before the first.
    """

    @checked
    def __init__(
        self,
        model: Model,
        states: StateEstimate,
        values: ActionValues,
        *,
        temperature: Callable[[int], float],
        hunger: Callable[[int], float | Float[np.ndarray, " states"]],
        curiosity_discount: float = 0.0,
        annealing: Sequence[float] = (1.0,),
        period: int = 1,
        only_current_state: bool = False,
        tolerance: float = 1e-4,
        max_iterations: int = 100,
    ) -> None:
        check_at_least("period", period, 1)
        check_at_least("max_iterations", max_iterations, 1)
        check_positive("tolerance", tolerance)
        check_range("curiosity_discount", curiosity_discount, 0.0, 1.0)
        if len(annealing) == 0:
            raise ValueError("`annealing` must name at least one multiple, got none.")
        for multiple in annealing:
            check_positive("annealing", multiple)
        self.model, self.states, self.values = model, states, values
        self.temperature, self.hunger, self.annealing = temperature, hunger, annealing
        self.period, self.only_current_state = period, only_current_state
        self.solve = partial(
            solve_time_step,
            curiosity_discount=curiosity_discount,
            tolerance=tolerance,
            max_iterations=max_iterations,
        )
        self.step = 0
        self.solution: Solution | None = None
        self.log_policy = uniform_log_policy(*model.reward.shape)

    @property
    def policy(self) -> Float[np.ndarray, "states actions"]:
        """The current policy."""
        return np.exp(self.log_policy)

    def plan(self, state: int) -> None:
        """Steps 2(b) and 2(c): the policy for the current estimates."""
        transition, distribution = self.model.transition, self.states.distribution
        value = self.values.estimate(self.model, self.policy)
        weighted_value = _column(self.hunger(self.step), len(value)) * value
        rows = np.arange(len(value)) == state if self.only_current_state else None

        def solve(log_policy: np.ndarray, temperature: float) -> Solution:
            return self.solve(
                transition,
                log_policy,
                distribution,
                weighted_value,
                temperature=temperature,
                recomputed=rows,
            )

        temperature = self.temperature(self.step)
        check_positive("temperature", temperature)
        temperatures = [factor * temperature for factor in self.annealing]
        self.solution = anneal(solve, self.log_policy, temperatures, recomputed=rows)
        self.log_policy = self.solution.log_policy

    def act(self, state: int, rng: np.random.Generator) -> int:
        """Step 2(d): plans if a plan is due, and samples an action."""
        check_index("state", state, len(self.log_policy))
        if self.step % self.period == 0:
            self.plan(state)
        return sample(self.policy[state], rng)

    def observe(self, experience: Experience) -> None:
        """Steps 2(e), 2(f) and 2(a): updates values, model and states by one time step."""
        check_experience(experience, *self.log_policy.shape)
        self.values.observe(experience)
        self.model.observe(experience)
        self.states.observe(experience, self.model.transition, self.policy)
        self.step += 1


def _column(
    hunger: float | Float[np.ndarray, " states"], num_states: int
) -> Float[np.ndarray, "some 1"]:
    """What a schedule of hunger gives, as a column: one row, or one for each state.

    Raises:
        TypeError: If it is no number and no array.
        ValueError: If an entry is not finite, or there are not as many as states.
    """
    if isinstance(hunger, np.ndarray):
        check_shape("hunger", hunger, (num_states,))
    else:
        check_number("hunger", hunger)
    check_finite("hunger", np.asarray(hunger))
    return np.reshape(hunger, (-1, 1))
