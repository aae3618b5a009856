import math

import pytest
import torch

from deep_curiosity.bonuses.baselines import ICMBonus
from deep_curiosity.transitions import Transition


def transition(batch=64):
    flag = torch.zeros(batch, dtype=torch.bool)
    observation, action = torch.randn(batch, 3), torch.rand(batch, 2) * 2 - 1
    shift = torch.cat([action, torch.zeros(batch, 1)], dim=-1)
    return Transition(observation, action, flag.float(), observation + shift, flag, flag)


def test_in_the_state_it_is_the_log_of_half_the_squared_error_of_the_forward_model():
    raw = {"weight": 1.0, "center": False, "scale": False}
    bonus = ICMBonus(3, 2, features="state", hidden_dims=(8,), **raw)
    with torch.no_grad():
        bonus.forward_model.layers[-1].weight.zero_()
        bonus.forward_model.layers[-1].bias.zero_()
    state = torch.tensor([[1.0, 2.0, 2.0]])
    assert bonus(state, torch.zeros(1, 2), state).item() == pytest.approx(math.log(4.5))


def test_the_loss_is_the_papers_in_which_the_forward_model_does_not_shape_its_own_target():
    """Equation (7) without the policy's part, beta 0.2; its target is held."""
    bonus = ICMBonus(3, 2, feature_dim=4, hidden_dims=(8,))
    batch = transition()
    before = bonus._encode(batch.observation)
    after = bonus._encode(batch.next_observation)
    held = after.detach()
    predicted = bonus.forward_model(torch.cat([before, batch.action], dim=-1))[0]
    forward = 0.5 * (predicted - held).square().sum(-1).mean()
    guess = bonus.inverse(torch.cat([before, after], dim=-1))[0]
    inverse = (guess - batch.action).square().sum(-1).mean()
    parameters = list(bonus.parameters())
    expected = torch.autograd.grad(0.2 * forward + 0.8 * inverse, parameters)
    loss = bonus.network_loss(batch)
    for own, other in zip(torch.autograd.grad(loss, parameters), expected, strict=True):
        torch.testing.assert_close(own, other)


def test_features_come_to_reveal_the_action():
    bonus = ICMBonus(3, 2, feature_dim=8, hidden_dims=(32,))
    batch = transition(256)
    optimizer = torch.optim.Adam(bonus.parameters(), lr=3e-3)
    for _ in range(300):
        optimizer.zero_grad()
        bonus.loss(batch).backward()
        optimizer.step()
    features = [bonus._encode(state) for state in (batch.observation, batch.next_observation)]
    guess = bonus.inverse(torch.cat(features, dim=-1))[0]
    assert (guess - batch.action).square().mean() < 0.2 * batch.action.var()


def test_other_features_are_rejected():
    with pytest.raises((TypeError, ValueError), match="pixels"):
        ICMBonus(3, 2, features="pixels")
