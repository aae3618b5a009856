import numpy as np
import pytest

from deep_curiosity.tabular.agent import CuriousAgent, FixedPolicy, run, sample
from deep_curiosity.tabular.environments import (
    FLIP,
    STAY,
    FiniteMDP,
    grid_world,
    reliable_unreliable,
)
from deep_curiosity.tabular.estimators import (
    CountedModel,
    ExactModel,
    ExactValues,
    Experience,
    PropagatedStates,
    QLearning,
    Sarsa,
    VisitedStates,
)
from deep_curiosity.tabular.markov import (
    action_values,
    optimal_action_values,
    stationary_distribution,
)
from deep_curiosity.tabular.policies import greedy, random_log_policy
from deep_curiosity.tabular.schedules import decreasing, fixed
from deep_curiosity.tabular.solvers import solve_stationary

MDP = grid_world()
SHAPE = MDP.reward.shape
COOLING = decreasing(2.0, 0.997, 0.05)


def reward_per_step(policy, mdp=MDP):
    """Reward per step in the long run."""
    states = stationary_distribution(mdp.transition, policy, mdp.start)
    return float(np.einsum("x,xa,xa->", states, policy, mdp.reward))


BEST = reward_per_step(greedy(optimal_action_values(MDP.transition, MDP.reward, MDP.discount)))


def run_agent(agent, num_steps, seed=0, mdp=MDP):
    return run(agent, mdp, num_steps, np.random.default_rng(seed))


def exact_agent(mdp=MDP, **options):
    options = {"temperature": fixed(0.05), "hunger": fixed(20.0)} | options
    states, values = PropagatedStates(mdp.start), ExactValues(mdp.discount)
    return CuriousAgent(ExactModel(mdp), states, values, **options)


def test_exact_agent_earns_what_the_best_policy_earns():
    agent = exact_agent()
    run_agent(agent, 30)
    assert reward_per_step(agent.policy) > 0.99 * BEST


def test_exact_agent_ends_where_the_stationary_solution_is():
    mdp = reliable_unreliable()
    agent = exact_agent(mdp, hunger=fixed(0.0), temperature=fixed(0.5), tolerance=1e-7)
    run_agent(agent, 40, mdp=mdp)
    solution = solve_stationary(mdp, temperature=0.5)
    assert agent.policy[0] == pytest.approx(solution.policy[0], abs=1e-4)


def test_agent_without_hunger_ignores_the_reward():
    rich = FiniteMDP(MDP.transition, 100 * MDP.reward, MDP.start)
    policies = []
    for mdp in (MDP, rich):
        agent = exact_agent(mdp, hunger=fixed(0.0))
        run_agent(agent, 5, mdp=mdp)
        policies.append(agent.policy)
    np.testing.assert_array_equal(*policies)


def test_far_sighted_agent_keeps_to_the_reliable_state():
    mdp = reliable_unreliable()
    agent = exact_agent(
        mdp, hunger=fixed(0.0), temperature=fixed(0.5), curiosity_discount=1.0, tolerance=1e-5
    )
    run_agent(agent, 40, mdp=mdp)
    assert agent.policy[0, STAY] == pytest.approx(0.75, abs=0.01)


def test_far_sighted_agent_may_start_from_one_known_state():
    agent = exact_agent(temperature=fixed(0.5), curiosity_discount=0.9)
    run_agent(agent, 25)
    assert reward_per_step(agent.policy) > 0.95 * BEST


def test_states_from_visits_do_as_well():
    agent = CuriousAgent(
        ExactModel(MDP),
        VisitedStates(SHAPE[0]),
        ExactValues(MDP.discount),
        temperature=fixed(0.05),
        hunger=fixed(20.0),
        max_iterations=20,
    )
    run_agent(agent, 60)
    assert reward_per_step(agent.policy) > 0.98 * BEST


@pytest.mark.parametrize("learning", [Sarsa, QLearning])
def test_values_from_samples_find_the_goal(learning):
    agent = CuriousAgent(
        ExactModel(MDP),
        VisitedStates(SHAPE[0]),
        learning(*SHAPE, MDP.discount),
        temperature=COOLING,
        hunger=fixed(5.0),
        period=10,
        max_iterations=5,
    )
    run_agent(agent, 2_000)
    assert reward_per_step(agent.policy) > 0.85 * BEST


def test_incremental_model_finds_the_goal_with_nothing_known():
    agent = CuriousAgent(
        CountedModel(*SHAPE),
        VisitedStates(SHAPE[0]),
        ExactValues(MDP.discount),
        temperature=COOLING,
        hunger=fixed(5.0),
        period=10,
        max_iterations=10,
    )
    run_agent(agent, 1_000, seed=1)
    assert reward_per_step(agent.policy) > 0.9 * BEST


def test_everything_from_samples_finds_the_goal():
    agent = CuriousAgent(
        CountedModel(*SHAPE),
        VisitedStates(SHAPE[0]),
        Sarsa(*SHAPE, MDP.discount),
        temperature=COOLING,
        hunger=fixed(5.0),
        period=10,
        max_iterations=5,
    )
    run_agent(agent, 2_000)
    assert reward_per_step(agent.policy) > 0.85 * BEST


def test_batch_of_samples_approaches_the_exact_policy_as_it_grows():
    exact = solve_stationary(MDP, temperature=0.5, hunger=5.0, tolerance=1e-6).policy
    errors = []
    for num_steps in (500, 20_000):
        model = CountedModel(*SHAPE)
        for experience in run_agent(FixedPolicy(np.full(SHAPE, 0.25)), num_steps):
            model.observe(experience)
        learned = FiniteMDP(model.transition, model.reward, MDP.start, MDP.discount)
        policy = solve_stationary(learned, temperature=0.5, hunger=5.0, tolerance=1e-6).policy
        errors.append(np.abs(policy - exact).mean())
    assert errors[1] < 0.05 and errors[1] < 0.4 * errors[0]
    assert reward_per_step(policy) > 0.98 * reward_per_step(exact)


def test_planning_at_the_current_state_changes_no_other():
    agent = exact_agent(only_current_state=True)
    agent.plan(0)
    np.testing.assert_allclose(agent.policy[1:], 0.25, atol=1e-12)
    assert agent.policy[0].max() > 0.3


def test_plans_at_the_current_state_leave_every_other_to_the_last_bit():
    agent = exact_agent(only_current_state=True, annealing=(4.0, 1.0))
    agent.log_policy = random_log_policy(*SHAPE, np.random.default_rng(0))
    before = agent.log_policy
    agent.plan(3)
    agent.plan(3)
    others = np.arange(SHAPE[0]) != 3
    np.testing.assert_array_equal(agent.log_policy[others], before[others])
    assert not np.allclose(agent.log_policy[3], before[3])


def test_planning_at_the_current_state_finds_the_goal():
    agent = exact_agent(only_current_state=True, max_iterations=10)
    run_agent(agent, 200)
    assert reward_per_step(agent.policy) > 0.9 * BEST


def test_plan_holds_for_its_period():
    agent, rng = exact_agent(period=3), np.random.default_rng(0)
    policies = []
    for _ in range(4):
        run_agent(agent, 1)
        policies.append(agent.policy)
    np.testing.assert_array_equal(policies[0], policies[2])
    assert not np.array_equal(policies[2], policies[3])
    assert 0 <= agent.act(0, rng) < 4


def test_annealing_at_every_step_ends_nearly_deterministic():
    agent = exact_agent(temperature=fixed(0.01), annealing=(16.0, 4.0, 1.0))
    run_agent(agent, 10)
    assert reward_per_step(agent.policy) > 0.99 * BEST
    value = action_values(MDP.transition, MDP.reward, agent.policy, MDP.discount)
    shortfall = 20 * (value.max(1, keepdims=True) - value)
    assert np.max(agent.policy * shortfall) < 0.5  # no action far below the best remains likely


def test_falling_temperature_goes_from_indifferent_to_best_and_stops_at_its_least():
    agent = exact_agent(temperature=decreasing(50.0, 0.5, 0.05))
    run_agent(agent, 1)
    assert reward_per_step(agent.policy) < 0.6 * BEST
    run_agent(agent, 20)
    assert reward_per_step(agent.policy) > 0.99 * BEST
    assert agent.temperature(agent.step) == 0.05


def test_scheduled_hunger_turns_curiosity_into_earning():
    agent = exact_agent(hunger=lambda step: 0.0 if step < 10 else 20.0)
    run_agent(agent, 10)
    curious = reward_per_step(agent.policy)
    run_agent(agent, 20)
    assert curious < 0.6 * BEST and reward_per_step(agent.policy) > 0.99 * BEST


def test_hunger_may_depend_on_the_state():
    hungry = np.where(np.arange(SHAPE[0]) < 8, 0.0, 20.0)
    agent = exact_agent(hunger=fixed(hungry))
    run_agent(agent, 30)
    value = action_values(MDP.transition, MDP.reward, agent.policy, MDP.discount)
    gain = (agent.policy * value).sum(1) - value.mean(1)
    assert gain[8:15].min() > 0 and 0.6 * BEST < reward_per_step(agent.policy) < 0.95 * BEST


def test_samples_follow_the_probabilities():
    rng = np.random.default_rng(0)
    counts = np.bincount([sample(np.array([0.2, 0.0, 0.8]), rng) for _ in range(5_000)])
    assert counts[1] == 0 and counts[0] / 5_000 == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("probability", [np.zeros(3), np.array([-1.0, 0.5, 0.5])])
def test_what_is_no_distribution_is_not_sampled(probability):
    with pytest.raises(ValueError, match="`probability` must"):
        sample(probability, np.random.default_rng(0))


def test_same_seed_gives_the_same_transitions():
    first, second = (run_agent(FixedPolicy(np.full(SHAPE, 0.25)), 50, seed=3) for _ in range(2))
    assert first == second
    assert first[0].state == 0 and first[1].state == first[0].next_state


def test_unreliable_state_is_left_to_chance():
    mdp = reliable_unreliable()
    history = run_agent(FixedPolicy(np.eye(2)[[FLIP, FLIP]]), 2_000, mdp=mdp)
    left = [step.next_state for step in history if step.state == 1]
    assert np.mean(left) == pytest.approx(0.5, abs=0.05)
    assert all(step.next_state == 1 for step in history if step.state == 0)


@pytest.mark.parametrize("temperature", [1e-308, 5e-324])
def test_agent_may_be_as_cold_as_a_number_can_be(temperature):
    agent = exact_agent(temperature=fixed(temperature))
    run_agent(agent, 30)
    assert reward_per_step(agent.policy) > 0.99 * BEST


@pytest.mark.parametrize(
    ("schedules", "message"),
    [
        ({"hunger": fixed(float("nan"))}, "`hunger` must be a number, got nan"),
        ({"hunger": fixed(float("inf"))}, "`hunger` must be finite, got inf"),
        ({"hunger": fixed(np.full(SHAPE[0], np.nan))}, "`hunger` must be finite, got nan"),
        ({"hunger": fixed(np.ones(4))}, r"`hunger` must have shape \(16,\), got \(4,\)"),
        ({"temperature": fixed(0.0)}, "`temperature` must be positive and finite, got 0.0"),
        ({"temperature": fixed(float("nan"))}, "`temperature` must be a number, got nan"),
    ],
)
def test_a_schedule_that_gives_no_sound_number_is_named(schedules, message):
    with pytest.raises(ValueError, match=message):
        run_agent(exact_agent(**schedules), 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance": -1.0}, "`tolerance` must be positive"),
        ({"max_iterations": 0}, "`max_iterations` must be at least 1, got 0"),
        ({"curiosity_discount": 7.0}, r"`curiosity_discount` must lie in \[0.0, 1.0\], got 7.0"),
        ({"annealing": (2.0, -1.0)}, "`annealing` must be positive and finite, got -1.0"),
        ({"annealing": ()}, "`annealing` must name at least one multiple, got none"),
    ],
)
def test_settings_of_an_agent_are_checked_when_it_is_made(options, message):
    with pytest.raises(ValueError, match=message):
        exact_agent(**options)


def test_an_action_that_an_environment_does_not_have_is_named():
    mdp = reliable_unreliable()
    with pytest.raises(ValueError, match=r"`action` must lie in \[0, 1\], got 2"):
        run_agent(FixedPolicy(np.eye(3)[[2, 2]]), 1, mdp=mdp)


@pytest.mark.parametrize("experience", [Experience(99, 0, 0.0, 0), Experience(0, 0, 0.0, -1)])
def test_an_agent_refuses_what_cannot_have_happened(experience):
    with pytest.raises(ValueError, match="state` must lie in"):
        exact_agent().observe(experience)


def test_an_agent_learns_from_nothing_but_an_experience():
    with pytest.raises(TypeError, match="`experience` must be an Experience"):
        exact_agent().observe((0, 0, 0.0, 0))


def test_agent_keeps_what_its_last_plan_came_to():
    agent = exact_agent(max_iterations=1)
    assert agent.solution is None
    agent.plan(0)
    assert agent.solution is not None and not agent.solution.converged
    patient = exact_agent(max_iterations=1_000, temperature=fixed(1.0))
    patient.plan(0)
    assert patient.solution is not None and patient.solution.converged


def test_period_of_zero_is_rejected():
    with pytest.raises(ValueError, match="`period` must be at least 1, got 0"):
        exact_agent(period=0)


def test_a_fixed_policy_stays_when_the_array_it_was_made_of_changes():
    policy = np.full((2, 2), 0.5)
    learner = FixedPolicy(policy)
    policy[:] = 7
    np.testing.assert_array_equal(learner.policy, 0.5)
