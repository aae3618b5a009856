import io
import math
import re
from copy import deepcopy

import numpy as np
import pytest
import torch
from torch.distributions import Independent, Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

from deep_curiosity.agent.config import TEMPERATURES, AgentConfig, ConditionedHunger
from deep_curiosity.agent.networks import LearnedPrior, UniformPrior
from deep_curiosity.agent.sac import CuriousSAC, sample_hunger
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.gaussians import DiagonalMixture
from deep_curiosity.schedules import Schedule
from deep_curiosity.speed.compile import seal_modules
from deep_curiosity.transitions import Sequences, Transition, as_sequences

TEMPERATURE, DISCOUNT = 0.3, 0.9
PAIRS = slice(0, 2), slice(2, 3)  # of the critics, reward and curiosity


class PushingBonus(Bonus):
    """Pays for the first coordinate of the action, in the direction of its sign."""

    def __init__(self, slope):
        super().__init__()
        self.register_buffer("slope", torch.tensor(slope))

    def forward(self, observation, action, next_observation=None):
        return self.slope * action[:, 0]

    def loss(self, transition):
        return self.slope.new_zeros((), requires_grad=True)

    def observe(self, transition, policy=None, visited=None):
        pass

    def metrics(self):
        return {}


def random_transition(batch=32):
    return Transition(
        observation=torch.randn(batch, 3),
        action=torch.rand(batch, 2) * 2 - 1,
        reward=torch.randn(batch),
        next_observation=torch.randn(batch, 3),
        terminated=torch.rand(batch) < 0.2,
        truncated=torch.rand(batch) < 0.2,
    )


def double(transition):
    return Transition(*(f.double() if f.is_floating_point() else f for f in transition))


PLAIN = {
    "hidden_dim": 16,
    "temperature": 1.0,
    "curiosity_coefficient": 1.0,
    "greedy_share": 0.0,
    "reward_steps": 1,
    "curiosity_steps": 1,
    "actor_q": "min",
    "actor_batch_fraction": 1.0,
    "learning_rate": 3e-4,
    "polyak": 0.005,
}
"""Soft actor-critic's own settings: formulas are tested without what the trainer adds."""


def small_agent(**options):
    return CuriousSAC.default(3, 2, **PLAIN | options)


def plain_agent(**options):
    return small_agent(curiosity=False, **options)


def members_of(network, members):
    return [parameter[members] for parameter in network.parameters()]


def equal(some, others):
    return all(one.equal(other) for one, other in zip(some, others, strict=True))


def copies(parameters):
    return [parameter.detach().clone() for parameter in parameters]


def let_answer(critics, *values):
    """Make the critics of each value answer a constant."""
    for parameter in critics.parameters():
        parameter.data.zero_()
    last = critics.network.layers[-1].bias.data
    last[:2] = values[0]
    last[2:] = torch.tensor(values[1:]).reshape(-1, 1, 1)


@pytest.fixture
def noise(monkeypatch):
    """Noise of one update, in order: at the next observation, then at the observation."""
    samples = torch.randn(2, 32, 2, dtype=torch.float64)
    queue = iter(samples)
    monkeypatch.setattr(
        torch, "randn_like", lambda like: next(queue)[: len(like)].to(like).unsqueeze(-2)
    )
    return samples


def assert_gradients(agent, part, expected, atol):
    """Compare an agent's first gradients, read off the means of Adam, with those of a module."""
    optimizer = agent.optimizers[part]
    for number, parameter in enumerate(expected):
        actual = getattr(optimizer, f"mean_{number}") / 0.1
        torch.testing.assert_close(actual, parameter.grad, atol=atol, rtol=0)


def only_component(policy):
    return policy.loc.squeeze(-2), 0.5 * policy.log_var.squeeze(-2)


def soft_actor_critic_policy(agent, observation, noise):
    """Reparameterised action and its log density, from torch's own distributions."""
    loc, log_std = only_component(agent.policy(observation))
    squash = TanhTransform(cache_size=1)
    policy = TransformedDistribution(Independent(Normal(loc, log_std.exp()), 1), squash)
    action = squash(loc + log_std.exp() * noise)
    return action, policy.log_prob(action)


def soft_actor_critic_critic_loss(agent, batch, noise):
    """Haarnoja et al. (2018), equations (5) and (6), with two critics."""
    with torch.no_grad():
        action, log_prob = soft_actor_critic_policy(agent, batch.next_observation, noise)
        first, second = agent.target_critics(batch.next_observation, action)[:2]
        soft_value = torch.min(first, second) - TEMPERATURE * log_prob
        target = batch.reward + DISCOUNT * (1 - batch.terminated.double()) * soft_value
    first, second = agent.critics(batch.observation, batch.action)[:2]
    half = torch.nn.functional.mse_loss
    return 0.5 * half(first, target) + 0.5 * half(second, target)


def soft_actor_critic_policy_loss(agent, critics, batch, noise, estimate=torch.min):
    """The same, equation (7)."""
    action, log_prob = soft_actor_critic_policy(agent, batch.observation, noise)
    first, second = critics(batch.observation, action)[:2]
    return (TEMPERATURE * log_prob - estimate(first, second)).mean(), log_prob


def alternate(first, second):
    """Even rows of the one, odd rows of the other."""
    return torch.where(torch.arange(len(first)) % 2 == 0, first, second)


def updated_pair(**options):
    """An agent that is plain soft actor-critic, a copy to update, and a batch in float64."""
    agent = plain_agent(temperature=TEMPERATURE, discount=DISCOUNT, **options).double()
    return agent, deepcopy(agent), double(random_transition())


def test_without_curiosity_the_critic_loss_is_that_of_soft_actor_critic(noise):
    before, agent, batch = updated_pair()
    metrics = agent.update(batch)
    expected = soft_actor_critic_critic_loss(before, batch, noise[0])
    assert metrics["critic_loss"].item() == pytest.approx(expected.item(), abs=1e-6)
    expected.backward()
    assert_gradients(agent, "critics", before.critics.parameters(), atol=1e-6)


def test_without_curiosity_the_policy_loss_is_that_of_soft_actor_critic(noise):
    before, agent, batch = updated_pair()
    metrics = agent.update(batch)
    expected, _ = soft_actor_critic_policy_loss(before, agent.critics, batch, noise[1])
    assert metrics["policy_loss"].item() == pytest.approx(expected.item(), abs=1e-6)
    expected.backward()
    assert_gradients(agent, "policy", before.policy.parameters(), atol=1e-6)


def test_without_curiosity_the_temperature_loss_is_that_of_soft_actor_critic(noise):
    before, agent, batch = updated_pair()
    agent.update(batch)
    _, log_prob = soft_actor_critic_policy_loss(before, agent.critics, batch, noise[1])
    target_entropy = -2.0
    expected = -(log_prob + target_entropy).mean()  # gradient in log alpha
    before.log_temperature.grad = expected.detach().unsqueeze(0)
    assert_gradients(agent, "temperature", [before.log_temperature], atol=1e-6)


def test_with_a_third_of_the_batch_the_actor_takes_every_third_row_and_the_critics_all(noise):
    before, agent, batch = updated_pair(actor_batch_fraction=1 / 3)
    taken = Transition(*(field[::3] for field in batch))
    metrics = agent.update(batch)
    evaluation = soft_actor_critic_critic_loss(before, batch, noise[0])
    improvement, log_prob = soft_actor_critic_policy_loss(
        before, agent.critics, taken, noise[1, :11]
    )
    assert metrics["critic_loss"].item() == pytest.approx(evaluation.item(), abs=1e-6)
    assert metrics["policy_loss"].item() == pytest.approx(improvement.item(), abs=1e-6)
    improvement.backward()
    assert_gradients(agent, "policy", before.policy.parameters(), atol=1e-6)
    before.log_temperature.grad = -(log_prob - 2.0).mean(0, keepdim=True).detach()
    assert_gradients(agent, "temperature", [before.log_temperature], atol=1e-6)


def test_alternating_critics_the_actor_maximises_one_and_they_learn_from_the_smaller(noise):
    before, agent, batch = updated_pair(actor_q="alternate")
    metrics = agent.update(batch)
    evaluation = soft_actor_critic_critic_loss(before, batch, noise[0])
    assert metrics["critic_loss"].item() == pytest.approx(evaluation.item(), abs=1e-6)

    improvement, _ = soft_actor_critic_policy_loss(
        before, agent.critics, batch, noise[1], estimate=alternate
    )
    assert metrics["policy_loss"].item() == pytest.approx(improvement.item(), abs=1e-6)
    improvement.backward()
    assert_gradients(agent, "policy", before.policy.parameters(), atol=1e-6)


def test_with_half_of_the_batch_every_row_keeps_its_own_hunger():
    agent, batch = conditioned_agent(actor_batch_fraction=0.5), random_transition(5)
    hunger, inputs = torch.linspace(0, 1, 5), []
    agent.policy.register_forward_pre_hook(lambda _, args: inputs.extend(args))
    policy_input = agent.policy_input(batch.observation, hunger)
    agent._update_actor(batch.observation, policy_input, PushingBonus(1.0), hunger)
    (policy_input,) = inputs
    assert policy_input[:, :3].equal(batch.observation[::2])
    assert policy_input[:, 3].equal(hunger[::2])


@pytest.mark.parametrize(
    "options", [{}, {"hunger": "random", "curiosity_coefficient": "adaptive"}]
)
def test_a_unit_far_from_one_makes_no_difference(options):
    options = {"normalize_observations": True, "prior": "learned"} | options
    small = torch.tensor([1e-2, 1.0, 400.0])
    agent = small_agent(**options).double()
    other = deepcopy(agent)
    for _ in range(3):
        batch = double(random_transition())
        batch = batch._replace(
            observation=small * batch.observation, next_observation=small * batch.next_observation
        )
        unit = torch.tensor([0.2, 1.0, 30.0])
        changed = batch._replace(
            observation=unit * batch.observation, next_observation=unit * batch.next_observation
        )
        seed = torch.random.initial_seed()
        torch.manual_seed(seed)
        metrics = agent.update(batch, ConstantBonus(1.0).double())
        torch.manual_seed(seed)
        of_changed = other.update(changed, ConstantBonus(1.0).double())
        torch.testing.assert_close(metrics, of_changed, rtol=1e-6, atol=1e-8)
    action = agent.act(batch.observation, deterministic=True, hunger=0.5)
    of_changed = other.act(changed.observation, deterministic=True, hunger=0.5)
    torch.testing.assert_close(action, of_changed, rtol=0, atol=1e-8)
    assert not torch.allclose(action, other.act(batch.observation, deterministic=True, hunger=0.5))


def test_what_is_seen_is_brought_to_the_size_of_the_batches_of_late():
    agent = plain_agent()
    size = torch.tensor([0.01, 1.0, 100.0])
    batches = [size * random_transition().observation for _ in range(3)]
    for batch in batches:
        agent.update(random_transition()._replace(observation=batch))
    square = torch.cat(batches).square().mean(0)
    torch.testing.assert_close(agent.observation_scaling.square, square)
    seen = agent.policy_input(torch.cat(batches))
    expected = torch.tensor([0.1, square[1].sqrt(), 10.0])
    torch.testing.assert_close(seen.square().mean(0).sqrt(), expected)
    assert seen[:, 1].equal(torch.cat(batches)[:, 1])
    observation = torch.randn(4, 3)
    assert plain_agent(normalize_observations=False).policy_input(observation) is observation


def test_a_bonus_that_is_maximised_itself_is_given_observations_as_they_are():
    given = []

    def bonus(observation, action, next_observation=None):
        given.append(observation)
        return action.sum(-1)

    batch = random_transition()
    agent = small_agent(
        normalize_observations=True, curiosity_discount=0.0, policy_mixture_components=2
    )
    agent.update(batch, bonus)
    assert given[-1].equal(batch.observation.repeat(2, 1))


def test_log_density_agrees_with_stable_baselines3():
    distributions = pytest.importorskip("stable_baselines3.common.distributions")
    agent, observation = plain_agent(), torch.randn(64, 3)
    policy = agent.policy(observation)
    pre_action = policy.sample().clamp(-2, 2)  # it adds 1e-6 in the log
    witness = distributions.SquashedDiagGaussianDistribution(2)
    witness.proba_distribution(*only_component(policy))
    expected = witness.log_prob(torch.tanh(pre_action), pre_action)
    actual = policy.log_prob(pre_action) - agent.prior.log_prob(pre_action)
    torch.testing.assert_close(actual, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("terminated", "truncated", "target"),
    [(False, False, 10.0), (False, True, 10.0), (True, False, 1.0), (True, True, 1.0)],
)
def test_truncation_bootstraps_and_termination_does_not(terminated, truncated, target):
    agent = plain_agent(discount=DISCOUNT, soft_backup=False)
    let_answer(agent.critics, 0.0)
    let_answer(agent.target_critics, 10.0)
    batch = random_transition(1)._replace(
        reward=torch.ones(1),
        terminated=torch.tensor([terminated]),
        truncated=torch.tensor([truncated]),
    )
    loss = agent.update(batch)["critic_loss"]  # two critics, each half of the target squared
    assert loss.sqrt().item() == pytest.approx(target)


def test_curiosity_is_discounted_by_its_own_discount():
    agent = small_agent(discount=0.9, curiosity_discount=0.5, soft_backup=False)
    let_answer(agent.critics, 0.0, 0.0)
    let_answer(agent.target_critics, 10.0, 4.0)
    batch = random_transition(1)._replace(
        reward=torch.ones(1), terminated=torch.tensor([False]), truncated=torch.tensor([True])
    )
    loss = agent.update(batch, ConstantBonus(0.25))["critic_loss"]
    assert loss.item() == pytest.approx((1 + 0.9 * 10) ** 2 + 0.5 * (0.25 + 0.5 * 4) ** 2)


def test_soft_backup_charges_the_extrinsic_value_only():
    batch = random_transition(1)._replace(terminated=torch.tensor([False]))
    agents = []
    for soft_backup in (False, True):
        torch.manual_seed(0)
        agents.append(small_agent(soft_backup=soft_backup, temperature=100.0))
        agents[-1].update(batch, ConstantBonus(1.0))
    extrinsic, curious = ([members_of(one.critics, pair) for one in agents] for pair in PAIRS)
    assert equal(*curious) and not equal(*extrinsic)


@pytest.mark.parametrize(("prior", "soft"), [("uniform", True), ("learned", False)])
def test_value_is_purely_about_reward_by_default_where_the_prior_is_learned(prior, soft):
    losses = []
    for temperature in (0.1, 10.0):
        torch.manual_seed(0)
        agent = plain_agent(prior=prior, temperature=temperature)
        losses.append(agent.update(random_transition())["critic_loss"].item())
    assert (losses[0] != losses[1]) == soft


@pytest.mark.parametrize("prior", ["uniform", "learned"])
def test_the_value_of_a_curious_agent_is_purely_about_reward_by_default(prior):
    losses = []
    for temperature in (0.1, 10.0):
        torch.manual_seed(0)
        agent = small_agent(prior=prior, temperature=temperature)
        losses.append(agent.update(random_transition(), ConstantBonus(0.0))["critic_loss"].item())
    assert losses[0] == losses[1]


def targets_of(agent, sequences, bonus, hunger):
    """Targets of reward's value and of curiosity's."""
    return agent._targets(sequences, agent._rewards(sequences, bonus), hunger)


def updated(agent, batch, bonus=None):
    """A copy of the agent after one update with the same random numbers."""
    agent = deepcopy(agent)
    torch.manual_seed(7)
    agent.update(batch, bonus)
    return agent


def test_the_reward_critic_ignores_the_bonus():
    agent, batch = small_agent(), random_transition()
    one, other = (updated(agent, batch, ConstantBonus(value)) for value in (0.0, 100.0))
    extrinsic, curious = PAIRS
    assert equal(members_of(one.critics, extrinsic), members_of(other.critics, extrinsic))
    assert not equal(members_of(one.critics, curious), members_of(other.critics, curious))


def test_the_curiosity_critic_ignores_the_reward():
    agent, batch = small_agent(), random_transition()
    bonus = ConstantBonus(1.0)
    one = updated(agent, batch, bonus)
    other = updated(agent, batch._replace(reward=batch.reward + 100), bonus)
    extrinsic, curious = PAIRS
    assert equal(members_of(one.critics, curious), members_of(other.critics, curious))
    assert not equal(members_of(one.critics, extrinsic), members_of(other.critics, extrinsic))


@pytest.mark.parametrize("curiosity_discount", [0.0, 0.5])
@pytest.mark.parametrize("slope", [-10.0, 10.0])
def test_a_large_bonus_on_one_action_moves_the_policy_toward_it(curiosity_discount, slope):
    agent = small_agent(
        prior="uniform",
        curiosity_discount=curiosity_discount,
        learning_rate=1e-2,
        temperature="constant:1",
    )
    bonus = PushingBonus(slope)
    for _ in range(120):
        agent.update(random_transition(64), bonus)
    action = agent.act(torch.randn(64, 3), deterministic=True)
    assert (action[:, 0] * math.copysign(1, slope)).min() > 0.5
    assert action[:, 1].abs().mean() < 0.5  # the other coordinate earns nothing


def test_without_curiosity_critic_the_gradient_of_the_bonus_reaches_the_actor_at_once():
    agent, batch = small_agent(curiosity_discount=0.0), random_transition()
    still, pushed = (updated(agent, batch, PushingBonus(slope)) for slope in (0.0, 1_000.0))
    still_slope, slope = (
        one.optimizers["policy"].mean_5[0, 0, 0] / 0.1 for one in (still, pushed)
    )
    assert slope < -10 < 10 * still_slope  # of the loss, in the last bias
    mean = [one.act(batch.observation, deterministic=True)[:, 0].mean() for one in (still, pushed)]
    assert mean[1] > mean[0]


def test_a_constant_bonus_moves_nothing_where_no_critic_learns_it():
    agents = []
    for value in (0.0, 1_000.0):
        torch.manual_seed(0)
        agent = small_agent(curiosity_discount=0.0)
        for _ in range(5):
            agent.update(random_transition(), ConstantBonus(value))
        agents.append(agent)
    one, other = (agent.state_dict() for agent in agents)
    assert all(one[name].equal(other[name]) for name in one if isinstance(one[name], torch.Tensor))


def test_a_constant_bonus_does_not_push_the_policy_either_way():
    agent = small_agent(
        prior="uniform", curiosity_discount=0.5, learning_rate=1e-2, temperature="constant:1"
    )
    for _ in range(120):
        agent.update(random_transition(64), ConstantBonus(10.0))
    action = agent.act(torch.randn(256, 3), deterministic=True)
    assert action.mean(0).abs().max() < 0.5


def actor_terms(agent, batch, noise, critics):
    """Information cost and values of the actions that an update samples."""
    with torch.no_grad():
        policy = agent.policy(batch.observation)
        pre_action = policy.component_samples(noise.unsqueeze(-2)).squeeze(-2)
        cost = policy.log_prob(pre_action) - agent.prior.log_prob(pre_action)
        return cost.mean(), critics.lower(batch.observation, torch.tanh(pre_action)).mean(-1)


@pytest.mark.parametrize("prior", ["uniform", "learned"])
@pytest.mark.parametrize(("hunger", "temperature"), [(1.0, 1.0), (0.0, 0.5), (2.5, 0.01)])
def test_hunger_and_temperature_change_the_actor_loss_as_the_formula_says(
    prior, hunger, temperature, noise
):
    agent = small_agent(prior=prior).double()
    agent.hunger, agent.temperature = hunger, temperature
    batch, before = double(random_transition()), deepcopy(agent)
    metrics = agent.update(batch, PushingBonus(1.0).double())
    cost, value = actor_terms(before, batch, noise[1], agent.critics)
    expected = temperature * cost - hunger * value[0] - value[1]
    assert metrics["policy_loss"].item() == pytest.approx(expected.item(), abs=1e-6)


@pytest.mark.parametrize(("stds", "coefficient"), [((4.0, 1.0), 0.25), ((1.0, 4.0), 1.0)])
def test_the_adaptive_coefficient_is_the_ratio_of_standard_deviations_at_most_one(
    stds, coefficient
):
    agent = small_agent(curiosity_coefficient="adaptive")
    agent.value_stds.copy_(torch.tensor(stds))
    assert agent.curiosity_coefficient == coefficient
    assert agent.metrics()["curiosity_coefficient"] == coefficient


@pytest.mark.parametrize(
    ("hunger", "coefficient"), [(0.0, 1.0), (0.25, 1.0), (1.0, 0.5), (2.0, 0.25), (10.0, 0.05)]
)
def test_the_hungrier_the_agent_the_sooner_curiosity_yields(hunger, coefficient):
    agent = small_agent(curiosity_coefficient="adaptive", hunger=hunger)
    agent.value_stds.copy_(torch.tensor([2.0, 1.0]))
    assert agent.curiosity_coefficient == pytest.approx(coefficient)


def test_without_a_discount_the_bonus_itself_yields():
    agent = small_agent(curiosity_coefficient="adaptive", curiosity_discount=0.0)
    batch = random_transition()._replace(reward=100 * torch.randn(32))
    for _ in range(3):
        agent.update(batch, PushingBonus(0.1))
    assert agent.value_stds.shape == (2,) and 0 < agent.value_stds[1] < 0.1
    agent.value_stds[0] = 4 * agent.value_stds[1]
    assert agent.curiosity_coefficient == pytest.approx(0.25)


def test_normalised_layers_bound_what_is_extrapolated_of_reward_and_not_of_curiosity():
    agent = small_agent(critic_layer_norm=True)
    near, far = (scale * torch.ones(1, 3) for scale in (1e3, 1e6))
    action = torch.zeros(1, 2)
    (*close, further), (*distant, furthest) = (
        agent.critics(near, action),
        agent.critics(far, action),
    )
    torch.testing.assert_close(close, distant, rtol=1e-2, atol=1e-2)
    assert (furthest / further).item() == pytest.approx(1e3, rel=0.1)
    for critics, expected in (
        (agent.critics.of_others(far, action)[0], furthest),
        (agent.critics.of_reward(far, action), torch.stack(distant).amin(0)),
        (agent.critics.of_reward(far, action, alternate=True), distant[0]),
    ):
        torch.testing.assert_close(critics, expected)


def test_normalised_critics_of_reward_begin_near_zero_and_that_of_curiosity_as_usual():
    observation, action = torch.randn(64, 3), torch.rand(64, 2) * 2 - 1
    normalised, usual = (
        small_agent(critic_layer_norm=layer_norm).critics(observation, action).std(-1).tolist()
        for layer_norm in (True, False)
    )
    assert max(normalised[:2]) < 0.01 < min(normalised[2], *usual)


def test_without_normalised_layers_critics_of_reward_extrapolate():
    agent = small_agent(critic_layer_norm=False)
    near, far = (
        agent.critics(scale * torch.ones(1, 3), torch.zeros(1, 2)) for scale in (1e3, 1e6)
    )
    assert (far / near).flatten().tolist() == pytest.approx([1e3] * 3, rel=0.1)


def test_the_coefficient_weighs_the_curiosity_value_in_the_actor():
    agent, batch = small_agent(curiosity_coefficient="adaptive"), random_transition()
    agent.value_stds.copy_(torch.tensor([4.0, 1.0]))
    action = batch.action[None, None]  # of the only component of the only policy
    ((value,),), ((curiosity_value,),) = agent._values(
        batch.observation, batch.observation, action, PushingBonus(1.0), torch.ones(())
    )
    lower = agent.critics.lower(batch.observation, batch.action)
    torch.testing.assert_close((value, curiosity_value), (lower[0], 0.25 * lower[1]))


def test_a_fixed_coefficient_does_not_adapt():
    agent = small_agent(curiosity_coefficient=1.0)
    agent.value_stds.copy_(torch.tensor([4.0, 1.0]))
    assert agent.curiosity_coefficient == 1


def test_standard_deviations_follow_the_values_over_the_batch():
    agent, batch = small_agent(curiosity_coefficient="adaptive"), random_transition()
    value = agent.critics(batch.observation, batch.action).detach()
    agent.update(batch, ConstantBonus(1.0))
    value = torch.stack([value[:2].mean(0), value[2]])
    torch.testing.assert_close(agent.value_stds, 0.01 * value.std(-1, correction=0))
    torch.testing.assert_close(agent.curiosity_mean, 0.01 * value[1].mean())


def test_the_curiosity_value_is_relative_to_its_mean_and_an_end_is_worth_as_much():
    """Relative value iteration: a constant bonus above zero does not pile up."""
    agent = small_agent(hidden_dim=16, learning_rate=3e-3, polyak=0.05, prior="learned")
    batch = random_transition(32)
    for _ in range(400):
        metrics = agent.update(batch, ConstantBonus(1.0))
    value = agent.critics(batch.observation, batch.action)[2]
    assert metrics["curiosity_value"].item() == pytest.approx(1.0, abs=0.1)
    assert value[batch.terminated].mean().item() == pytest.approx(1.0, abs=0.2)


def test_with_zero_discount_the_actor_maximises_the_bonus_itself(noise):
    agent = small_agent(curiosity_discount=0.0).double()
    batch, before = double(random_transition()), deepcopy(agent)
    metrics = agent.update(batch, PushingBonus(3.0).double())
    cost, value = actor_terms(before, batch, noise[1], agent.critics)
    with torch.no_grad():
        policy = before.policy(batch.observation)
        action = torch.tanh(policy.component_samples(noise[1].unsqueeze(-2))).squeeze(-2)
    expected = cost - value[0] - 3 * action[:, 0].mean()
    assert metrics["policy_loss"].item() == pytest.approx(expected.item(), abs=1e-6)


def test_with_zero_discount_there_are_critics_of_reward_alone():
    assert small_agent(curiosity_discount=0.0).critics.network.members == 2
    assert small_agent(curiosity_discount=0.5).critics.network.members == 3
    assert plain_agent().critics.network.members == 2


def test_hunger_and_temperature_read_back_what_was_set():
    agent = small_agent(hunger=0.5, temperature=0.2)
    assert (agent.hunger, agent.temperature) == pytest.approx((0.5, 0.2))
    agent.hunger, agent.temperature = 0.0, 3.0
    assert (agent.hunger, agent.temperature) == pytest.approx((0.0, 3.0))
    assert agent.update(random_transition(), ConstantBonus(0.0))["temperature"] == pytest.approx(3)


@pytest.mark.parametrize("prior", ["uniform", "learned"])
@pytest.mark.parametrize(("target", "sign"), [(1e-3, 1), (20.0, -1)])
def test_a_tuned_temperature_rises_while_the_rate_is_above_target(prior, target, sign):
    agent = plain_agent(prior=prior, target_information_rate=target)
    prices = [agent.temperature]
    for _ in range(3):
        rate = agent.update(random_transition())["information_rate"].item()
        assert (rate - target) * sign > 0
        prices.append(agent.temperature)
    assert prices == sorted(prices, reverse=sign < 0) and len(set(prices)) == 4


@pytest.mark.parametrize("curiosity_discount", [0.0, 0.9])
@pytest.mark.parametrize("prior", ["uniform", "learned"])
@pytest.mark.parametrize(("target", "end"), [(1e-9, 1), (20.0, 0)])
def test_a_rate_out_of_reach_holds_the_temperature_where_float32_has_its_terms(
    prior, target, end, curiosity_discount
):
    agent = small_agent(
        prior=prior,
        target_information_rate=target,
        temperature=TEMPERATURES[end],
        curiosity_discount=curiosity_discount,
    )
    for _ in range(30):
        metrics = agent.update(random_transition(), ConstantBonus(0.1))
        assert all(value.isfinite() for value in metrics.values())
    assert agent.temperature == pytest.approx(TEMPERATURES[end], rel=1e-5)
    assert all(parameter.isfinite().all() for parameter in agent.parameters())


def test_a_temperature_comes_back_from_where_it_was_held():
    agent = plain_agent(target_information_rate=20.0, temperature=TEMPERATURES[1])
    for _ in range(5):
        agent.update(random_transition())
    assert 0 < agent.temperature < 0.999 * TEMPERATURES[1]


def test_a_fixed_temperature_stays():
    agent = plain_agent(temperature="constant:0.2")
    agent.update(random_transition())
    assert agent.temperature == pytest.approx(0.2)


@pytest.mark.parametrize("prior", ["uniform", "learned"])
def test_default_target_is_the_usual_entropy_whatever_the_prior(prior):
    agent = plain_agent(prior=prior)
    entropy_from_uniform = 2 * math.log(2) - agent.target_information_rate
    assert entropy_from_uniform == pytest.approx(-2)


def test_information_rate_is_counted_from_a_normalised_prior(noise):
    agent = plain_agent().double()
    batch, before = double(random_transition()), deepcopy(agent)
    rate = agent.update(batch)["information_rate"].item()
    _, log_prob = soft_actor_critic_policy(before, batch.observation, noise[1])
    assert rate == pytest.approx(log_prob.mean().item() + 2 * math.log(2), abs=1e-6)


def test_information_rate_counts_from_the_learned_prior(noise):
    agent = plain_agent(prior="learned").double()
    batch, before = double(random_transition()), deepcopy(agent)
    rate = agent.update(batch)["information_rate"].item()
    cost, _ = actor_terms(before, batch, noise[1], agent.critics)
    assert rate == pytest.approx(cost.item(), abs=1e-6)


def test_the_prior_is_learned_by_default_where_there_is_a_bonus():
    assert isinstance(small_agent().prior, LearnedPrior)
    assert isinstance(small_agent(prior="uniform").prior, UniformPrior)
    assert isinstance(plain_agent().prior, UniformPrior)
    assert isinstance(plain_agent(prior="learned").prior, LearnedPrior)


def test_a_learned_prior_learns_the_actions_of_the_policy():
    agent = plain_agent(prior="learned", learning_rate=1e-2)
    agent.optimizers["policy"].learning_rate = 0.0  # so that there is one thing to learn
    agent.policy.network.layers[-1].bias.data[..., :2] = 1.5
    log_prob = [agent.update(random_transition())["prior_log_prob"].item() for _ in range(150)]
    assert sum(log_prob[-10:]) > sum(log_prob[:10]) + 5
    centre = agent.prior.log_prob(torch.full((1, 2), 1.5))
    assert centre > agent.prior.log_prob(torch.full((1, 2), -1.5))


def test_the_prior_is_pulled_by_its_own_loss_alone(noise):
    agent = plain_agent(prior="learned").double()
    batch, before = double(random_transition()), deepcopy(agent)
    agent.update(batch)
    policy = before.policy(batch.observation)
    pre_action = policy.component_samples(noise[1].unsqueeze(-2)).squeeze(-2).detach()
    (-before.prior.log_prob(pre_action).mean()).backward()
    assert_gradients(agent, "prior", before.prior.parameters(), atol=1e-8)


def test_divergence_of_the_learned_prior_from_uniform_is_reported():
    agent = plain_agent(prior="learned")
    agent.prior.raw_loc.data.fill_(4.0)  # a strong habit
    random_state = torch.get_rng_state()
    divergence = agent.metrics()["prior_kl_to_uniform"]
    assert torch.get_rng_state().equal(random_state)
    expected = agent.prior.kl_to_uniform(torch.randn(20_000, 2)).item()
    assert divergence.item() == pytest.approx(expected, rel=0.1) and not divergence.requires_grad
    assert plain_agent(prior="uniform").metrics().keys() == {"hunger"}


def test_targets_move_by_exactly_the_share():
    agent = small_agent(polyak=0.25)
    targets = copies(agent.target_critics.parameters())
    agent.update(random_transition(), ConstantBonus(1.0))
    sources = copies(agent.critics.parameters())
    expected = [0.75 * old + 0.25 * new for old, new in zip(targets, sources, strict=True)]
    for actual, wanted in zip(agent.target_critics.parameters(), expected, strict=True):
        torch.testing.assert_close(actual.data, wanted)
    moved = zip(targets, agent.target_critics.parameters(), strict=True)
    assert all(not old.equal(new) for old, new in moved)


def test_target_critics_start_as_the_critics_and_get_no_gradient():
    agent = small_agent()
    assert equal(agent.critics.parameters(), agent.target_critics.parameters())
    agent.update(random_transition(), ConstantBonus(1.0))
    for parameter in agent.target_critics.parameters():
        assert parameter.grad is None and not parameter.requires_grad


@pytest.mark.parametrize("options", [{}, {"prior": "learned"}, {"curiosity_discount": 0.0}])
def test_every_part_is_trained(options):
    agent = small_agent(**options)
    before = {name: copies([value])[0] for name, value in agent.named_parameters()}
    for _ in range(2):
        agent.update(random_transition(), PushingBonus(1.0))
    for name, value in agent.named_parameters():
        assert not value.equal(before[name]), name


def test_the_update_changes_neither_transition_nor_bonus():
    agent, batch, bonus = small_agent(), random_transition(), PushingBonus(1.0)
    kept = copies(batch)
    agent.update(batch, bonus)
    assert equal(batch, kept) and bonus.slope == 1


def assert_same_state(one, other):
    one, other = one.state_dict(), other.state_dict()
    assert one.keys() == other.keys()
    for name in one:  # an adaptive coefficient is kept as NaN
        torch.testing.assert_close(one[name], other[name], rtol=0, atol=0, equal_nan=True)


def train(agent, steps, seed):
    torch.manual_seed(seed)
    for _ in range(steps):
        agent.update(random_transition(), PushingBonus(1.0))


@pytest.mark.parametrize("prior", ["uniform", "learned"])
def test_an_interrupted_agent_goes_on_bit_for_bit(prior):
    agent, resumed = small_agent(prior=prior), small_agent(prior=prior)
    train(agent, 5, seed=1)
    file = io.BytesIO()
    torch.save(agent.state_dict(), file)
    train(agent, 5, seed=2)
    file.seek(0)
    resumed.load_state_dict(torch.load(file))
    train(resumed, 5, seed=2)
    assert_same_state(agent, resumed)


def test_an_agent_restored_from_another_shares_nothing_with_it():
    agent, restored = small_agent(), small_agent()
    train(agent, 3, seed=1)
    restored.load_state_dict(agent.state_dict())
    kept = deepcopy(restored)
    train(agent, 3, seed=2)
    assert_same_state(restored, kept)


@pytest.mark.parametrize("options", [{}, {"temperature": "constant:0.1"}, {"prior": "learned"}])
def test_an_agent_goes_on_from_parameters_that_were_assigned_to_it(options):
    agent, resumed = small_agent(**options), small_agent(**options)
    train(agent, 3, seed=1)
    resumed.load_state_dict(deepcopy(agent.state_dict()), assign=True)
    for one in (agent, resumed):
        train(one, 3, seed=2)
    assert_same_state(agent, resumed)


def test_parameters_are_not_assigned_to_an_agent_whose_update_is_compiled():
    agent = small_agent()
    state = deepcopy(agent.state_dict())
    seal_modules(agent)
    agent.load_state_dict(state)
    with pytest.raises(AttributeError, match="`targets` of this Adam is part of a compiled"):
        agent.load_state_dict(state, assign=True)


def test_the_same_seed_trains_the_same_agent():
    agents = []
    for _ in range(2):
        torch.manual_seed(0)
        agents.append(small_agent(prior="learned"))
        train(agents[-1], 3, seed=1)
    assert_same_state(*agents)


def test_metrics_are_detached_scalars_whatever_the_switches():
    for options in ({}, {"curiosity_discount": 0.0}, {"prior": "learned"}):
        metrics = small_agent(**options).update(random_transition(), PushingBonus(1.0))
        for name, value in metrics.items():
            assert value.shape == () and not value.requires_grad and value.isfinite(), name


def test_metrics_keep_their_values():
    """A logger may write them later, when the agent has learned more."""
    agent = small_agent(learning_rate=0.1)
    metrics = agent.update(random_transition(), PushingBonus(1.0))
    before = {name: value.item() for name, value in metrics.items()}
    agent.update(random_transition(), PushingBonus(1.0))
    assert {name: value.item() for name, value in metrics.items()} == before


def test_actions_lie_in_the_box_and_follow_the_seed():
    agent, observation = small_agent(), torch.randn(100, 3) * 10
    torch.manual_seed(1)
    action = agent.act(observation)
    torch.manual_seed(1)
    assert agent.act(observation).equal(action)
    assert action.shape == (100, 2) and action.abs().max() <= 1 and not action.requires_grad
    assert not agent.act(observation).equal(action)


def test_a_deterministic_action_is_the_centre_of_the_policy():
    agent, observation = small_agent(), torch.randn(9, 3)
    random_state = torch.get_rng_state()
    action = agent.act(observation, deterministic=True)
    torch.testing.assert_close(action, agent.policy(observation).loc[:, 0].detach().tanh())
    assert torch.get_rng_state().equal(random_state)


class FixedPolicy(torch.nn.Module):
    """The same mixture at every observation."""

    def __init__(self, loc, weight):
        super().__init__()
        self.loc, self.weight = torch.tensor(loc), torch.tensor(weight)

    def forward(self, observation, policy=None):
        loc = self.loc.expand(len(observation), -1, -1)
        log_weight = self.weight.log().expand(len(observation), -1)
        return DiagonalMixture(loc, torch.zeros_like(loc), log_weight)


def test_a_deterministic_action_is_the_squashed_centre():
    agent = small_agent()
    agent.policy = FixedPolicy([[0.5, -30.0]], [1.0])
    action = agent.act(torch.randn(1, 3), deterministic=True)
    torch.testing.assert_close(action, torch.tensor([[math.tanh(0.5), -1.0]]))


@pytest.mark.parametrize(("weight", "centre"), [(0.3, -2.0), (0.7, 1.0)])
def test_a_deterministic_action_is_the_centre_of_the_weightiest_component(weight, centre):
    agent = CuriousSAC.default(3, 1, **PLAIN)
    agent.policy = FixedPolicy([[-2.0], [1.0]], [1 - weight, weight])
    action = agent.act(torch.randn(1, 3), deterministic=True)
    torch.testing.assert_close(action, torch.tensor([[math.tanh(centre)]]))


def test_an_observation_of_wrong_length_is_rejected():
    with pytest.raises(ValueError, match=r"`observation` must have shape \(batch, 3\)"):
        small_agent().act(torch.zeros(1, 4))


def test_a_missing_bonus_is_rejected():
    with pytest.raises(ValueError, match="`bonus`"):
        small_agent().update(random_transition())


def test_a_bonus_for_an_agent_without_curiosity_is_rejected():
    with pytest.raises(ValueError, match="`bonus`"):
        plain_agent().update(random_transition(), ConstantBonus(1.0))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("discount", 1.0),
        ("discount", -0.1),
        ("discount", math.nan),
        ("curiosity_discount", 1.1),
        ("hunger", -1.0),
        ("hunger", math.inf),
        ("temperature", 0.0),
        ("temperature", math.nan),
        ("learning_rate", 0.0),
        ("polyak", 0.0),
        ("polyak", 1.5),
        ("actor_batch_fraction", 0.0),
        ("actor_batch_fraction", 0.4),
        ("target_information_rate", math.nan),
        ("target_information_rate", 0.0),
        ("target_information_rate", -3.0),
        ("target_information_rate", 20.5),
        ("temperature", 1e-11),
        ("temperature", "linear:1:1e11"),
        ("hunger", 1e7),
        ("hunger", "linear:1:1e7"),
        ("learning_rate", 1e-10),
        ("curiosity_coefficient", 1e7),
    ],
)
def test_what_is_out_of_range_is_rejected_by_name_and_value(name, value):
    shown = re.escape(str(float(str(value).rpartition(":")[2])))
    with pytest.raises(ValueError, match=rf"`{name}`.*got {shown}"):
        small_agent(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("hunger", -1.0),
        ("hunger", 1e39),
        ("temperature", 0.0),
        ("temperature", 1e-300),
        ("temperature", 1e300),
    ],
)
def test_hunger_and_temperature_set_out_of_range_are_rejected_and_stay(name, value):
    agent = small_agent()
    with pytest.raises(ValueError, match=rf"`{name}`.*got {re.escape(str(value))}"):
        setattr(agent, name, value)
    assert getattr(agent, name) == 1


def test_an_unknown_prior_is_rejected():
    with pytest.raises((ValueError, TypeError), match="prior"):
        small_agent(prior="habit")


def test_the_gradient_of_a_policy_of_two_components_is_that_of_its_expectation():
    agent = small_agent(policy_mixture_components=2, prior="learned", temperature=0.3).double()
    batch, before = double(random_transition()), deepcopy(agent)
    torch.manual_seed(1)
    agent.update(batch, PushingBonus(1.0).double())
    with torch.random.fork_rng():
        torch.manual_seed(1)
        before.policy(batch.next_observation).sample()  # what the critics' targets take
        policy = before.policy(batch.observation)
        noise = torch.randn_like(policy.loc)
    loss = 0.0
    points = policy.component_samples(noise).transpose(0, 1)
    for point, weight in zip(points, policy.log_weight.exp().mT, strict=True):
        cost = policy.log_prob(point) - before.prior.log_prob(point)
        value, curiosity_value = agent.critics.lower(batch.observation, torch.tanh(point))
        loss = loss + (weight * (0.3 * cost - value - curiosity_value)).mean()
    loss.backward()
    assert_gradients(agent, "policy", before.policy.parameters(), atol=1e-8)


@pytest.mark.slow
def test_a_policy_of_two_components_keeps_two_ways_apart():
    class Either(PushingBonus):
        """Pays for an action far from the middle, on either side."""

        def forward(self, observation, action, next_observation=None):
            return self.slope * action[:, 0].abs()

    agent = small_agent(
        prior="uniform",
        policy_mixture_components=2,
        curiosity_discount=0.0,
        hunger=0.0,
        temperature="constant:0.05",
        learning_rate=1e-2,
    )
    bias = agent.policy.network.layers[-1].bias.data
    bias[..., 0], bias[..., 4] = -1.0, 1.0  # the first coordinate of each component's mean
    bonus = Either(1.0)
    for _ in range(300):
        agent.update(random_transition(), bonus)
    action = agent.act(torch.randn(2_000, 3))[:, 0]
    assert (action.abs() > 0.8).float().mean() > 0.9
    assert 0.2 < (action > 0).float().mean() < 0.8


def conditioned_agent(**options):
    return small_agent(
        **{"hunger": "conditioned:1", "curiosity_coefficient": "adaptive"} | options
    )


def test_where_conditioned_policy_and_critics_are_given_the_hunger_and_nothing_else_changes():
    agent = conditioned_agent()
    observation = torch.randn(4, 3)
    policy_input = agent.policy_input(observation, torch.tensor([0.0, 0.25, 0.5, 1.0]))
    assert policy_input[:, :3].equal(observation)
    assert policy_input[:, 3].tolist() == [0.0, 0.25, 0.5, 1.0]
    agent.hunger = 0.75
    assert agent.policy_input(observation)[:, 3].tolist() == [0.75] * 4
    assert small_agent(normalize_observations=False).policy_input(observation) is observation


def test_hunger_must_be_one_number_or_one_for_each():
    with pytest.raises(ValueError, match=r"`hunger` must be one number or 4, got shape \(1,\)"):
        conditioned_agent().policy_input(torch.randn(4, 3), torch.tensor([0.5]))


@pytest.mark.parametrize(
    ("hunger", "error", "message"),
    [
        (math.nan, ValueError, r"`hunger` must lie in \[0, 1\] where conditioned, got nan"),
        (7.0, ValueError, r"`hunger` must lie in \[0, 1\] where conditioned, got 7.0"),
        (torch.tensor([0.5, -1.0]), ValueError, r"`hunger` must lie in .*, got -1.0"),
        ([0.5, math.inf], ValueError, r"`hunger` must lie in .*, got inf"),
        ([0.5] * 3, ValueError, r"`hunger` must be one number or 2, got shape \(3,\)"),
        ("half", TypeError, "`hunger` must be a number, or one for each .*, got 'half'"),
    ],
)
def test_a_hunger_to_act_by_that_is_none_is_refused(hunger, error, message):
    with pytest.raises(error, match=message):
        conditioned_agent().act(torch.randn(2, 3), hunger=hunger)


def test_a_hunger_to_act_by_is_a_number_an_array_or_a_tensor():
    agent, observation = conditioned_agent(), torch.randn(2, 3)
    for hunger in (0.25, np.array([0.25, 0.25]), [0.25, 0.25], torch.full((2,), 0.25).double()):
        action = agent.act(observation, deterministic=True, hunger=hunger)
        assert action.dtype == torch.float32
        assert action.equal(agent.act(observation, deterministic=True, hunger=torch.tensor(0.25)))
    assert not action.equal(agent.act(observation, deterministic=True))


def test_an_agent_that_is_not_conditioned_leaves_the_hunger_aside():
    agent, observation = small_agent(), torch.randn(2, 3)
    action = agent.act(observation, deterministic=True)
    assert agent.act(observation, deterministic=True, hunger=torch.tensor(7.0)).equal(action)


def test_relabelled_hungers_cover_the_range_with_both_its_ends():
    hunger = sample_hunger(torch.zeros(4_000))
    assert hunger.min() == 0 and hunger.max() == 1
    for end in (0.0, 1.0):
        assert (hunger == end).double().mean().item() == pytest.approx(0.25, abs=0.03)
    inner = hunger[(hunger > 0) & (hunger < 1)]
    assert inner.mean().item() == pytest.approx(0.5, abs=0.03)


def test_where_conditioned_reward_and_curiosity_weigh_in_units_of_their_standard_deviation():
    agent = conditioned_agent()
    hunger = torch.tensor([0.0, 0.5, 1.0])
    agent.value_stds.copy_(torch.tensor([8.0, 2.0]))
    assert agent._coefficient(hunger).tolist() == [4.0, 2.0, 0.0]
    agent.value_stds.copy_(torch.tensor([0.5, 2.0]))  # little reward is not blown up
    assert agent._coefficient(hunger).tolist() == [1.0, 0.5, 0.0]


@pytest.mark.slow
def test_one_conditioned_agent_learns_to_be_greedy_and_to_be_curious():
    """Episodes of one step: reward is for the left, the bonus is for the right."""
    torch.manual_seed(0)
    agent = conditioned_agent(learning_rate=1e-2, temperature="constant:0.05")
    bonus = PushingBonus(1.0)
    for _ in range(300):
        batch = random_transition()
        ends = torch.ones_like(batch.terminated)
        agent.update(batch._replace(reward=-batch.action[:, 0], terminated=ends), bonus)
    observation = torch.randn(64, 3)
    action = {
        hunger: agent.act(observation, deterministic=True, hunger=torch.tensor(hunger))[:, 0]
        for hunger in (0.0, 1.0)
    }
    assert (action[0.0] > 0.5).all()
    assert (action[1.0] < -0.5).all()


def test_where_conditioned_the_hunger_is_at_most_one():
    rule = r"`hunger` must lie in \[0, 1\] where conditioned, got 2.0"
    with pytest.raises(ValueError, match=rule):
        conditioned_agent(hunger=ConditionedHunger(value=2.0))
    agent = conditioned_agent()
    with pytest.raises(ValueError, match=rule):
        agent.hunger = 2.0


@pytest.mark.parametrize("hunger", [ConditionedHunger(), Schedule.parse("constant:1"), 1])
def test_a_hunger_that_began_as_a_whole_number_may_be_set_to_any(hunger):
    agent = CuriousSAC.default(3, 2, hidden_dim=16, hunger=hunger)
    agent.hunger = 0.5
    assert agent.hunger == 0.5


def test_an_agent_without_curiosity_takes_no_weight_of_it():
    agent = plain_agent()
    agent.curiosity_coefficient = 0.0
    with pytest.raises(ValueError, match="`curiosity_coefficient` must be 0 where there is no"):
        agent.curiosity_coefficient = 0.5


def test_information_of_actions_is_asked_for_of_two_states_or_more():
    with pytest.raises(ValueError, match="`observation` must have at least 2 rows, got 1"):
        small_agent().metrics(torch.zeros(1, 3))


def test_curiosity_that_is_switched_off_does_not_move_the_actor():
    agent = small_agent()
    agent.curiosity_coefficient = 0.0
    assert agent.curiosity_coefficient == 0
    action = torch.rand(1, 1, 8, 2)
    observation = torch.randn(8, 3)
    _, curiosity_value = agent._values(
        observation, observation, action, PushingBonus(1.0), torch.ones(())
    )
    assert curiosity_value.abs().max() == 0
    with pytest.raises(
        ValueError, match=r"`curiosity_coefficient` must not be negative, got -1\.0"
    ):
        agent.curiosity_coefficient = -1.0


@pytest.mark.parametrize("episodic", [True, False])
def test_only_an_episodic_curiosity_value_ends_with_the_episode(episodic):
    agent = small_agent(curiosity_episodic=episodic, prior="learned")
    batch = random_transition()
    batch = batch._replace(reward=torch.zeros(32), terminated=torch.ones(32, dtype=torch.bool))
    value, curiosity_value = targets_of(
        agent, as_sequences(batch), PushingBonus(0.0), torch.ones(())
    )
    assert value.abs().max() == 0
    assert (curiosity_value.abs().max() == 0) == episodic


def test_information_of_the_actions_is_bounded_from_both_sides_and_leaves_the_random_stream():
    agent, observation = small_agent(), 4 * torch.randn(64, 3)
    random_state = torch.get_rng_state()
    metrics = agent.metrics(observation)
    assert torch.get_rng_state().equal(random_state)
    assert metrics["action_information_lower"] <= metrics["action_information_upper"]
    assert metrics["action_information_lower"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_the_rate_is_held_from_any_start_within_a_factor_of_a_hundred(factor):
    """Episodes of one step, in which the best action is a linear function of the state."""
    torch.manual_seed(0)
    right, target = 0.035, 1.0
    options = {
        "hidden_dim": 32,
        "prior": "learned",
        "temperature": factor * right,
        "target_information_rate": target,
        "learning_rate": 1e-2,
        "polyak": 0.1,
    }
    agent = CuriousSAC.default(1, 1, curiosity=False, **PLAIN | options)
    rates, prices = [], []
    for _ in range(1_500):
        observation = 2 * torch.rand(128, 1) - 1
        with torch.no_grad():
            action = agent.act(observation)
        ends = torch.ones(128, dtype=torch.bool)
        reward = -(action - 0.8 * observation).square().squeeze(-1)
        batch = Transition(observation, action, reward, observation, ends, ~ends)
        metrics = agent.update(batch)
        rates.append(metrics["information_rate"].item())
        prices.append(metrics["temperature"].item())
    settled = rates[-500:]
    assert sum(settled) / 500 == pytest.approx(target, rel=0.15)
    information = agent.metrics(2 * torch.rand(512, 1) - 1)
    assert information["action_information_lower"].item() == pytest.approx(target, rel=0.15)
    assert right / 2 < sum(prices[-500:]) / 500 < 2 * right


def random_sequences(num_steps, batch=32):
    steps = random_transition(num_steps * batch)
    alive = torch.rand(num_steps, batch) < 0.8
    alive[0] = True
    return Sequences(steps, alive.cumprod(0).bool())


def test_by_default_reward_is_charged_where_its_policy_maximises_nothing_else():
    assert plain_agent().soft_backup
    assert not plain_agent(prior="learned").soft_backup
    for prior in ("uniform", "learned"):
        assert small_agent(greedy_share=0.25, prior=prior).soft_backup
        assert not small_agent(prior=prior).soft_backup  # the cost is of what curiosity wants too


def test_sequences_of_one_step_teach_what_transitions_teach():
    agent, other = small_agent(), small_agent()
    other.load_state_dict(agent.state_dict())
    sequences = random_sequences(1)
    for each, batch in ((agent, sequences), (other, sequences.first)):
        torch.manual_seed(1)
        each.update(batch, PushingBonus(1.0))
    for one, same in zip(agent.parameters(), other.parameters(), strict=True):
        torch.testing.assert_close(one, same)


def test_past_the_end_the_curiosity_value_goes_on_where_the_next_episode_begins():
    """Not from a terminal observation, which no regression ever fits."""
    agent = small_agent(curiosity_episodic=False, prior="learned")
    assert agent.sequence_length == 2
    first, second = random_transition(4), random_transition(4)
    ends = torch.tensor([True, False, True, False])
    steps = Transition(*(torch.cat(pair) for pair in zip(first, second, strict=True)))
    steps = steps._replace(terminated=torch.cat([ends, ends]))
    sequences = Sequences(steps, torch.stack([torch.ones(4).bool(), ~ends]))
    asked = []
    agent._next_values = lambda observation, hunger: (
        asked.append(observation) or torch.ones(2, observation.shape[-2])
    )
    reward, curiosity = targets_of(agent, sequences, torch.zeros(8), agent._hunger)
    expected = torch.where(ends.unsqueeze(-1), second.observation, first.next_observation)
    assert asked[0].equal(torch.stack([first.next_observation, expected]))
    discount = agent.discounts[1]
    torch.testing.assert_close(curiosity, discount.expand(4))
    torch.testing.assert_close(reward[ends], first.reward[ends])


@pytest.mark.parametrize("episodic", [True, False])
def test_each_value_sums_as_many_steps_as_are_its_own(episodic):
    agent = small_agent(
        reward_steps=3,
        curiosity_steps=2,
        curiosity_episodic=episodic,
        discount=0.5,
        curiosity_discount=0.1,
        prior="learned",
    )
    let_answer(agent.target_critics, 8.0, 1000.0)
    sequences = random_sequences(3)
    value, curiosity_value = targets_of(agent, sequences, PushingBonus(1.0), torch.ones(()))
    reward = sequences.steps.reward.unflatten(0, (3, 32))
    bonus = sequences.steps.action[:, 0].unflatten(0, (3, 32))
    for row in range(32):
        for found, earned, discount, longest, ahead, ends in (
            (value, reward, 0.5, 3, 8.0, True),
            (curiosity_value, bonus, 0.1, 2, 1000.0, episodic),
        ):
            lives = int(sequences.alive[:longest, row].sum())
            expected = sum(discount**k * earned[k, row].item() for k in range(lives))
            ended = ends and sequences.steps.terminated[(lives - 1) * 32 + row]
            expected += 0.0 if ended else discount**lives * ahead
            assert found[row].item() == pytest.approx(expected, rel=1e-4)


def test_a_bonus_that_is_not_known_ends_the_sum_of_curiosity_alone():
    agent = small_agent(reward_steps=3, curiosity_steps=3, prior="learned")
    sequences = random_sequences(3)
    sequences = sequences._replace(alive=torch.ones(3, 32).bool())
    bonus = torch.rand(96)
    unknown = bonus.clone()
    unknown[32:] = math.nan
    let_answer(agent.target_critics, 5.0, 7.0)
    one = small_agent(reward_steps=3, curiosity_steps=1, prior="learned")
    let_answer(one.target_critics, 5.0, 7.0)
    cut = targets_of(agent, sequences, unknown, torch.ones(()))
    torch.testing.assert_close(cut, targets_of(one, sequences, bonus, torch.ones(())))
    assert not cut[1].equal(targets_of(agent, sequences, bonus, torch.ones(()))[1])


def test_each_value_is_asked_where_its_own_steps_lead():
    """By one pass of the policies and critics, whatever the numbers of steps."""
    for options in ({"greedy_share": 0.25}, {}, {"soft_backup": True}):
        agent = small_agent(reward_steps=3, curiosity_steps=1, **options)
        sequences, asked = random_sequences(3), []
        inner = agent._next_values
        agent._next_values = lambda *args, ask=inner, seen=asked: seen.append(args) or ask(*args)
        targets = targets_of(agent, sequences, PushingBonus(1.0), torch.ones(()))
        assert targets.shape == (2, 32) and targets.isfinite().all()
        ((reached, _),) = asked
        assert reached[0].equal(sequences.last(3).next_observation)
        assert reached[1].equal(sequences.first.next_observation)


def test_the_next_value_of_each_state_is_that_of_its_own_policy():
    """As if every value had been asked alone at all of these states."""
    observation = torch.randn(2, 16, 3)
    for options in ({"greedy_share": 0.25}, {"greedy_share": 0.0}):
        agent = small_agent(soft_backup=False, **options)
        with torch.no_grad():  # next to deterministic
            bias = agent.policy.network.layers[-1].bias
            bias[..., agent.action_dim :] = -100.0
        hunger = torch.ones(())
        together = agent._next_values(observation, hunger)
        for pair in range(2):
            alone = agent._next_values(observation[pair], hunger)[pair]
            torch.testing.assert_close(together[pair], alone, atol=0.05, rtol=0.05)


def test_values_look_as_far_ahead_as_the_batch_goes():
    one, three = small_agent(), small_agent(reward_steps=3, curiosity_steps=3)
    three.load_state_dict(one.state_dict())
    sequences, bonus, hunger = random_sequences(3), PushingBonus(1.0), torch.ones(())
    for batch in (as_sequences(sequences.first), sequences):
        targets = []
        for agent in (one, three):
            torch.manual_seed(1)
            targets.append(targets_of(agent, batch, bonus, hunger))
        assert targets[0].equal(targets[1]) == (batch is not sequences)


@pytest.mark.parametrize("num_steps", [1, 3])
@pytest.mark.parametrize("options", [{}, {"hunger": "conditioned:0.5"}, {"prior": "learned"}])
def test_a_bonus_teaches_the_same_as_a_tensor_and_as_a_function(num_steps, options):
    options = {"curiosity_coefficient": "adaptive"} | options
    agent = small_agent(curiosity_steps=num_steps, **options)
    batch, bonus = random_sequences(num_steps), PushingBonus(3.0)
    batch = batch if num_steps > 1 else batch.first
    steps = as_sequences(batch).steps
    computed = bonus(steps.observation, steps.action, steps.next_observation)
    assert_same_state(updated(agent, batch, bonus), updated(agent, batch, computed))


def spoiled_bonus(spoil):
    """A function like a bonus, with its answer spoiled."""
    return lambda observation, action, next_observation=None: spoil(action[:, 0].clone())


def with_row(row, value):
    return lambda bonus: bonus.index_fill(0, torch.tensor([row]), value)


BAD_BONUSES = {
    "nan": (with_row(3, math.nan), ValueError, r"`bonus` must be finite, got nan in row 3"),
    "infinite": (with_row(3, math.inf), ValueError, r"`bonus` must be finite, got inf in row 3"),
    "huge": (with_row(3, -1e25), ValueError, r"`bonus` must lie within 1e\+14 of zero"),
    "float64": (torch.Tensor.double, TypeError, r"`bonus` must be a tensor of .*32, got torch.f"),
    "a column": (lambda b: b.unsqueeze(-1), ValueError, r"`bonus` must have shape \(32,\).*32, 1"),
    "one row less": (lambda b: b[1:], ValueError, r"`bonus` must have shape \(32,\).*got \(31,\)"),
    "a float": (lambda b: 1.0, TypeError, r"`bonus` must be a tensor of torch.float32, got float"),
    "nothing": (lambda b: None, TypeError, r"`bonus` must be a tensor of .*, got NoneType"),
}


@pytest.mark.parametrize("reason", BAD_BONUSES)
@pytest.mark.parametrize("curiosity_discount", [0.0, 0.97])
def test_what_a_bonus_function_returns_is_refused_before_a_policy_learns_it(
    reason, curiosity_discount
):
    spoil, error, message = BAD_BONUSES[reason]
    agent = small_agent(curiosity_discount=curiosity_discount)
    before = deepcopy(agent)
    policy, stds = copies(agent.policy.parameters()), agent.value_stds.clone()
    with pytest.raises(error, match=message):
        agent.update(random_transition(), spoiled_bonus(spoil))
    if curiosity_discount:  # without, critics have learned of reward before it is asked
        assert_same_state(agent, before)
    assert equal(agent.policy.parameters(), policy)
    assert agent.value_stds[1] == stds[1]
    assert agent.update(random_transition(), PushingBonus(1.0))["policy_loss"].isfinite()


def test_what_a_bonus_function_does_not_know_behind_the_first_step_ends_the_sum():
    agent, batch = small_agent(curiosity_steps=3), random_sequences(3)
    unknown = torch.arange(96) == 50

    def bonus(observation, action, next_observation):
        return action[:, 0].masked_fill(unknown, math.nan)

    computed = bonus(*batch.steps[:2], None)
    assert_same_state(updated(agent, batch, bonus), updated(agent, batch, computed))
    with pytest.raises(ValueError, match="`bonus` must be finite, got nan in row 3"):
        agent.update(batch, spoiled_bonus(with_row(3, math.nan)))


def test_where_no_critic_learns_it_a_bonus_that_is_a_tensor_is_refused():
    agent, batch = small_agent(curiosity_discount=0.0), random_transition()
    with pytest.raises(
        ValueError, match=r"`bonus` must be a function where `curiosity_discount` is 0.*\(32,\)"
    ):
        agent.update(batch, torch.zeros(32))


@pytest.mark.parametrize("options", [{}, {"curiosity_discount": 0.0}, {"prior": "learned"}])
def test_a_curiosity_coefficient_of_zero_switches_curiosity_off(options):
    agent, batch = small_agent(**options), random_transition()
    agent.curiosity_coefficient = 0.0
    one, other = (updated(agent, batch, PushingBonus(slope)) for slope in (0.0, 100.0))
    assert equal(one.policy.parameters(), other.policy.parameters())
    assert agent.update(batch, PushingBonus(1.0))["policy_loss"].isfinite()
    assert agent.curiosity_coefficient == 0


def test_a_curiosity_coefficient_of_zero_switches_it_off_where_conditioned_too():
    agent, batch = conditioned_agent(), random_transition()
    agent.curiosity_coefficient = 0.0
    one, other = (updated(agent, batch, PushingBonus(slope)) for slope in (0.0, 100.0))
    assert equal(one.policy.parameters(), other.policy.parameters())


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 1.0])
def test_a_fixed_curiosity_coefficient_is_a_setting(coefficient):
    agent = small_agent(curiosity_coefficient=coefficient)
    assert agent.curiosity_coefficient == coefficient


def test_the_default_agent_is_that_of_its_configuration():
    torch.manual_seed(1)
    one = CuriousSAC(3, 2)
    torch.manual_seed(1)
    other = CuriousSAC.default(3, 2)
    assert one.config == other.config == AgentConfig()
    assert_same_state(one, other)


def test_an_unknown_setting_of_the_agent_is_refused():
    with pytest.raises(TypeError, match=r"`modes` is no setting here; there are hidden_dim, .*"):
        CuriousSAC.default(3, 2, modes=2)


@pytest.mark.parametrize(
    ("setting", "value", "rule"),
    [
        ("hunger", "linear:0.1:0.9", "`hunger` must be one number.*got .*set `agent.hunger`"),
        ("temperature", "linear:1:0.1", "`temperature` must be one number.*`agent.temperature`"),
        ("curiosity_ends", 100, "`curiosity_ends` must be left out, got 100"),
    ],
)
def test_what_only_the_trainer_carries_out_is_refused_of_an_agent_alone(setting, value, rule):
    with pytest.raises(ValueError, match=rule):
        CuriousSAC.default(3, 1, **{setting: value})
    assert CuriousSAC.default(3, 1, temperature="constant:0.05").temperature == pytest.approx(0.05)
