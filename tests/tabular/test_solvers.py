import numpy as np
import pytest

from deep_curiosity.tabular.environments import (
    FLIP,
    STAY,
    chain,
    clever_random,
    grid_world,
    random_mdp,
    reliable_unreliable,
)
from deep_curiosity.tabular.information import (
    log_next_state_marginal,
    predictive_information,
    safe_log,
    to_bits,
    to_nats,
)
from deep_curiosity.tabular.iteration import iterate
from deep_curiosity.tabular.markov import (
    action_values,
    optimal_action_values,
    propagate,
    stationary_distribution,
)
from deep_curiosity.tabular.policies import greedy, random_log_policy, uniform_log_policy
from deep_curiosity.tabular.solvers import (
    anneal,
    curious_objective,
    curious_score,
    curious_step,
    solve_stationary,
    solve_time_step,
)

ONE_TENTH_BIT = to_nats(0.1)
STAY_STAY, FLIP_FLIP = np.eye(2)[[STAY, STAY]], np.eye(2)[[FLIP, FLIP]]


def bits_of(mdp, policy):
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    return to_bits(predictive_information(mdp.transition, policy, states))


def extremes(policy):
    """A policy over two actions as one over the 101 of the grid."""
    return np.pad(policy[:, :1], ((0, 0), (0, 100))) + np.pad(policy[:, 1:], ((0, 0), (100, 0)))


@pytest.mark.parametrize(
    "temperature",
    [pytest.param(0.05, marks=pytest.mark.slow), 0.3, pytest.param(1.5, marks=pytest.mark.slow)],
)
def test_clever_random_reaches_one_bit_with_the_two_extreme_actions(temperature):
    mdp, rng = clever_random(), np.random.default_rng(0)
    for _ in range(3):
        start = random_log_policy(2, 101, rng)
        solution = solve_stationary(mdp, start, temperature=temperature, tolerance=1e-8)
        assert solution.converged
        assert bits_of(mdp, solution.policy) == pytest.approx(1, abs=1e-6)
        assert solution.policy[:, [0, -1]].sum(1) == pytest.approx(1, abs=1e-6)


def test_clever_random_has_a_continuum_of_splits_and_keeps_the_one_it_finds():
    mdp, rng = clever_random(), np.random.default_rng(1)
    starts = [random_log_policy(2, 101, rng) for _ in range(2)]
    ends = [solve_stationary(mdp, start, temperature=0.3, tolerance=1e-6) for start in starts]
    assert abs(ends[0].policy[0, 0] - ends[1].policy[0, 0]) > 0.05
    for split in (0.1, 0.5, 0.9):
        policy = extremes(np.tile([split, 1 - split], (2, 1)))
        updated, _ = curious_step(
            mdp.transition, safe_log(policy), mdp.start, np.zeros((2, 101)), 0.3
        )
        np.testing.assert_allclose(np.exp(updated), policy, atol=1e-12)


@pytest.mark.parametrize("start", [np.array([0.5, 0.5]), np.array([0.9, 0.1])])
def test_limit_with_shared_ties_is_half_each_and_neither_stay_nor_flip(start):
    mdp = clever_random()

    def respond(policy):
        states = stationary_distribution(mdp.transition, policy, start)
        return greedy(curious_score(mdp.transition, safe_log(policy), states))

    half = extremes(np.full((2, 2), 0.5))
    np.testing.assert_array_equal(respond(half), half)
    assert not np.allclose(respond(extremes(STAY_STAY)), extremes(STAY_STAY))
    assert not np.allclose(respond(extremes(FLIP_FLIP)), extremes(FLIP_FLIP))
    if start[0] == 0.5:  # one iteration leads to half each, as the appendix says
        np.testing.assert_array_equal(respond(extremes(STAY_STAY)), half)
        np.testing.assert_array_equal(respond(extremes(FLIP_FLIP)), half)


def test_iteration_as_written_falls_into_a_two_cycle():
    mdp, rng = clever_random(), np.random.default_rng(2)
    for _ in range(3):
        start = random_log_policy(2, 101, rng)
        written = solve_stationary(mdp, start, temperature=0.3, damping=1.0)
        assert written.cycle_length == 2 and not written.converged
        assert bits_of(mdp, written.policy) == pytest.approx(0, abs=1e-6)


def nearly_split(flips):
    """Both actions in use, FLIP with some probability, in one state by a little more."""
    policy = np.full((2, 101), 1e-30)
    policy[:, 0], policy[:, -1] = 1 - flips, flips
    policy[0, 0], policy[0, -1] = 1 - flips + 1e-4, flips - 1e-4
    return np.log(policy)


@pytest.mark.parametrize(
    ("flips", "temperature", "cycles"),
    [(0.5, 0.9, True), (0.5, 1.1, False), (0.3, 0.8, True), (0.3, 0.9, False), (0.7, 0.9, False)],
)
def test_at_given_states_an_imbalance_is_multiplied_by_the_variance_of_the_split(
    flips, temperature, cycles
):
    """By `-4 s (1 - s) / lambda`; what alternates and shrinks slowly is no cycle."""
    mdp = clever_random()

    def step(log_policy):
        return curious_step(mdp.transition, log_policy, mdp.start, np.zeros((2, 101)), temperature)

    solution = iterate(step, nearly_split(flips), damping=1.0)
    assert solution.converged is not cycles
    assert solution.cycle_length == (2 if cycles else None)


@pytest.mark.parametrize(
    ("flips", "temperature", "cycles"),
    [(0.3, 1.0, True), (0.3, 1.5, False), (0.7, 0.5, True), (0.7, 0.7, False)],
)
def test_at_its_own_states_the_imbalance_counts_the_more_the_rarer_it_flips(
    flips, temperature, cycles
):
    """By `-2 (1 - f) / lambda`: a chain that stays is longer where it is more probable."""
    start = nearly_split(flips)
    solution = solve_stationary(clever_random(), start, temperature=temperature, damping=1.0)
    assert solution.converged is not cycles
    assert solution.cycle_length == (2 if cycles else None)


def test_what_the_two_cycle_reports_is_more_than_the_mdp_can_carry():
    mdp, log_policy = clever_random(), random_log_policy(2, 101, np.random.default_rng(3))
    nothing = np.zeros((2, 101))
    for _ in range(20):
        previous = log_policy
        log_policy, _ = curious_step(mdp.transition, previous, mdp.start, nothing, 0.3)
    mixed = curious_score(mdp.transition, previous, mdp.start) * np.exp(log_policy)
    assert to_bits(mdp.start @ mixed.sum(1)) > 1
    log_marginal = log_next_state_marginal(mdp.transition, log_policy, mdp.start)
    assert np.exp(log_marginal).max() == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize(
    "temperature",
    [
        pytest.param(0.05, marks=pytest.mark.slow),
        pytest.param(ONE_TENTH_BIT, marks=pytest.mark.slow),
        0.5,
        2.0,
    ],
)
def test_short_sighted_agent_stays_in_the_reliable_state_half_the_time(temperature):
    mdp, rng = reliable_unreliable(), np.random.default_rng(4)
    for _ in range(2):
        start = random_log_policy(2, 2, rng)
        solution = solve_stationary(mdp, start, temperature=temperature, tolerance=1e-8)
        policy = solution.policy
        assert policy[0, STAY] == pytest.approx(0.5, abs=1e-5)
        assert bits_of(mdp, policy) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_short_sighted_half_does_not_depend_on_the_estimated_states(share):
    solution = solve_time_step(
        reliable_unreliable().transition,
        random_log_policy(2, 2, np.random.default_rng(5)),
        np.array([share, 1 - share]),
        temperature=0.5,
        tolerance=1e-8,
    )
    assert solution.policy[0, STAY] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("curiosity_discount", "stay", "reliable", "bits"),
    [
        (0.0, 0.5, 0.5, 0.5),
        (0.5, 0.6464, 0.5858, 0.5644),
        (0.9, 0.7321, 0.6511, 0.5842),
        (0.99, 0.7483, 0.6651, 0.5850),
        (0.999, 0.7498, 0.6665, 0.5850),
        (1.0, 3 / 4, 2 / 3, np.log2(3) - 1),
    ],
)
def test_far_sighted_agent_of_the_second_illustration(curiosity_discount, stay, reliable, bits):
    mdp, rng = reliable_unreliable(), np.random.default_rng(6)
    for temperature in (ONE_TENTH_BIT, 1.0):
        solution = solve_stationary(
            mdp,
            random_log_policy(2, 2, rng),
            temperature=temperature,
            curiosity_discount=curiosity_discount,
            tolerance=1e-8,
        )
        states = stationary_distribution(mdp.transition, solution.policy, mdp.start)
        assert solution.converged
        assert solution.policy[0, STAY] == pytest.approx(stay, abs=5.1e-5)
        assert states[0] == pytest.approx(reliable, abs=5.1e-5)
        assert bits_of(mdp, solution.policy) == pytest.approx(bits, abs=5.1e-5)


def test_no_policy_of_the_second_illustration_carries_more_than_the_far_sighted_one():
    mdp = reliable_unreliable()
    stay = np.linspace(0, 1, 401)
    policies = [np.array([[s, 1 - s], [0.5, 0.5]]) for s in stay]
    bits = [bits_of(mdp, policy) for policy in policies]
    assert stay[np.argmax(bits)] == pytest.approx(0.75)
    assert max(bits) == pytest.approx(np.log2(3) - 1, abs=1e-9)


@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_no_perturbation_at_one_time_step_raises_the_objective(seed):
    rng = np.random.default_rng(seed)
    mdp, hunger, temperature, when = random_mdp(4, 3, rng), 0.3, 0.4, 2
    base = np.exp(random_log_policy(4, 3, rng))
    value = action_values(mdp.transition, mdp.reward, base, mdp.discount)
    states, earned = mdp.start, 0.0
    for step in range(when):  # what (6) earns before time step t, whatever happens then
        mean_reward = np.einsum("x,xa,xa->", states, base, mdp.reward)
        earned += mdp.discount**step * mean_reward
        states = propagate(states, mdp.transition, base)
    weight = hunger * mdp.discount**when

    def objective(policy):
        whole = curious_objective(mdp.transition, policy, states, weight * value, temperature)
        return whole + hunger * earned

    solution = solve_time_step(
        mdp.transition, np.log(base), states, weight * value, temperature=temperature
    )
    assert solution.converged
    best = objective(solution.policy)
    for _ in range(60):
        other = np.exp(random_log_policy(4, 3, rng))
        for size in (1e-6, 1e-3, 0.1, 1.0):
            moved = (1 - size) * solution.policy + size * other
            assert objective(moved) <= best + 1e-12


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_stationary_policy_is_a_maximum_for_its_own_states_and_values(seed):
    rng = np.random.default_rng(seed)
    mdp = random_mdp(4, 3, rng)
    policy = solve_stationary(mdp, temperature=0.5, hunger=0.2).policy
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    value = 0.2 * action_values(mdp.transition, mdp.reward, policy, mdp.discount)
    best = curious_objective(mdp.transition, policy, states, value, 0.5)
    for _ in range(100):
        moved = 0.99 * policy + 0.01 * np.exp(random_log_policy(4, 3, rng))
        assert curious_objective(mdp.transition, moved, states, value, 0.5) <= best + 1e-12


@pytest.mark.parametrize("temperature", [0.02, 0.3, 3.0])
def test_damped_iteration_never_goes_down(temperature):
    rng = np.random.default_rng(7)
    for _ in range(3):
        mdp = random_mdp(5, 3, rng)
        solution = solve_time_step(
            mdp.transition,
            random_log_policy(5, 3, rng),
            mdp.start,
            rng.normal(size=(5, 3)),
            temperature=temperature,
            max_iterations=200,
        )
        assert (np.diff(solution.objective) > -1e-12).all()


def test_trace_is_the_objective_of_the_definition():
    rng = np.random.default_rng(12)
    mdp, log_policy, value = random_mdp(4, 3, rng), random_log_policy(4, 3, rng), np.ones((4, 3))
    _, traced = curious_step(mdp.transition, log_policy, mdp.start, value, 0.7)
    defined = curious_objective(mdp.transition, np.exp(log_policy), mdp.start, value, 0.7)
    assert traced == pytest.approx(defined, abs=1e-14)


def test_one_update_by_hand():
    mdp, policy = reliable_unreliable(), np.array([[0.8, 0.2], [0.4, 0.6]])
    states, temperature = np.array([0.25, 0.75]), 0.5
    value = np.array([[0.1, 0.0], [0.0, 0.3]])
    prior = states @ policy  # 0.5, 0.5
    marginal = np.array([0.25 * 0.8 + 0.75 * 0.5, 0.25 * 0.2 + 0.75 * 0.5])
    half = 0.5 * np.log(0.5 / marginal[0]) + 0.5 * np.log(0.5 / marginal[1])
    divergence = np.array([[-np.log(marginal[0]), -np.log(marginal[1])], [half, half]])
    weight = prior * np.exp((divergence + value) / temperature)
    updated, _ = curious_step(mdp.transition, np.log(policy), states, value, temperature)
    np.testing.assert_allclose(np.exp(updated), weight / weight.sum(1, keepdims=True))


@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_cold_policy_chooses_only_what_the_deterministic_limit_allows(seed):
    mdp = random_mdp(4, 3, np.random.default_rng(seed))
    value = action_values(mdp.transition, mdp.reward, np.full((4, 3), 1 / 3), 0.9)

    def solve(log_policy, temperature):
        return solve_time_step(
            mdp.transition,
            log_policy,
            mdp.start,
            value,
            temperature=temperature,
            max_iterations=400,
        )

    policy = anneal(solve, uniform_log_policy(4, 3), [1.0, 0.1, 0.01, 1e-3]).policy
    score = value + curious_score(mdp.transition, safe_log(policy), mdp.start)
    shortfall = score.max(1, keepdims=True) - score
    assert np.max(policy * shortfall) < 1e-3


@pytest.mark.parametrize("mdp", [random_mdp(5, 3, np.random.default_rng(8)), grid_world(3, 3)])
@pytest.mark.parametrize("curiosity_discount", [0.0, 0.9])
def test_hungry_agent_finds_the_optimal_policy(mdp, curiosity_discount):
    solution = solve_stationary(
        mdp,
        temperature=0.5,
        hunger=1e4,
        curiosity_discount=curiosity_discount,
        tolerance=1e-8,
    )
    reached = action_values(mdp.transition, mdp.reward, solution.policy, mdp.discount)
    best = optimal_action_values(mdp.transition, mdp.reward, mdp.discount)
    chosen = np.einsum("xa,xa->x", solution.policy, reached)
    np.testing.assert_allclose(chosen, best.max(-1), rtol=1e-3)


@pytest.mark.parametrize("temperature", [1e12, 1e17])
def test_what_is_too_hot_to_be_seen_to_move_has_not_converged(temperature):
    mdp = random_mdp(4, 3, np.random.default_rng(0))
    start = np.log(np.tile([0.9, 0.05, 0.05], (4, 1)))
    solution = solve_time_step(
        mdp.transition, start, mdp.start, temperature=temperature, max_iterations=50
    )
    assert not solution.converged


def test_a_hot_solution_has_converged_where_no_other_prior_is_better():
    mdp, start = clever_random(3), np.log([[0.5, 0.4, 0.1], [0.4, 0.5, 0.1]])
    solution = solve_time_step(mdp.transition, start, mdp.start, temperature=50.0, tolerance=1e-6)
    score = curious_score(mdp.transition, solution.log_policy, mdp.start)
    earned = mdp.start @ (solution.policy * score).sum(1)
    assert solution.converged and (mdp.start @ score).max() - earned < 1e-3


def test_only_the_recomputed_states_change():
    mdp, rng = random_mdp(4, 3, np.random.default_rng(9)), np.random.default_rng(10)
    start = random_log_policy(4, 3, rng)
    rows = np.arange(4) == 2
    solution = solve_time_step(mdp.transition, start, mdp.start, temperature=0.3, recomputed=rows)
    np.testing.assert_allclose(solution.policy[~rows], np.exp(start)[~rows], atol=1e-12)
    assert not np.allclose(solution.policy[2], np.exp(start)[2])


def test_a_start_in_one_state_makes_all_beyond_its_reach_infinitely_curious():
    mdp = chain(8)
    score = curious_score(mdp.transition, uniform_log_policy(8, 2), mdp.start)
    np.testing.assert_array_equal(np.isposinf(score).any(1), np.arange(8) > 0)
    assert np.isfinite(score[0]).all()


def test_annealing_needs_a_temperature():
    with pytest.raises(ValueError, match="at least one temperature, got none"):
        anneal(lambda log_policy, temperature: None, np.log(np.full((2, 2), 0.5)), [])


def test_policy_that_does_not_sum_to_one_is_rejected():
    with pytest.raises(ValueError, match="`log_policy` must sum to 1"):
        solve_stationary(reliable_unreliable(), np.zeros((2, 2)), temperature=0.1)
