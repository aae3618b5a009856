import math
from fractions import Fraction
from itertools import pairwise

import jaxtyping
import numpy as np
import pytest

from deep_curiosity.schedules import Schedule


@pytest.mark.parametrize("shape", ["linear", "exponential", "plateaus"])
@pytest.mark.parametrize(("first", "last"), [(1.0, 0.01), (0.5, 8.0)])
def test_a_schedule_goes_from_first_to_last_and_stays(shape, first, last):
    schedule = Schedule(first, last, shape)
    values = [schedule(step / 100) for step in range(120)]
    assert values[0] == first
    assert values[100:] == pytest.approx([last] * 20)
    rises = [math.copysign(1, last - first) * (b - a) for a, b in pairwise(values)]
    assert min(rises) >= 0


def test_the_shapes_are_what_they_are_called():
    assert Schedule(1.0, 3.0, "linear")(0.5) == pytest.approx(2.0)
    assert Schedule(1.0, 0.01, "exponential")(0.5) == pytest.approx(0.1)
    assert [Schedule(0.3, shape="constant")(step / 10) for step in range(12)] == [0.3] * 12
    plateaus = [Schedule(1.0, 0.01, "plateaus")(step / 100) for step in range(101)]
    assert [plateaus.count(value) for value in sorted(set(plateaus))] == [11, *[10] * 9]
    assert plateaus[49] == plateaus[40] == pytest.approx(0.01 ** (4 / 9))


def test_ten_plateaus_go_from_the_first_to_the_last_which_is_acted_at():
    schedule = Schedule(0.02, 0.002, "plateaus")
    assert [schedule(step / 10) for step in range(11)] == pytest.approx(
        [0.02 * 0.1 ** (min(plateau, 9) / 9) for plateau in range(11)]
    )
    assert schedule(0.9) == schedule(1.0) == pytest.approx(0.002)


@pytest.mark.parametrize("shape", ["exponential", "plateaus"])
@pytest.mark.parametrize("ends", [(1e-200, 1e200), (1e200, 1e-200), (10**300, 1e-300)])
def test_ends_whose_ratio_is_no_float_are_as_far_from_the_middle(shape, ends):
    schedule = Schedule(*ends, shape)
    assert schedule(0.0) == float(ends[0]) and schedule(1.0) == ends[1]
    values = [schedule(0.05 + step / 10) for step in range(10)]
    logs = [math.log(value) for value in values]
    assert logs == sorted(logs, reverse=ends[0] > ends[1])
    assert [a + b for a, b in zip(logs, reversed(logs), strict=True)] == pytest.approx([0] * 10)


@pytest.mark.parametrize("shape", ["linear", "exponential", "plateaus"])
@pytest.mark.parametrize("ends", [(1e10, 1e-10), (0.07, 1e-10), (7, 1e6), (0.3, 0.1)])
def test_a_schedule_reaches_its_end_and_never_leaves_what_lies_between(shape, ends):
    schedule = Schedule(*ends, shape)
    values = [schedule(step / 1_000) for step in range(1_001)]
    assert values[-1] == ends[1]
    assert min(ends) == min(values) and max(values) == max(ends)


def test_ends_of_any_kind_of_number_are_written_and_read_back():
    schedule = Schedule(np.float64(0.5), 2.0, "linear")
    assert schedule == Schedule.parse(str(schedule)) and str(schedule) == "linear:0.5:2.0"
    assert str(Schedule.parse("constant:2")) == "constant:2.0"


def test_the_middle_of_far_ends_is_their_geometric_mean():
    assert Schedule(1e-200, 1e200)(0.5) == pytest.approx(1.0)
    assert Schedule(0.3, 0.03)(0.7) == 0.3 * (0.03 / 0.3) ** 0.7  # of others bit for bit as ever


@pytest.mark.parametrize("value", [Fraction(1, 10), "1", True, None])
def test_an_end_must_be_a_number(value):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match="`first` must be an int or a float, got"):
        Schedule(value, 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0), "`first` must be finite and positive, got 0.0"),
        ((10**400, 1.0), "`first` must be finite and positive, got 1000"),
        ((1.0, math.inf), "`last` must be finite and positive, got inf"),
        ((1.0, 2.0, "constant"), "`last` must be left out .* got 2.0 for 'constant'"),
        ((1.0,), "`last` must be left out .* got None for 'exponential'"),
    ],
)
def test_a_way_that_leads_nowhere_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Schedule(*arguments)


def test_an_unknown_shape_is_refused():
    with pytest.raises((ValueError, TypeError), match="shape"):
        Schedule(1.0, 2.0, "cosine")


@pytest.mark.parametrize(
    ("text", "schedule"),
    [
        ("constant:0.02", Schedule(0.02, None, "constant")),
        ("linear:1:10", Schedule(1.0, 10.0, "linear")),
        ("exponential:0.3:0.03", Schedule(0.3, 0.03)),
        ("plateaus:1:1e-3", Schedule(1.0, 0.001, "plateaus")),
    ],
)
def test_a_schedule_is_read_from_text_and_written_so(text, schedule):
    assert Schedule.parse(text) == schedule
    assert Schedule.parse(str(schedule)) == schedule


@pytest.mark.parametrize("text", ["", "linear", "cosine:1:2", "linear:1:2:3", "linear:a:2"])
def test_text_that_is_no_schedule_is_refused_with_the_form(text):
    with pytest.raises(ValueError, match=rf"written as shape:first:last.*got '{text}'"):
        Schedule.parse(text)
