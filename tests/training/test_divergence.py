import pytest
import torch
from torch import nn

from deep_curiosity.training.divergence import broken_loss, broken_weight


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_the_loss_that_is_not_finite_is_named(value):
    metrics = {
        "agent/policy_loss": torch.tensor(1.0),
        "agent/ratio": torch.tensor(float("nan")),  # of what is not known yet
        "agent/critic_loss": torch.tensor(value),
    }
    assert broken_loss(metrics) == f"`agent/critic_loss` must stay finite, got {value}"
    assert broken_loss({"agent/policy_loss": torch.tensor(1.0)}) is None
    assert broken_loss({}) is None


def test_the_weight_that_is_not_finite_is_named():
    layer = nn.Linear(2, 2)
    assert broken_weight(agent=layer, bonus=None) is None
    with torch.no_grad():
        layer.bias[1] = float("inf")
    assert broken_weight(bonus=None, agent=layer) == "`agent.bias` must stay finite, got inf"
