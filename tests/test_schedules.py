import math
from itertools import pairwise

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
    annealed = [Schedule(1.0, 0.01, "plateaus")(step / 100) for step in range(101)]
    assert len(set(annealed)) == 11
    assert annealed[49] == annealed[40] == pytest.approx(0.01**0.4)
    assert {Schedule(0.3, shape="constant")(step / 10) for step in range(20)} == {0.3}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0), "`first` must be finite and positive, got 0.0"),
        ((1.0, math.inf), "`last` must be finite and positive, got inf"),
        ((1.0, 2.0, "constant"), "`last` must be left out where the shape is 'constant'.*got 2.0"),
        ((1.0, None, "linear"), "`last` must be left out where.*got None for 'linear'"),
    ],
)
def test_a_way_that_leads_nowhere_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Schedule(*arguments)


def test_an_unknown_shape_is_refused():
    with pytest.raises((ValueError, TypeError), match="cubic"):
        Schedule(1.0, 2.0, "cubic")


@pytest.mark.parametrize(
    "schedule",
    [Schedule(1.0, 10.0, "linear"), Schedule(1 / 3, 1e-9), Schedule(0.05, shape="constant")],
)
def test_text_is_read_as_it_is_written(schedule):
    assert Schedule.parse(str(schedule)) == schedule


@pytest.mark.parametrize("text", ["", "1.0", "linear", "linear:one", "cubic:1:2", "linear:1:2:3"])
def test_text_that_is_no_schedule_is_refused(text):
    with pytest.raises(ValueError, match="written as shape:first:last, its shape one of const"):
        Schedule.parse(text)
