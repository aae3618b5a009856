"""Within the transforms of `torch.func`, bonuses are what plain autograd and loops make them."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn, vmap
from torch.func import grad, jacrev

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.bonuses.registry import BONUSES, make_bonus
from deep_curiosity.nn.networks import StackedMLP, frozen
from deep_curiosity.transitions import Transition

BATCH = 6
DIFFERENTIABLE = ["curiosity", "disagreement", "information-gain"]


def make_transition() -> Transition:
    flag = torch.zeros(BATCH, dtype=torch.bool)
    observation, action = torch.randn(BATCH, 3), 2 * torch.rand(BATCH, 1) - 1
    return Transition(observation, action, torch.zeros(BATCH), observation + action, flag, flag)


def trained(name: str) -> tuple[Bonus, Transition]:
    """A bonus that has learned, and a batch to ask it about."""
    learner = BonusLearner(make_bonus(name, 3, 1, hidden_dims=(8,), refresh_interval=1))
    for _ in range(3):
        learner.learn(make_transition())
    return learner.bonus, make_transition()


def total(bonus: Bonus, observation: Tensor) -> Callable[[Tensor], Tensor]:
    return lambda action: bonus(observation, action).sum()


def assert_untouched(bonus: Bonus, before: dict[str, nn.Parameter], learned: set[str]) -> None:
    """The same parameters stand in their places, no gradient has reached them."""
    assert all(each is before[name] for name, each in bonus.named_parameters())
    assert all(each.grad is None for each in before.values())
    assert {name for name, each in before.items() if each.requires_grad} == learned


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_the_gradient_in_the_action_is_that_of_autograd(name: str) -> None:
    bonus, (observation, action, *_) = trained(name)
    before = dict(bonus.named_parameters())
    learned = {key for key, each in before.items() if each.requires_grad}
    found = grad(total(bonus, observation))(action)
    assert not found.requires_grad and found.abs().sum() > 0
    assert_untouched(bonus, before, learned)
    action.requires_grad_()
    bonus(observation, action).sum().backward()
    assert torch.equal(found, action.grad)


@pytest.mark.parametrize("name", ["nearest-neighbours", "rnd", "icm"])
def test_the_gradient_in_the_outcome_is_that_of_autograd(name: str) -> None:
    bonus, (observation, action, _, outcome, *_) = trained(name)
    found = grad(lambda outcome: bonus(observation, action, outcome).sum())(outcome)
    outcome.requires_grad_()
    bonus(observation, action, outcome).sum().backward()
    assert found.abs().sum() > 0 and torch.equal(found, outcome.grad)


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_the_jacobian_agrees_with_the_gradient(name: str) -> None:
    bonus, (observation, action, *_) = trained(name)
    found = grad(total(bonus, observation))(action)
    jacobian = jacrev(lambda action: bonus(observation, action))(action)
    torch.testing.assert_close(jacobian.sum(0), found)


@pytest.mark.parametrize("name", BONUSES)
def test_a_bonus_of_many_batches_is_that_of_each(name: str) -> None:
    bonus, transition = trained(name)
    inputs = transition.observation, transition.action, transition.next_observation
    batches = [each.unflatten(0, (3, 2)) for each in inputs]
    expected = torch.stack([bonus(*batch) for batch in zip(*batches, strict=True)])
    torch.testing.assert_close(vmap(bonus)(*batches), expected)


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_gradients_of_many_batches_are_those_of_each(name: str) -> None:
    bonus, (observation, action, *_) = trained(name)
    observations, actions = (each.unflatten(0, (3, 2)) for each in (observation, action))
    pairs = list(zip(observations, actions, strict=True))
    expected = torch.stack([grad(total(bonus, one))(other) for one, other in pairs])
    found = vmap(lambda one, other: grad(total(bonus, one))(other))(observations, actions)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("name", BONUSES)
def test_shapes_are_looked_at_where_values_cannot_be(name: str) -> None:
    bonus, transition = trained(name)
    inputs = transition.observation, transition.action[:, [0, 0]], transition.next_observation
    with pytest.raises(ValueError, match=r"`action` must have shape \(batch, 1\), got \(2, 2\)"):
        vmap(bonus)(*(each.unflatten(0, (3, 2)) for each in inputs))


def test_a_module_that_is_frozen_within_a_transform_thaws_even_after_an_error() -> None:
    network = StackedMLP(2, 3, (4,), 1)
    before = dict(network.named_parameters())

    def fail(value: Tensor) -> Tensor:
        with frozen(network):
            assert all(not each.requires_grad for each in network.parameters())
            raise RuntimeError("inside")

    with pytest.raises(RuntimeError, match="inside"):
        grad(fail)(torch.zeros(1, 3))
    assert all(each is before[name] for name, each in network.named_parameters())
    assert all(each.requires_grad for each in before.values())
