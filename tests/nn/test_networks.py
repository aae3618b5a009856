import math

import pytest
import torch
from torch import nn

from deep_curiosity.nn.networks import (
    Adam,
    StackedLinear,
    StackedMLP,
    assign_rows,
    frozen,
    log_softmax_of_rest,
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
def test_assigned_rows_are_each_for_one_member(num_rows):
    row, once = assign_rows(num_rows, 3, torch.device("cpu"))
    assert sorted(row[once].tolist()) == list(range(num_rows))
    assert all((row[member, once[member]] % 3 == member).all() for member in range(3))
    assert restore_order(row, num_rows).tolist() == list(range(num_rows))


def test_a_frozen_module_passes_gradients_but_keeps_none():
    network = StackedMLP(2, 3, (8,), 1)
    value = torch.randn(4, 3, requires_grad=True)
    with frozen(network):
        output = network(value).sum()
    output.backward()
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


def test_the_first_of_the_alternatives_has_logit_zero():
    logits = torch.randn(4, 2)
    expected = torch.log_softmax(torch.cat([torch.zeros(4, 1), logits], -1), -1)
    torch.testing.assert_close(log_softmax_of_rest(logits), expected)
    assert log_softmax_of_rest(torch.zeros(4, 0)).equal(torch.zeros(4, 1))


@pytest.mark.parametrize("in_graph", [False, True])
def test_steps_are_those_of_torch(monkeypatch, in_graph):
    own, other = (nn.Parameter(value) for value in torch.ones(2, 3, 2).clone())
    optimizer, reference = Adam([own], 0.1), torch.optim.Adam([other], lr=0.1)
    for _ in range(20):
        target = torch.randn(3, 2)
        with monkeypatch.context() as patch:
            patch.setattr(torch.compiler, "is_compiling", lambda: in_graph)
            optimizer.step((own - target).square().sum())
        reference.zero_grad()
        (other - target).square().sum().backward()
        reference.step()
        torch.testing.assert_close(own, other)
        assert own.grad is None


def test_an_optimiser_restored_from_its_state_dict_goes_on_bit_for_bit():
    one, other = (nn.Parameter(torch.ones(3)) for _ in range(2))
    optimizer, restored = Adam([one], 0.1), Adam([other], 0.1)
    for step in range(8):
        if step == 4:
            other.data.copy_(one.data)
            restored.load_state_dict(optimizer.state_dict())
        optimizer.step((one - 3).square().sum())
        if step >= 4:
            restored.step((other - 3).square().sum())
    assert one.equal(other)


def test_a_part_whose_parameters_were_replaced_is_not_stepped_in_silence():
    part = nn.Linear(3, 1)
    optimizer = Adam(part.parameters(), 0.1)
    optimizer.step(part(torch.ones(4, 3)).sum())
    part.load_state_dict({"weight": torch.zeros(1, 3), "bias": torch.zeros(1)}, assign=True)
    before = {name: value.clone() for name, value in optimizer.state_dict().items()}
    with pytest.raises(ValueError, match=r"`loss` must depend .* number 0 of 2: .*assign=True"):
        optimizer.step(part(torch.ones(4, 3)).sum())
    assert all(value.equal(before[name]) for name, value in optimizer.state_dict().items())
    optimizer.replace_targets(part.parameters())
    optimizer.step(part(torch.ones(4, 3)).sum())
    assert part.weight.lt(0).all() and optimizer.count == 2


@pytest.mark.parametrize("normalized", [0, 2, 3])
def test_only_the_first_networks_are_normalised_whichever_are_asked(normalized):
    network = StackedMLP(3, 4, (8, 8), 1, normalized=normalized)
    value = torch.randn(16, 4)
    near, far = network(value), network(1e6 * value)
    bounded = (far.abs().amax((1, 2)) < 1e3 * near.abs().amax((1, 2))).tolist()
    assert bounded == [member < normalized for member in range(3)]
    for some in (slice(0, 2), slice(2, None)):
        torch.testing.assert_close(network(value, some), near[some])
    hidden, last = network.hidden(value), network.layers[-1]
    torch.testing.assert_close(hidden @ last.weight + last.bias, near)
