import math

import pytest
import torch

from deep_curiosity.bonuses.baselines import NearestNeighboursBonus
from deep_curiosity.transitions import Transition


def update_statistics(bonus, state):
    flag = torch.zeros(len(state), dtype=torch.bool)
    bonus.update_statistics(
        Transition(state, torch.zeros(len(state), 1), flag.float(), state, flag, flag), None
    )


def compute(bonus, state):
    return bonus(state, torch.zeros(len(state), 1), state)


def small(**options):
    return NearestNeighboursBonus(
        1, 1, weight=1.0, center=False, scale=False, **{"neighbours": 2, "memory": 4} | options
    )


def test_the_bonus_is_the_log_of_the_mean_distance_to_the_nearest():
    bonus = small()
    update_statistics(bonus, torch.tensor([[0.0], [1.0], [5.0]]))
    assert compute(bonus, torch.tensor([[2.0]])).item() == pytest.approx(math.log(1 + (1 + 2) / 2))


def test_nothing_remembered_earns_nothing():
    assert compute(small(), torch.randn(3, 1)).tolist() == [0, 0, 0]


def test_fewer_states_than_neighbours_are_enough():
    bonus = small(neighbours=3)
    update_statistics(bonus, torch.tensor([[1.0]]))
    assert compute(bonus, torch.tensor([[4.0]])).item() == pytest.approx(math.log(1 + 3))


def test_the_newest_take_the_place_of_the_oldest():
    bonus = small(neighbours=1)
    update_statistics(bonus, torch.tensor([[0.0], [1.0], [2.0]]))
    update_statistics(bonus, torch.tensor([[10.0], [11.0], [12.0]]))
    assert sorted(bonus.states.flatten().tolist()) == [2, 10, 11, 12]


def test_distances_are_in_whitened_units():
    bonus = small(neighbours=1)
    update_statistics(bonus, torch.tensor([[0.0]]))
    bonus.observation_moments.update(torch.tensor([[-10.0], [10.0]]))
    assert compute(bonus, torch.tensor([[20.0]])).item() == pytest.approx(
        math.log(1 + 2), abs=1e-4
    )


def test_a_state_that_is_remembered_is_no_neighbour_of_its_own():
    bonus = small()
    update_statistics(bonus, torch.tensor([[1e3], [1e3], [1e3 + 1], [1e3 + 3]]))
    value = compute(bonus, torch.tensor([[1e3]])).item()
    assert value == pytest.approx(math.log(1 + (0 + 1) / 2))  # it was there once more
    value = compute(bonus, torch.tensor([[1e3 + 1]])).item()
    assert value == pytest.approx(math.log(1 + (1 + 1) / 2))


def test_where_one_always_is_earns_less_than_what_is_beside_it():
    """All visits of a state were left out with its own, and what stood still was rare."""
    torch.manual_seed(0)
    bonus = small(memory=64)
    place = torch.cat([torch.full((60, 1), 3.0), 0.1 * torch.randn(4, 1)])
    update_statistics(bonus, place)
    often, beside, seldom = compute(bonus, torch.tensor([[3.0], [3.01], [0.5]])).tolist()
    assert often == 0 and often < beside < seldom


def test_more_neighbours_than_memory_are_rejected():
    with pytest.raises(ValueError, match=r"`neighbours` must be at most `memory` \(4\), got 5"):
        small(neighbours=5)
