"""What tests of ensembles of point predictions share."""

import torch

from deep_curiosity.transitions import Transition


def transition(batch=64):
    flag = torch.zeros(batch, dtype=torch.bool)
    observation = torch.randn(batch, 3)
    return Transition(
        observation, torch.rand(batch, 2) * 2 - 1, torch.randn(batch), observation + 1, flag, flag
    )


def predict(bonus, *values):
    """Let the members predict constants: the layers before the last no longer matter."""
    last = bonus.ensemble.network.layers[-1]
    with torch.no_grad():
        last.weight.zero_()
        for member, value in enumerate(values):
            last.bias[member] = value
