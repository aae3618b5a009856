import math

import pytest
import torch

from deep_curiosity.bonuses.weight_tuning import LOG_RANGE, TunedWeight


def after(weight, earnings, num_updates=1):
    for earned in earnings:
        weight.follow(torch.tensor(earned), num_updates)
    return weight.factor.item()


def test_the_weight_rises_below_an_absolute_goal_and_falls_above_it():
    assert after(TunedWeight(goal=2.0, learning_rate=0.1), [1.0]) == pytest.approx(math.exp(0.1))
    assert after(TunedWeight(goal=2.0, learning_rate=0.1), [3.0]) == pytest.approx(math.exp(-0.1))
    assert after(TunedWeight(goal=2.0, learning_rate=0.1), [2.0] * 50) == pytest.approx(1.0)


def test_the_weight_follows_what_was_earned_of_late():
    steady = TunedWeight(learning_rate=0.1)
    assert after(steady, [5.0] * 20) == pytest.approx(1.0)
    assert after(steady, [4.0]) == pytest.approx(math.exp(0.1))
    assert steady.past == pytest.approx(5.0, abs=0.01)
    assert after(steady, [4.0] * 5_000) > 1.5
    assert steady.past == pytest.approx(4.0, abs=0.01)


def test_one_look_may_stand_for_many_updates():
    often, seldom = TunedWeight(goal=1.0), TunedWeight(goal=1.0)
    assert after(often, [0.0] * 10) == pytest.approx(after(seldom, [0.0], num_updates=10))
    assert often.past == pytest.approx(seldom.past)


def test_the_weight_stays_within_a_thousand():
    weight = TunedWeight(goal=1e6, learning_rate=1.0)
    assert after(weight, [0.0]) == pytest.approx(math.exp(LOG_RANGE))


@pytest.mark.parametrize("goal", [None, 1.0])
@pytest.mark.parametrize("earned", [math.nan, math.inf, -math.inf, 3e38])
@pytest.mark.parametrize("first", [[], [0.5]])
def test_the_weight_outlives_what_is_not_finite(goal, earned, first):
    weight = TunedWeight(goal=goal, learning_rate=0.1)
    assert math.isfinite(after(weight, [*first, earned, -3e38]))
    assert 0.999e-3 < after(weight, [0.5] * 5) < 1.001e3
    assert weight.past.isfinite()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal": math.nan}, "`goal` must be finite, got nan"),
        ({"goal": 10**400}, "`goal` must be finite, got 1000"),
        ({"learning_rate": 0.0}, "`learning_rate` must be positive and finite, got 0.0"),
    ],
)
def test_a_number_out_of_range_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        TunedWeight(**options)
