import math
from itertools import pairwise

import pytest

from deep_curiosity.schedules import Schedule


@pytest.mark.parametrize("shape", ["linear", "exponential", "annealing"])
@pytest.mark.parametrize(("first", "last"), [(1.0, 0.01), (0.5, 8.0)])
def test_a_schedule_goes_from_first_to_last_and_stays(shape, first, last):
    schedule = Schedule(first, last, 100, shape)
    values = [schedule(step) for step in range(120)]
    assert values[0] == first
    assert values[100:] == pytest.approx([last] * 20)
    rises = [math.copysign(1, last - first) * (b - a) for a, b in pairwise(values)]
    assert min(rises) >= 0


def test_the_shapes_are_what_they_are_called():
    assert Schedule(1.0, 3.0, 10, "linear")(5) == pytest.approx(2.0)
    assert Schedule(1.0, 0.01, 10, "exponential")(5) == pytest.approx(0.1)
    annealed = [Schedule(1.0, 0.01, 100, "annealing")(step) for step in range(101)]
    assert len(set(annealed)) == 11
    assert annealed[49] == annealed[40] == pytest.approx(0.01**0.4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0, 10), "`first` must be finite and positive, got 0.0"),
        ((1.0, math.inf, 10), "`last` must be finite and positive, got inf"),
        ((1.0, 2.0, 0), "`num_steps` must be at least 1, got 0"),
    ],
)
def test_a_way_that_leads_nowhere_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Schedule(*arguments)
