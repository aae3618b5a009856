from functools import partial

import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.fx.experimental.proxy_tensor import make_fx

from deep_curiosity import CuriosityBonus
from deep_curiosity.speed.deduplication import Deduplication
from deep_curiosity.transitions import Transition


def traced(function, *args):
    """The function as torch's own operations, before and after."""
    graphs = [make_fx(function)(*args) for _ in range(2)]
    Deduplication()(graphs[1].graph)
    graphs[1].recompile()
    return graphs


def count(graph, name):
    return sum(str(node.target).startswith(f"aten.{name}.") for node in graph.graph.nodes)


def test_equal_operations_become_one_and_the_result_stays():
    def function(value):
        return (value + 1).exp() * (value + 1).exp() + (value + 2).exp()

    value = torch.randn(3)
    before, after = traced(function, value)
    assert (count(before, "exp"), count(after, "exp")) == (3, 2)
    assert after(value).equal(function(value))


def test_numbers_of_another_kind_are_other_inputs():
    def function(value):
        return value * 1 + 0, value * 1.0 + 0, 1 / (value * 0.0), 1 / (value * -0.0)

    value = torch.ones(3, dtype=torch.int64)
    _, after = traced(function, value)
    for actual, expected in zip(after(value), function(value), strict=True):
        assert actual.dtype == expected.dtype and actual.equal(expected)


def test_samples_stay_apart():
    def function(value):
        return torch.randn_like(value) - torch.randn_like(value)

    _, after = traced(function, torch.ones(3))
    assert count(after, "randn_like") == 2
    assert after(torch.ones(3)).abs().sum() > 0


def test_what_is_written_to_is_written_as_often():
    def function(value):
        return value.add_(1) + value.add_(1)

    _, after = traced(function, torch.zeros(3))
    assert after(torch.zeros(3)).tolist() == [4.0] * 3


def test_all_that_is_returned_is_returned_apart():
    _, after = traced(lambda value: (value + 1, value + 1), torch.zeros(3))
    one, other = after(torch.zeros(3))
    assert one.data_ptr() != other.data_ptr()


class ComputedAndLearned(nn.Module):
    """A bonus that is computed, and then learns, as in the update of a curious agent."""

    def __init__(self, **options):
        super().__init__()
        self.bonus = CuriosityBonus.default(3, 2, hidden_dims=(8, 8), num_members=2, **options)

    def forward(self, transition):
        value = self.bonus(transition.observation, transition.action).detach()
        return value, self.bonus.loss(transition)


@pytest.mark.parametrize("members", ["all", "round_robin"])
def test_the_bonus_takes_the_pass_that_the_models_learn_from(monkeypatch, members):
    module, flags = ComputedAndLearned(members=members), torch.zeros(7, dtype=torch.bool)
    transition = Transition(
        torch.randn(7, 3), torch.rand(7, 2), torch.zeros(7), torch.randn(7, 3), flags, flags
    )
    module.bonus.observe(transition)
    state = dict(module.named_parameters()) | dict(module.named_buffers())
    # as in a graph, which looks at no values
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    before, after = traced(partial(functional_call, module), state, (transition,))
    assert (count(before, "bmm"), count(after, "bmm")) == (6, 3)


def test_a_cpu_does_not_take_the_graphs_of_another_from_a_shared_cache(monkeypatch):
    here = Deduplication().uuid()
    assert Deduplication().uuid() == here
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "another")
    assert Deduplication().uuid() != here
