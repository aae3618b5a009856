import math

import pytest
import torch
from torch.nn.functional import mse_loss

from deep_curiosity.losses import (
    actor_loss,
    critic_loss,
    n_step_target,
    price_shares,
    prior_loss,
    temperature_loss,
)


def one_step_target(reward, terminated, next_value, discount):
    """The target of a single step, whose axis is left out."""
    alive = torch.ones(1, reward.shape[-1], dtype=torch.bool)
    return n_step_target(reward.unsqueeze(-2), alive, terminated, next_value, discount)


def test_target_bootstraps_except_where_the_episode_terminated():
    target = one_step_target(
        reward=torch.tensor([1.0, 2.0]),
        terminated=torch.tensor([False, True]),
        next_value=torch.tensor([10.0, 10.0]),
        discount=torch.tensor([0.9]),
    )
    torch.testing.assert_close(target, torch.tensor([10.0, 2.0]))


def test_a_value_that_is_not_finite_does_not_leak_past_the_end():
    ended = torch.tensor([True])
    endless = torch.full((1,), math.inf)
    target = one_step_target(torch.ones(1), ended, endless, torch.tensor([0.9]))
    assert target.item() == 1
    alive = torch.ones(2, 1, dtype=torch.bool)
    target = n_step_target(torch.ones(2, 1), alive, ended, endless, torch.tensor([0.5]))
    assert target.item() == 1.5


def test_every_pair_has_a_discount_of_its_own():
    target = one_step_target(
        reward=torch.tensor([[1.0], [0.5]]),
        terminated=torch.tensor([False]),
        next_value=torch.tensor([[10.0], [10.0]]),
        discount=torch.tensor([[0.9], [0.5]]),
    )
    torch.testing.assert_close(target, torch.tensor([[10.0], [5.5]]))


def test_critic_loss_by_hand():
    value = torch.tensor([[[1.0, 2.0], [0.0, 0.0]]])  # one pair, two estimates, two rows
    target = torch.tensor([[[0.0, 0.0]]])
    assert critic_loss(value, target).item() == pytest.approx(0.5 * (1 + 4) / 2)


def test_critic_loss_sums_over_critics_what_torch_averages_over_rows():
    value, target = torch.randn(4, 32), torch.randn(1, 32)
    expected = sum(0.5 * mse_loss(member, target[0]) for member in value)
    torch.testing.assert_close(critic_loss(value, target), expected)


def test_actor_loss_by_hand():
    loss = actor_loss(
        torch.tensor([1.0, 3.0]),
        torch.tensor([10.0, 20.0]),
        torch.tensor([0.5, 1.5]),
        temperature=0.2,
        hunger=2.0,
    )
    assert loss.item() == pytest.approx(0.2 * 2 - 2 * 15 - 1)


def test_without_hunger_the_value_of_the_reward_pulls_nothing():
    value = torch.randn(4, requires_grad=True)
    curiosity_value = torch.randn(4, requires_grad=True)
    actor_loss(torch.zeros(4), value, curiosity_value, temperature=1.0, hunger=0.0).backward()
    torch.testing.assert_close(value.grad, torch.zeros(4))
    torch.testing.assert_close(curiosity_value.grad, torch.full((4,), -0.25))


def test_minimiser_of_the_actor_loss_is_equation_21():
    prior = torch.tensor([0.5, 0.3, 0.2], dtype=torch.float64)
    value = torch.tensor([0.1, 0.4, -0.2], dtype=torch.float64)
    curiosity_value = torch.tensor([0.3, -0.1, 0.5], dtype=torch.float64)
    temperature, hunger = 0.7, 0.8
    policy = prior * torch.exp((hunger * value + curiosity_value) / temperature)
    logits = (policy / policy.sum()).log().requires_grad_()
    probability = torch.softmax(logits, 0)
    cost = torch.log_softmax(logits, 0) - prior.log()
    keywords = {"temperature": temperature, "hunger": hunger}
    losses = torch.stack(
        [
            actor_loss(cost[i : i + 1], value[i : i + 1], curiosity_value[i : i + 1], **keywords)
            for i in range(3)
        ]
    )
    (gradient,) = torch.autograd.grad(probability @ losses, logits)
    torch.testing.assert_close(gradient, torch.zeros(3, dtype=torch.float64))


def test_prior_loss_is_the_cross_entropy():
    assert prior_loss(torch.tensor([-1.0, -2.0])).item() == 1.5


@pytest.mark.parametrize(("target_rate", "sign"), [(1.0, -1), (3.0, 1)])
def test_descent_raises_the_price_while_the_rate_is_above_target(target_rate, sign):
    log_temperature = torch.zeros((), requires_grad=True)
    cost = torch.tensor([1.0, 3.0], requires_grad=True)
    temperature_loss(log_temperature, cost, target_rate).backward()
    assert log_temperature.grad.item() == pytest.approx(sign)
    assert cost.grad is None


def test_several_steps_are_summed_as_far_as_a_sequence_lives():
    reward = torch.tensor([[1.0, 1.0, 1.0], [10.0, 10.0, 10.0], [100.0, 100.0, 100.0]])
    alive = torch.tensor([[True, True, True], [True, True, False], [True, False, False]])
    terminated = torch.tensor([False, False, True])
    next_value = torch.tensor([8.0, 8.0, 8.0])
    target = n_step_target(reward, alive, terminated, next_value, torch.tensor([0.5]))
    assert target.tolist() == [1 + 5 + 25 + 1, 1 + 5 + 2, 1]


def test_of_several_steps_of_which_one_is_alive_the_target_is_that_of_one_step():
    reward, next_value = torch.randn(1, 5), torch.randn(5)
    terminated = torch.tensor([True, False, True, False, False])
    discount = torch.tensor([0.9])
    alive = torch.tensor([[True] * 5, [False] * 5])
    several = n_step_target(
        torch.cat([reward, torch.full((1, 5), 100.0)]), alive, terminated, next_value, discount
    )
    one = one_step_target(reward[0], terminated, next_value, discount)
    torch.testing.assert_close(several, one)
    expected = torch.where(terminated, reward[0], reward[0] + 0.9 * next_value)
    torch.testing.assert_close(one, expected)


def test_over_several_steps_every_value_has_its_own_discount_and_end():
    reward = torch.ones(2, 2, 1)
    terminated = torch.tensor([[True], [False]])
    next_value, discount = torch.full((2, 1), 8.0), torch.tensor([[0.5], [0.25]])
    alive = torch.ones(2, 1, dtype=torch.bool)
    target = n_step_target(reward, alive, terminated, next_value, discount)
    assert target.tolist() == [[1 + 0.5], [1 + 0.25 + 0.0625 * 8]]


@pytest.mark.parametrize("coefficient", [0.05, 0.5, 1.0, 30.0])
def test_a_later_nat_costs_lambda_at_every_hunger(coefficient):
    hunger = torch.tensor([0.0, 0.3, 1.0, 4.0, 10.0])
    weight = torch.full_like(hunger, coefficient)
    of_reward, of_curiosity = price_shares(hunger, weight)
    torch.testing.assert_close(hunger * of_reward + weight * of_curiosity, torch.ones(5))
    assert (of_reward <= 1).all()  # however little reward is heard


def test_without_a_curiosity_value_reward_bears_the_whole_price():
    hunger = torch.tensor([0.3, 1.0, 4.0])
    torch.testing.assert_close(hunger * price_shares(hunger, None)[0], torch.ones(3))
    assert price_shares(torch.tensor(0.0), None).isfinite().all()
