"""What a bonus is asked in a loop of anyone's must be numbers that it can compute with."""

import math

import jaxtyping
import pytest
import torch

from deep_curiosity.bonuses import BONUSES, Bonus, BonusLearner, make_bonus
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
@pytest.mark.parametrize("value", [1.001e3, 1e13])
def test_an_action_from_which_adam_would_not_recover_is_refused(name: str, value: float) -> None:
    bonus, asked = make(name), question()
    asked["action"][5, 1] = value
    observation, action, following = asked.values()
    flags = torch.zeros(ROWS, dtype=torch.bool)
    rows = Transition(observation, action, torch.zeros(ROWS), following, flags, flags)
    for ask in (lambda: bonus(**asked), lambda: bonus.loss(rows)):
        with pytest.raises(ValueError, match=r"`action` must lie within 1000 of zero.* in row 5"):
            ask()


@pytest.mark.parametrize("name", BONUSES)
def test_the_largest_action_leaves_the_squares_of_adam_far_from_infinity(name: str) -> None:
    flags = torch.zeros(ROWS, dtype=torch.bool)
    learner = BonusLearner(make_bonus(name, 3, 2, hidden_dims=(8,)))
    for number in range(20):
        observation, action = pair()
        action[1, 0] = 1e3 * (-1) ** number
        rows = observation, action, torch.randn(ROWS), torch.randn(ROWS, 3), flags, flags
        learner.step(Transition(*rows))
    state = {} if learner.optimizer is None else learner.optimizer.state_dict()
    squares = [value.max() for part, value in state.items() if part.startswith("square")]
    assert all(square < 1e20 for square in squares)


@pytest.mark.parametrize("name", BONUSES)
def test_an_observation_of_a_trillion_is_answered_with_a_number(name: str) -> None:
    bonus, asked = make(name), question()
    asked["observation"][0], asked["next_observation"][1] = 1e12, -1e14
    flags = torch.zeros(ROWS, dtype=torch.bool)
    for _ in range(25):
        observation, action, following = asked.values()
        bonus.observe(Transition(observation, action, torch.zeros(ROWS), following, flags, flags))
        assert bonus(**asked).isfinite().all()


def spread_over_usual_rows(name: str, absurd: float | None) -> float:
    """Of the bonus over a thousand rows but for one that was absurd, after it has learned them."""
    torch.manual_seed(0)
    observation, action = torch.randn(1_000, 3), 2 * torch.rand(1_000, 2) - 1
    following = observation + 0.2 * action[:, :1] + 0.05 * torch.randn(1_000, 3)
    if absurd is not None:
        observation[501] = following[500] = absurd
    flags = torch.zeros(1_000, dtype=torch.bool)
    rows = Transition(observation, action, torch.zeros(1_000), following, flags, flags)
    learner = BonusLearner(make_bonus(name, 3, 2, hidden_dims=(16,)))
    for _ in range(300):
        chosen = torch.randint(0, 1_000, (64,))
        learner.learn(Transition(*(field[chosen] for field in rows)))
    usual = torch.ones(1_000, dtype=torch.bool)
    usual[500:502] = False
    return learner.compute(Transition(*(field[usual] for field in rows))).std().item()


@pytest.mark.parametrize("name", BONUSES)
def test_one_absurd_row_leaves_the_bonus_of_all_others_its_spread(name: str) -> None:
    whole = spread_over_usual_rows(name, None)
    assert whole > 0.02
    for absurd in (1e2, 1e4, 1e12):
        assert spread_over_usual_rows(name, absurd) == pytest.approx(whole, rel=0.5)


@pytest.mark.parametrize("name", BONUSES)
def test_a_compiled_bonus_looks_at_no_value(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bonus, asked = make(name), question()
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    monkeypatch.setattr(torch.linalg, "vector_norm", lambda value: pytest.fail("looked at"))
    assert bonus(**asked).shape == (ROWS,)


@pytest.mark.parametrize("name", BONUSES)
@pytest.mark.parametrize("ask", ["loss", "observe", "visited"])
def test_a_plain_tuple_is_no_transition(name: str, ask: str) -> None:
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    bonus = make_bonus(name, 3, 2, hidden_dims=(8,))
    flags = torch.zeros(ROWS, dtype=torch.bool)
    rows = Transition(*pair(), torch.randn(ROWS), torch.randn(ROWS, 3), flags, flags)
    if ask == "visited" and not getattr(bonus, "follows_visits", True):
        return
    argument = "visited" if ask == "visited" else "transition"
    with pytest.raises(TypeError, match=f"`{argument}` must be a Transition, got tuple"):
        if ask == "visited":
            bonus.observe(rows, visited=tuple(rows))
        else:
            getattr(bonus, ask)(tuple(rows))


@pytest.mark.parametrize("name", ["curiosity", "hash-count"])
@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("observation", math.nan, "`visited.observation` must be finite, got .* in row 5"),
        ("action", 1e13, "`visited.action` must lie within 1000 of zero, got .* in row 5"),
        ("next_observation", 1e20, r"`visited.next_observation` must lie within 1e\+14 of zero"),
    ],
)
def test_what_was_visited_is_blamed_by_its_name(
    name: str, field: str, value: float, message: str
) -> None:
    flags = torch.zeros(ROWS, dtype=torch.bool)
    rows, late = (
        Transition(*pair(), torch.randn(ROWS), torch.randn(ROWS, 3), flags, flags)
        for _ in range(2)
    )
    getattr(late, field)[5, 1] = value
    with pytest.raises(ValueError, match=message):
        make_bonus(name, 3, 2, hidden_dims=(8,)).observe(rows, visited=late)
    with pytest.raises(ValueError, match="`visited` must have fields of one batch size"):
        make_bonus(name, 3, 2, hidden_dims=(8,)).observe(
            rows, visited=rows._replace(reward=torch.zeros(3))
        )


@pytest.mark.parametrize("name", BONUSES)
def test_a_policy_must_be_callable(name: str) -> None:
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    bonus = make_bonus(name, 3, 2, hidden_dims=(8,))
    flags = torch.zeros(ROWS, dtype=torch.bool)
    rows = Transition(*pair(), torch.randn(ROWS), torch.randn(ROWS, 3), flags, flags)
    for show in (bonus.observe, BonusLearner(bonus).learn):
        with pytest.raises(TypeError, match="`policy` must be callable, got 3"):
            show(rows, 3)
    assert not bonus.should_skip
