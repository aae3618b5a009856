import torch

from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.transitions import Transition


def test_every_pair_earns_the_constant():
    bonus = ConstantBonus(0.7)
    value = bonus(torch.randn(5, 3), torch.randn(5, 2))
    torch.testing.assert_close(value, torch.full((5,), 0.7))


def test_the_constant_has_no_gradient_in_the_action():
    action = torch.randn(5, 2, requires_grad=True)
    assert not ConstantBonus(0.7)(torch.randn(5, 3), action).requires_grad


def test_there_is_nothing_to_learn_or_to_log():
    bonus = ConstantBonus(0.7)
    flag = torch.zeros(5, dtype=torch.bool)
    batch = Transition(torch.randn(5, 3), torch.randn(5, 2), torch.randn(5), *[None] * 3)
    batch = batch._replace(next_observation=batch.observation, terminated=flag, truncated=flag)
    assert list(bonus.parameters()) == [] and bonus.metrics() == {}
    assert bonus.loss(batch).item() == 0


def test_the_constant_is_part_of_the_state():
    bonus = ConstantBonus(0.0)
    bonus.load_state_dict(ConstantBonus(0.7).state_dict())
    assert bonus(torch.zeros(1, 3), torch.zeros(1, 2)).item() == torch.tensor(0.7).item()


def test_what_is_handed_out_may_be_changed_in_place():
    bonus = ConstantBonus(0.5)
    bonus(torch.zeros(3, 3), torch.zeros(3, 2)).mul_(5).add_(torch.arange(3.0))
    assert bonus.value.item() == 0.5
