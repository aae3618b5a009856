"""The greedy policy, which maximises the value of the reward alone."""

import pytest
import torch

from deep_curiosity.agent.networks import GaussianPolicy, UniformPrior
from deep_curiosity.agent.sac import CuriousSAC, PolicySample
from deep_curiosity.bonuses.baselines import ConstantBonus
from tests.agent.test_sac import (
    PushingBonus,
    copies,
    equal,
    let_answer,
    random_transition,
    small_agent,
)


def greedy_agent(**options):
    return small_agent(**{"greedy_share": 0.25} | options)


def pushing(slope):
    """Transitions that end at once, whose reward is the slope times the first action entry."""
    batch = random_transition(64)
    ended = torch.ones(64, dtype=torch.bool)
    return batch._replace(reward=slope * batch.action[:, 0], terminated=ended)


def make_narrow(policy):
    """Give every Gaussian its least width, wherever it is."""
    layer = policy.network.layers[-1]
    with torch.no_grad():
        layer.weight[..., 2:] = 0.0
        layer.bias[..., 2:] = -100.0


@pytest.mark.parametrize(
    ("actor_q", "curiosity_discount", "prior"),
    [
        ("min", 0.0, "learned"),
        ("min", 0.5, "uniform"),
        ("alternate", 0.0, "uniform"),
        ("alternate", 0.5, "learned"),
    ],
)
def test_greed_follows_reward_where_curiosity_outweighs_it(actor_q, curiosity_discount, prior):
    agent = greedy_agent(
        curiosity_discount=curiosity_discount,
        actor_q=actor_q,
        prior=prior,
        learning_rate=1e-2,
        temperature="constant:0.1",
    )
    for _ in range(150):
        agent.update(pushing(2.0), PushingBonus(-20.0))
    observation = torch.randn(64, 3)
    assert agent.act(observation, deterministic=True, greedy=True)[:, 0].min() > 0.5
    assert agent.act(observation, deterministic=True)[:, 0].max() < -0.5


def test_a_greedy_policy_is_hungry_where_the_agent_is_not():
    agent = greedy_agent(hunger=0.0, learning_rate=1e-2, temperature="constant:0.1")
    for _ in range(150):
        agent.update(pushing(2.0), ConstantBonus(0.0))
    observation = torch.randn(64, 3)
    assert agent.act(observation, deterministic=True, greedy=True)[:, 0].min() > 0.5
    assert agent.act(observation, deterministic=True)[:, 0].abs().max() < 0.5


@pytest.mark.parametrize("curiosity_discount", [0.0, 0.5])
def test_each_value_is_about_a_policy_of_its_own(curiosity_discount):
    """Reward's about the greedy policy, curiosity's about the curious one."""
    agent = greedy_agent(curiosity_discount=curiosity_discount, soft_backup=False)
    make_narrow(agent.policy)
    observation = torch.randn(5, 3)
    value = agent._next_values(observation, torch.tensor(1.0))
    assert len(value) == 1 + (curiosity_discount > 0)
    for number, greedy in enumerate([True, False][: len(value)]):
        action = agent.act(observation, deterministic=True, greedy=greedy)
        with torch.no_grad():
            expected = agent.target_critics.lower(observation, action)[number]
        torch.testing.assert_close(value[number], expected, atol=1e-2, rtol=0)


def test_a_soft_backup_charges_the_greedy_policy_its_own_price():
    agent = greedy_agent(soft_backup=True)
    agent.log_temperature.data = torch.tensor([100.0, 1e-9]).log()
    let_answer(agent.target_critics, 1.0, 2.0)
    observation = torch.randn(5, 3)
    torch.manual_seed(0)
    value = agent._next_values(observation, torch.tensor(1.0))
    torch.manual_seed(0)
    policy = agent.policy(observation)
    pre_action = policy.sample()
    cost = policy.log_prob(pre_action) - UniformPrior(2).log_prob(pre_action)
    torch.testing.assert_close(value[0], 1 - 100 * cost[:5].detach(), rtol=1e-4, atol=1e-3)
    assert (value[1] == 2).all()


def test_stacked_policies_hold_their_rows_one_after_the_other():
    policies, observation = GaussianPolicy(3, 2, policies=2, hidden_dims=(8,)), torch.randn(4, 3)
    stacked = policies(observation)
    for number in range(2):
        rows = slice(4 * number, 4 * number + 4)
        for part, own in zip(stacked, policies(observation, number), strict=True):
            torch.testing.assert_close(part[rows], own)
    last = policies.at(policies.hidden(observation))
    torch.testing.assert_close(last.loc, policies(observation, 1).loc)


@pytest.mark.parametrize("part", ["reward", "bonus"])
def test_nothing_of_curiosity_reaches_the_greedy_policy(part):
    """Another bonus moves the curious policy, and its habits, alone; another reward moves both."""
    agents, batch = [], random_transition()
    for factor in (1.0, -3.0):
        torch.manual_seed(0)
        agent = greedy_agent(learning_rate=1e-2)
        scaled = batch._replace(reward=factor * batch.reward) if part == "reward" else batch
        for _ in range(3):
            agent.update(scaled, PushingBonus(factor if part == "bonus" else 1.0))
        agents.append(agent)
    greedy, curious = (
        [[parameter[number] for parameter in agent.policy.parameters()] for agent in agents]
        for number in (0, 1)
    )
    assert equal(*greedy) == (part == "bonus")
    assert not equal(*curious)


def test_each_policy_holds_the_rate_at_a_price_of_its_own():
    agent = greedy_agent(prior="uniform", target_information_rate=1.0, learning_rate=1e-2)
    make_narrow(agent.policy)
    layer = agent.policy.network.layers[-1]
    with torch.no_grad():
        layer.bias[1, :, 2:] = 0.2  # the curious policy alone is wide
    before = copies([agent.log_temperature])[0]
    agent.update(random_transition(), ConstantBonus(0.0))
    assert agent.log_temperature[0] > before[0]
    assert agent.log_temperature[1] < before[1]
    assert agent.temperature == pytest.approx(agent.log_temperature[1].exp().item())
    greedy = agent.metrics()["greedy_temperature"].item()
    assert greedy == pytest.approx(agent.log_temperature[0].exp().item()) != agent.temperature


@pytest.mark.parametrize("options", [{"greedy_share": 0.0}, {"hunger": "random"}])
def test_without_a_greedy_policy_the_only_one_acts(options):
    agent, observation = CuriousSAC.default(3, 2, hidden_dim=8, **options), torch.randn(4, 3)
    assert not agent.has_greedy_policy and agent.greedy_share == 0
    centre = agent.act(observation, deterministic=True)
    assert agent.act(observation, deterministic=True, greedy=True).equal(centre)


def test_without_curiosity_there_is_no_greedy_policy():
    assert not small_agent(curiosity=False, greedy_share=0.25).has_greedy_policy


def test_a_greedy_share_that_would_do_nothing_is_refused():
    with pytest.raises(ValueError, match="`greedy_share` must be left out or 0"):
        CuriousSAC.default(3, 2, greedy_share=0.25, hunger="random")


@pytest.mark.parametrize(
    ("reward_std", "curiosity_std", "hunger", "share"),
    [
        (0.0, 0.0, 1.0, 0.25),  # before anything was learned
        (0.0, 2.0, 1.0, 0.25),  # no state is worth more than another
        (2.0, 2.0, 1.0, 0.25),
        (4.0, 3.5, 1.0, 0.25),
        (4.0, 2.0, 1.0, 0.5),
        (4.0, 2.0, 2.0, 0.75),  # the hungrier the sooner
        (4.0, 2.0, 0.5, 0.25),
        (4.0, 0.5, 0.0, 0.25),  # reward counts nothing
        (100.0, 1.0, 1.0, 0.95),  # the curious policy is never left aside
    ],
)
@pytest.mark.parametrize("curiosity_discount", [0.0, 0.5])
def test_greed_takes_over_where_reward_distinguishes_states(
    reward_std, curiosity_std, hunger, share, curiosity_discount
):
    agent = greedy_agent(hunger=hunger, curiosity_discount=curiosity_discount)
    agent.value_stds[:] = torch.tensor([reward_std, curiosity_std])
    assert agent.greedy_share == pytest.approx(share)
    assert agent.metrics()["greedy_share"].item() == pytest.approx(share)
    fixed = greedy_agent(adaptive_greedy_share=False)
    fixed.value_stds[:] = agent.value_stds
    assert fixed.greedy_share == 0.25


def test_a_larger_least_share_stays_the_least():
    agent = greedy_agent(greedy_share=0.97)
    agent.value_stds[:] = torch.tensor([4.0, 2.0])
    assert agent.greedy_share == pytest.approx(0.97)


@pytest.mark.parametrize("options", [{"greedy_share": 0.0}, {"hunger": "random"}])
def test_an_adaptive_share_of_no_greedy_policy_is_refused(options):
    with pytest.raises(ValueError, match="`adaptive_greedy_share` must be left out or False"):
        CuriousSAC.default(3, 2, adaptive_greedy_share=True, **options)


def test_a_learned_prior_is_the_marginal_of_the_curious_policy_and_not_of_the_greedy_one():
    agent = greedy_agent(prior="learned", learning_rate=1e-2)
    greedy, curious = torch.zeros(64, 2), torch.full((64, 2), 1.5)
    pre_action = torch.stack([greedy, curious]).unsqueeze(0)
    nothing = torch.zeros(1, 2, 64)
    for _ in range(300):
        agent._update_prior(PolicySample(pre_action, nothing, torch.ones(1, 2, 64)))
    with torch.no_grad():
        density = agent.prior.log_prob(torch.stack([greedy[0], curious[0]]))
    assert density[1] > density[0] + 2
