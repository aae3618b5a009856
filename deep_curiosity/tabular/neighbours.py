"""The related methods that the paper names, as tabular agents to compare with."""

import numpy as np
from jaxtyping import Float

from deep_curiosity.tabular.agent import Learner, sample
from deep_curiosity.tabular.checks import (
    check_at_least,
    check_distribution,
    check_index,
    check_positive,
    check_range,
    check_shape,
    checked,
)
from deep_curiosity.tabular.environments import FiniteMDP
from deep_curiosity.tabular.estimators import (
    CountedModel,
    Experience,
    QLearning,
    check_experience,
)
from deep_curiosity.tabular.far_sighted import curiosity_values
from deep_curiosity.tabular.information import (
    curiosity,
    log_action_marginal,
    log_next_state_marginal,
    safe_log,
    state_predictive_information,
    weighted_sum,
)
from deep_curiosity.tabular.iteration import Solution, iterate
from deep_curiosity.tabular.markov import optimal_action_values, stationary_distribution
from deep_curiosity.tabular.policies import (
    boltzmann,
    epsilon_greedy,
    greedy,
    information_limited,
    normalize_log,
    uniform_log_policy,
)

SETTLED = 1e-8  # of probabilities, and of values of about one or as a share of larger ones


class EpsilonGreedy(Learner):
    """Q-learning of the reward, with a fixed chance of a random action.

    Args:
        num_states: Number of states.
        num_actions: Number of actions.
        discount: Discount of the return.
        epsilon: Probability of a random action.

    Reference: Sutton & Barto, "Reinforcement Learning" (1998).
    """

    @checked
    def __init__(
        self, num_states: int, num_actions: int, *, discount: float, epsilon: float = 0.1
    ) -> None:
        check_range("epsilon", epsilon, 0.0, 1.0)
        self.values = QLearning(num_states, num_actions, discount)
        self.epsilon = epsilon

    @property
    def policy(self) -> Float[np.ndarray, "states actions"]:
        """The current policy."""
        return epsilon_greedy(self.values.action_value, self.epsilon)

    def act(self, state: int, rng: np.random.Generator) -> int:
        """Samples an action."""
        check_index("state", state, len(self.policy))
        return sample(self.policy[state], rng)

    def observe(self, experience: Experience) -> None:
        """Learns from one transition."""
        self.values.observe(experience)


class PredictionErrorCuriosity(EpsilonGreedy):
    """Seeks what its own model fails to predict: the reward is -log p(x' | x, a).

    Args:
        num_states: Number of states.
        num_actions: Number of actions.
        discount: Discount of the surprise.
        epsilon: Probability of a random action.

    Reference: Schmidhuber, "A possibility for implementing curiosity and boredom in
    model-building neural controllers" (1991).
    """

    @checked
    def __init__(
        self, num_states: int, num_actions: int, *, discount: float, epsilon: float = 0.1
    ) -> None:
        super().__init__(num_states, num_actions, discount=discount, epsilon=epsilon)
        self.model = CountedModel(num_states, num_actions, pseudo_count=1.0)

    def observe(self, experience: Experience) -> None:
        """Learns values with the surprise in nats as reward, then updates the model."""
        check_experience(experience, *self.values.action_value.shape)
        state, action, _, next_state = experience
        surprise = -float(np.log(self.model.transition[state, action, next_state]))
        self.values.observe(experience._replace(reward=surprise))
        self.model.observe(experience)


class RMax(Learner):
    """Optimism: an action tried too seldom is assumed to earn the largest reward for ever.

    Args:
        num_states: Number of states.
        num_actions: Number of actions.
        discount: Discount of the return.
        largest_reward: The largest reward of the environment.
        num_known: Tries after which an action counts as known.

    Reference: Brafman & Tennenholtz, "R-MAX" (2002).
    """

    @checked
    def __init__(
        self,
        num_states: int,
        num_actions: int,
        *,
        discount: float,
        largest_reward: float,
        num_known: int = 10,
    ) -> None:
        check_at_least("num_known", num_known, 1)
        self.model = CountedModel(num_states, num_actions)
        self.tries = np.zeros((num_states, num_actions), int)
        self.discount, self.largest_reward = discount, largest_reward
        self.num_known = num_known
        self.plan()

    @property
    def policy(self) -> Float[np.ndarray, "states actions"]:
        """The current policy."""
        return greedy(self.action_value)

    def plan(self) -> None:
        """Solves the optimistic model, in which an unknown action keeps the state."""
        known = self.tries >= self.num_known
        stays = np.broadcast_to(np.eye(len(known))[:, None], self.model.transition.shape)
        transition = np.where(known[:, :, None], self.model.transition, stays)
        reward = np.where(known, self.model.reward, self.largest_reward)
        self.action_value = optimal_action_values(transition, reward, self.discount)

    def act(self, state: int, rng: np.random.Generator) -> int:
        """Samples one of the best actions."""
        check_index("state", state, len(self.policy))
        return sample(self.policy[state], rng)

    def observe(self, experience: Experience) -> None:
        """Counts one transition, and plans again when an action becomes known."""
        self.model.observe(experience)
        self.tries[experience.state, experience.action] += 1
        if self.tries[experience.state, experience.action] == self.num_known:
            self.plan()


@checked
def information_to_go(
    mdp: FiniteMDP,
    state_distribution: Float[np.ndarray, " states"],
    *,
    reward_weight: float,
    num_iterations: int = 1_000,
) -> Solution:
    r"""The policy that trades reward for information to go: all future bits are a cost.

    .. math:: G(x, a) = D(x, a) - \beta R(x, a) + \gamma \sum_{x'} p(x' | x, a) F(x'), \qquad
        F(x) = -\log \sum_a p(a) e^{-G(x, a)}, \qquad \pi(a | x) = p(a) e^{F(x) - G(x, a)}

    The divergence D that a curious agent seeks is a cost here, reward and information share one
    value, and both marginals belong to one given state distribution. (The discount is an addition
    here: the original sums to the end of an episode.)

    Args:
        mdp: The environment.
        state_distribution: Distribution that both marginals are taken over; every state needs
            a positive probability, or what leads there would have no finite cost.
        reward_weight: Nats paid for one unit of reward, beta.
        num_iterations: Number of updates.

    Returns:
        The last policy, with minus the expected free energy as its objective.

    Reference: Tishby & Polani, "Information theory of decisions and actions" (2010).
    """
    check_shape("state_distribution", state_distribution, (mdp.num_states,))
    check_distribution("state_distribution", state_distribution)
    check_positive("state_distribution", float(state_distribution.min()))
    check_at_least("num_iterations", num_iterations, 1)
    log_policy = uniform_log_policy(mdp.num_states, mdp.num_actions)
    free_energy, trace = np.zeros(mdp.num_states), [0.0]
    for _ in range(num_iterations):
        before = log_policy, free_energy
        log_prior = log_action_marginal(log_policy, state_distribution)
        log_marginal = log_next_state_marginal(mdp.transition, log_policy, state_distribution)
        cost = curiosity(mdp.transition, log_marginal) - reward_weight * mdp.reward
        cost = cost + mdp.discount * mdp.transition @ free_energy
        free_energy = -np.logaddexp.reduce(log_prior - cost, axis=-1)
        log_policy = information_limited(log_prior, -cost, 1.0)
        trace.append(-float(state_distribution @ free_energy))
    return _solution_of(before, (log_policy, free_energy), trace)


@checked
def dynamic_policy_programming(
    mdp: FiniteMDP, *, temperature: float, num_iterations: int = 1_000
) -> Solution:
    r"""The policy after updates that each penalise the change from the previous policy.

    .. math:: \Psi \leftarrow \Psi - M \Psi + R + \gamma P M \Psi, \qquad
        \pi \propto e^{\Psi / \lambda}, \qquad M \Psi(x) = \sum_a \pi(a | x) \Psi(x, a)

    Since only change is penalised, it converges to the optimal policy at any temperature.

    Args:
        mdp: The environment.
        temperature: Price of a nat of relative entropy between successive policies.
        num_iterations: Number of updates.

    Returns:
        The last policy, with the mean of its preferences at the start as its objective.

    Reference: Azar & Kappen, "Dynamic policy programming" (2010).
    """
    check_positive("temperature", temperature)
    check_at_least("num_iterations", num_iterations, 1)
    preference = np.zeros((mdp.num_states, mdp.num_actions))
    log_policy, mean, trace = boltzmann(preference, temperature), np.zeros(mdp.num_states), [0.0]
    for _ in range(num_iterations):
        before = log_policy, mean
        backup = mdp.reward + mdp.discount * mdp.transition @ mean
        preference = preference - mean[:, None] + backup
        log_policy = boltzmann(preference, temperature)
        mean = np.einsum("xa,xa->x", np.exp(log_policy), preference)
        trace.append(float(mdp.start @ mean))
    return _solution_of(before, (log_policy, mean), trace)


@checked
def predictive_states(
    mdp: FiniteMDP,
    log_policy: Float[np.ndarray, "states actions"],
    *,
    curiosity_discount: float = 0.0,
    max_iterations: int = 5_000,
) -> Solution:
    r"""Maximises the predictive information of the state sequence alone, I(X; X').

    An action is worth :math:`\sum_{x'} p(x' | x, a) \log p_\pi(x' | x) / p_\pi(x')`: how well the
    state, without the action, predicts the next state. The information is not concave in the
    policy, so the solution depends on the initial policy.

    Args:
        mdp: The environment.
        log_policy: Initial log policy.
        curiosity_discount: Discount of the information.
        max_iterations: Largest number of updates.

    Reference: Ay et al., "Predictive information and explorative behavior of autonomous
    robots" (2008).
    """
    check_shape("log_policy", log_policy, mdp.reward.shape)
    log_transition = safe_log(mdp.transition)

    def step(log_policy: np.ndarray) -> tuple[np.ndarray, float]:
        policy = np.exp(log_policy)
        states = stationary_distribution(mdp.transition, policy, mdp.start)
        log_chain = np.logaddexp.reduce(log_policy[:, :, None] + log_transition, axis=1)
        log_marginal = log_next_state_marginal(mdp.transition, log_policy, states)
        predictability = weighted_sum(mdp.transition, log_chain[:, None] - log_marginal)
        score = curiosity_values(mdp.transition, predictability, policy, curiosity_discount)
        objective = state_predictive_information(mdp.transition, policy, states)
        return normalize_log(log_policy + score), objective

    return iterate(step, log_policy, damping=0.5, halving=True, max_iterations=max_iterations)


def _solution_of(
    before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray], trace: list[float]
) -> Solution:
    """Where a fixed number of updates ended.

    Args:
        before: Log policy and value of every state before the last update.
        after: The same after it.
        trace: The objective of every policy on the way.
    """
    change = np.abs(np.exp(after[0]) - np.exp(before[0])).max()
    value_change = np.abs(after[1] - before[1]).max()
    stands = change <= SETTLED and value_change <= SETTLED * max(1.0, np.abs(after[1]).max())
    return Solution(after[0], np.array(trace), bool(stands), None)
