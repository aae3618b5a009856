"""What a bonus is asked in a loop of anyone's must be numbers that it can compute with."""

import math

import pytest
import torch

from deep_curiosity.bonuses import BONUSES, Bonus, make_bonus
from deep_curiosity.transitions import Transition

ROWS = 8
FIELDS = ("observation", "action", "next_observation")


def make(name: str) -> Bonus:
    bonus = make_bonus(name, 3, 2, hidden_dims=(8,))
    flags = torch.zeros(ROWS, dtype=torch.bool)
    bonus.observe(Transition(*pair(), torch.randn(ROWS), torch.randn(ROWS, 3), flags, flags))
    return bonus


def pair() -> tuple[torch.Tensor, torch.Tensor]:
    return torch.randn(ROWS, 3), 2 * torch.rand(ROWS, 2) - 1


def question() -> dict[str, torch.Tensor]:
    return dict(zip(FIELDS, (*pair(), torch.randn(ROWS, 3)), strict=True))


@pytest.mark.parametrize("name", BONUSES)
@pytest.mark.parametrize("field", ["observation", "action"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e38, -3e38, 1e25])
def test_what_is_asked_must_be_finite_and_no_larger_than_can_be_squared(
    name: str, field: str, value: float
) -> None:
    asked = question()
    asked[field][5, 1] = value
    with pytest.raises(ValueError, match=f"`{field}` must (be finite|lie within).* in row 5"):
        make(name)(**asked)


@pytest.mark.parametrize("name", BONUSES)
def test_an_observation_of_a_trillion_is_answered_with_a_number(name: str) -> None:
    bonus, asked = make(name), question()
    asked["observation"][0], asked["next_observation"][1] = 1e12, -1e14
    flags = torch.zeros(ROWS, dtype=torch.bool)
    for _ in range(25):
        observation, action, following = asked.values()
        bonus.observe(Transition(observation, action, torch.zeros(ROWS), following, flags, flags))
        assert bonus(**asked).isfinite().all()


@pytest.mark.parametrize("name", BONUSES)
def test_a_compiled_bonus_looks_at_no_value(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bonus, asked = make(name), question()
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    monkeypatch.setattr(torch.linalg, "vector_norm", lambda value: pytest.fail("looked at"))
    assert bonus(**asked).shape == (ROWS,)
