import math

import torch

from deep_curiosity.bonuses.baselines import RNDBonus
from deep_curiosity.transitions import Transition


def transition(observation):
    flag = torch.zeros(len(observation), dtype=torch.bool)
    action = torch.zeros(len(observation), 2)
    return Transition(observation, action, flag.float(), observation, flag, flag)


def test_the_bonus_is_the_log_of_the_mean_squared_error_over_features():
    bonus = RNDBonus(
        3, 2, weight=1.0, center=False, scale=False, random_features=4, hidden_dims=(8,)
    )
    with torch.no_grad():
        for network, value in ((bonus.random, 0.0), (bonus.predictor, [1.0, 0, 2, 0])):
            network.layers[-1].weight.zero_()
            network.layers[-1].bias.copy_(torch.as_tensor(value))
    state = torch.randn(5, 3)
    value = bonus(state, torch.zeros(5, 2), state)
    torch.testing.assert_close(value, torch.full((5,), math.log(1.25)))


def test_the_random_network_is_never_learned():
    bonus = RNDBonus(3, 2, random_features=4, hidden_dims=(8,))
    bonus.loss(transition(torch.randn(16, 3))).backward()
    assert all(parameter.grad is None for parameter in bonus.random.parameters())


def test_what_was_visited_earns_less_than_what_was_not():
    raw = {"weight": 1.0, "center": False, "scale": False}
    bonus = RNDBonus(3, 2, random_features=8, hidden_dims=(32,), **raw)
    visited, new = torch.randn(256, 3), torch.randn(256, 3) + 3
    bonus.observe(transition(visited))
    optimizer = torch.optim.Adam(bonus.predictor.parameters(), lr=3e-3)
    for _ in range(300):
        optimizer.zero_grad()
        bonus.loss(transition(visited)).backward()
        optimizer.step()
    action = torch.zeros(256, 2)
    gain = bonus(new, action, new).mean() - bonus(visited, action, visited).mean()
    assert gain > math.log(5)  # of logs of scores


def test_an_entry_counts_for_at_most_five_standard_deviations():
    bonus = RNDBonus(3, 2, random_features=8, hidden_dims=(32,))
    bonus.observe(transition(torch.randn(256, 3)))
    moments, action = bonus.observation_moments, torch.zeros(1, 2)
    near, far, farther = (
        (moments.center + number * moments.scale).expand(1, 3) for number in (4, 6, 9)
    )
    assert bonus(far, action, far).equal(bonus(farther, action, farther))
    assert not bonus(near, action, near).equal(bonus(far, action, far))
