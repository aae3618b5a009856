import math

import pytest
import torch
from torch import nn

from deep_curiosity.nn.networks import (
    StackedLinear,
    StackedMLP,
    assign_rows,
    frozen,
    restore_order,
)


def member_as_sequential(network, member):
    """The same network from torch's own layers."""
    parts = []
    for layer in network.layers:
        linear = nn.Linear(layer.weight.shape[1], layer.weight.shape[2])
        linear.weight.data = layer.weight[member].detach().T
        linear.bias.data = layer.bias[member, 0].detach()
        parts += [linear, nn.ReLU()]
    return nn.Sequential(*parts[:-1])


def test_every_member_is_a_network_of_its_own():
    network = StackedMLP(3, 4, (8, 8), 2)
    value = torch.randn(5, 4)
    expected = torch.stack([member_as_sequential(network, member)(value) for member in range(3)])
    torch.testing.assert_close(network(value), expected)
    assert (network(value)[0] - network(value)[1]).abs().max() > 1e-3


def test_each_member_may_have_a_batch_of_its_own():
    network = StackedMLP(3, 4, (8,), 2)
    value = torch.randn(3, 5, 4)
    expected = torch.stack([network(value[member])[member] for member in range(3)])
    torch.testing.assert_close(network(value), expected)


def test_without_hidden_layers_the_network_is_linear():
    network = StackedMLP(2, 3, (), 1)
    one, other = torch.randn(2, 6, 3)
    torch.testing.assert_close(
        network(one) + network(other) - network(torch.zeros(6, 3)), network(one + other)
    )


def test_weights_start_as_those_of_torch():
    torch.manual_seed(0)
    stacked = StackedLinear(2, 100, 300).weight
    torch_own = nn.Linear(100, 300).weight
    assert stacked.abs().max().item() == pytest.approx(1 / math.sqrt(100), rel=1e-3)
    assert stacked.std().item() == pytest.approx(torch_own.std().item(), rel=0.02)


def test_gradients_reach_every_parameter():
    network = StackedMLP(3, 4, (8, 8), 2)
    network(torch.randn(32, 4)).square().sum().backward()
    for parameter in network.parameters():
        gradient_of_member = parameter.grad.flatten(1).abs().sum(1)
        assert (gradient_of_member > 0).all()


@pytest.mark.parametrize("num_rows", [1, 2, 6, 7])
def test_rows_assigned_round_robin_are_each_for_one_member(num_rows):
    row, once = assign_rows(num_rows, 3, torch.device("cpu"))
    assert sorted(row[once].tolist()) == list(range(num_rows))
    assert all((row[member, once[member]] % 3 == member).all() for member in range(3))
    assert restore_order(row, num_rows).tolist() == list(range(num_rows))


def test_a_frozen_module_passes_gradients_but_keeps_none():
    network = StackedMLP(2, 3, (8,), 1)
    value = torch.randn(4, 3, requires_grad=True)
    with frozen(network):
        answer = network(value).sum()
    answer.backward()
    assert value.grad.abs().sum() > 0
    assert all(parameter.grad is None for parameter in network.parameters())


def test_a_frozen_module_thaws_even_after_an_error():
    network = StackedMLP(2, 3, (8,), 1)
    with pytest.raises(RuntimeError, match="inside"), frozen(network):
        raise RuntimeError("inside")
    assert all(parameter.requires_grad for parameter in network.parameters())


def test_what_was_frozen_before_stays_frozen():
    network = StackedMLP(2, 3, (8,), 1)
    network.layers[0].requires_grad_(False)
    with frozen(network):
        pass
    assert not any(parameter.requires_grad for parameter in network.layers[0].parameters())
    assert all(parameter.requires_grad for parameter in network.layers[1].parameters())
