import pytest
import torch

from deep_curiosity.bonuses.baselines import HashCountBonus
from deep_curiosity.transitions import Transition

RAW = {"weight": 1.0, "center": False, "scale": False, "refresh_interval": 1}


def transition(state):
    flag = torch.zeros(len(state), dtype=torch.bool)
    return Transition(state, torch.zeros(len(state), 1), flag.float(), state, flag, flag)


def compute(bonus, state):
    return bonus(state, torch.zeros(len(state), 1), state)


def test_the_bonus_falls_with_the_root_of_the_count():
    bonus = HashCountBonus(2, 1, **RAW)
    state = torch.tensor([[0.3, -0.2]])
    bonus.observe(transition(torch.cat([state.expand(9, 2), torch.randn(50, 2) + 5])))
    assert compute(bonus, state).item() == pytest.approx(1 / 3)
    bonus.observe(transition(state.expand(7, 2)))
    assert compute(bonus, state).item() == pytest.approx(1 / 4)


def test_what_was_never_visited_earns_one():
    bonus = HashCountBonus(2, 1, **RAW)
    bonus.observe(transition(torch.randn(50, 2)))
    assert compute(bonus, torch.tensor([[40.0, -60.0]])).item() == 1


def test_a_state_keeps_its_code_while_statistics_go_on():
    bonus = HashCountBonus(2, 1, refresh_interval=1)
    state = torch.randn(20, 2)
    bonus.observe(transition(state))
    before = bonus._slots(state)
    bonus.observe(transition(100 * torch.randn(500, 2) + 30))
    assert bonus._slots(state).equal(before)


def test_states_on_one_ray_have_different_codes():
    bonus = HashCountBonus(1, 1)
    bonus.observe(transition(torch.randn(50, 1)))
    near, far = bonus._slots(torch.tensor([[0.1], [2.0]])).unbind(1)
    assert not near.equal(far)


def test_an_entry_that_rests_at_first_does_not_drown_the_others():
    torch.manual_seed(0)
    bonus = HashCountBonus(3, 1, **RAW)
    state = torch.randn(256, 3)
    state[:, 2] = 0.0
    bonus.observe(transition(state))
    assert len(bonus._slots(torch.randn(2_000, 3))[0].unique()) > 500


def test_all_visits_are_counted_beside_a_first_batch_of_one():
    bonus = HashCountBonus(2, 1, **RAW)
    bonus.observe(transition(torch.randn(1, 2)), None, transition(torch.randn(8, 2)))
    assert bonus.counts[0].sum() == 8


def test_no_visit_changes_no_count():
    bonus = HashCountBonus(2, 1, **RAW)
    state = torch.randn(50, 2)
    bonus.observe(transition(state))
    counts = bonus.counts.clone()
    bonus.observe(transition(state), None, transition(state[:0]))
    assert bonus.counts.equal(counts)


def test_more_bits_tell_states_apart_more_finely():
    state = torch.randn(200, 2)
    numbers = []
    for bits in (2, 8, 32):
        bonus = HashCountBonus(2, 1, bits=bits)
        bonus.observe(transition(state))
        numbers.append(len(bonus._slots(state)[0].unique()))
    assert numbers[0] <= 4 < numbers[1] < numbers[2]


@pytest.mark.parametrize("bits", [0, 63])
def test_codes_must_fit_an_integer(bits):
    with pytest.raises(ValueError, match="`bits` must be at"):
        HashCountBonus(2, 1, bits=bits)
