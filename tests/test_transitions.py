import math
import re
from fractions import Fraction

import numpy as np
import pytest
import torch

from deep_curiosity.transitions import (
    Sequences,
    Transition,
    as_sequences,
    check_batch,
    check_counts,
    check_finite,
    check_inputs,
    check_positive,
    check_single_steps,
    check_transition,
    is_number,
)


def transition(batch=4, observation_dim=3, action_dim=2, **fields):
    usual = Transition(
        observation=torch.randn(batch, observation_dim),
        action=torch.rand(batch, action_dim) * 2 - 1,
        reward=torch.randn(batch),
        next_observation=torch.randn(batch, observation_dim),
        terminated=torch.zeros(batch, dtype=torch.bool),
        truncated=torch.zeros(batch, dtype=torch.bool),
    )
    return usual._replace(**fields)


def test_a_good_batch_passes():
    assert check_transition(transition(), 3, 2) is None


@pytest.mark.parametrize("name", ["reward", "terminated", "truncated"])
def test_a_column_where_a_scalar_for_each_transition_belongs_is_rejected(name):
    batch = transition()
    column = batch._replace(**{name: getattr(batch, name).unsqueeze(-1)})
    with pytest.raises(ValueError, match=rf"`{name}` must have shape \(batch,\), got \(4, 1\)"):
        check_transition(column, 3, 2)


def test_a_flag_that_is_no_bool_and_a_reward_that_is_nan_are_rejected():
    batch = transition()
    with pytest.raises(TypeError, match=r"`terminated` must be a tensor of torch\.bool"):
        check_transition(batch._replace(terminated=torch.zeros(4)), 3, 2)
    with pytest.raises(ValueError, match="`reward` must be finite"):
        check_transition(batch._replace(reward=torch.full((4,), float("nan"))), 3, 2)


def test_double_precision_is_taken_where_the_networks_have_it():
    value = torch.zeros(4, 3, dtype=torch.float64)
    assert check_batch("observation", value, 3, torch.float64) is None
    with pytest.raises(TypeError, match=r"`observation` must be .*float32, got torch\.float64"):
        check_batch("observation", value, 3)


def test_whole_numbers_are_rejected_with_their_dtype():
    with pytest.raises(TypeError, match=r"`action` must be .*float32, got torch\.int64"):
        check_batch("action", torch.zeros(4, 2, dtype=torch.long), 2)


@pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 4, 3)])
def test_a_wrong_shape_is_rejected_with_the_rule_and_the_shape(shape):
    with pytest.raises(ValueError, match=r"`observation`.*\(batch, 3\)") as error:
        check_batch("observation", torch.zeros(shape), 3)
    assert str(shape) in str(error.value)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_what_is_not_finite_is_rejected_with_its_row(bad):
    value = torch.zeros(4, 2)
    value[2, 1] = bad
    with pytest.raises(ValueError, match=r"`action` must be finite.*row 2"):
        check_finite(action=value)


@pytest.mark.parametrize("name", ["observation", "action", "next_observation"])
def test_every_vector_of_a_transition_is_checked(name):
    good = getattr(transition(), name)
    for bad, error in (
        (good.long(), TypeError),
        (good[:, :1], ValueError),
        (good * float("nan"), ValueError),
    ):
        with pytest.raises(error, match=f"`{name}`"):
            check_transition(transition(**{name: bad}), 3, 2)


@pytest.mark.parametrize("name", Transition._fields)
def test_a_field_of_another_length_is_rejected(name):
    longer = getattr(transition(batch=5), name)
    with pytest.raises(ValueError, match=f"one batch size.*'{name}': 5"):
        check_transition(transition(**{name: longer}), 3, 2)


def test_an_empty_batch_is_rejected():
    with pytest.raises(ValueError, match="at least 1"):
        check_transition(transition(batch=0), 3, 2)


def test_transitions_are_sequences_of_one_step():
    batch = transition()
    sequences = as_sequences(batch)
    assert sequences.steps is batch and sequences.first is batch and sequences.last(1) is batch
    assert sequences.alive.equal(torch.ones(1, 4, dtype=torch.bool))
    assert as_sequences(sequences) is sequences


def test_the_last_step_of_a_sequence_is_the_last_that_lives():
    alive = torch.tensor([[True, True, True], [True, False, True], [True, False, False]])
    sequences = Sequences(transition(batch=9), alive)
    rows = {1: [0, 1, 2], 2: [3, 1, 5], 3: [6, 1, 5]}
    for num_steps, expected in rows.items():
        last = sequences.last(num_steps)
        for field, steps in zip(last, sequences.steps, strict=True):
            assert field.equal(steps[expected])
    assert sequences.first.observation.equal(sequences.steps.observation[:3])


def test_sequences_that_do_not_fit_their_steps_are_rejected():
    sequences = Sequences(transition(batch=6), torch.ones(2, 2, dtype=torch.bool))
    with pytest.raises(ValueError, match=r"`alive` must have shape .* of 6 steps, got \(2, 2\)"):
        sequences.check(3, 2, torch.float32)


@pytest.mark.parametrize("life", [[False, False, False], [False, True, True], [True, False, True]])
def test_a_sequence_has_a_first_step_and_lives_once(life):
    alive = torch.tensor([[True, True, True], life, [True, True, False]]).T
    sequences = Sequences(transition(batch=9), alive)
    rule = re.escape(f"never again once it is False, got {life} in sequence 1.")
    with pytest.raises(ValueError, match=f"`alive` must be True at the first step .* {rule}"):
        sequences.check(3, 2, torch.float32)
    alive = torch.tensor([[True, True, True], [True, False, False], [True, True, False]]).T
    assert Sequences(transition(batch=9), alive).check(3, 2, torch.float32) is None


def test_a_count_below_one_is_rejected_by_name_and_value():
    with pytest.raises(ValueError, match="`rows` must be at least 1, got 0"):
        check_counts(columns=1, rows=0)


def test_an_unknown_bonus_ends_what_is_known_of_a_sequence():
    """And of no other; what follows the steps whose bonus is given stays as it was."""
    batch = Transition(*(torch.zeros(9, 2), torch.zeros(9, 1), torch.zeros(9)), *_ends(9))
    alive = torch.tensor([[1, 1, 1], [1, 1, 1], [1, 0, 1]]).bool()
    bonus = torch.tensor([0.0, 1.0, 2.0, math.nan, 3.0, 4.0])
    known = Sequences(batch, alive).known(bonus)
    assert known.steps is batch
    assert known.alive.tolist() == [[True] * 3, [False, True, True], [False, False, True]]
    assert alive[1].all()  # the sequences themselves stay


def test_it_does_so_in_a_mask_that_was_turned():
    batch = Transition(*(torch.zeros(6, 2), torch.zeros(6, 1), torch.zeros(6)), *_ends(6))
    turned = torch.ones(2, 3).bool().mT  # of a mask whose axes were (batch, num_steps)
    known = Sequences(batch, turned).known(torch.tensor([0.0, 1.0, math.nan, 2.0]))
    assert known.alive.tolist() == [[True, True], [False, True], [False, True]]
    assert turned.all()


def _ends(number):
    return torch.zeros(number, 2), torch.zeros(number).bool(), torch.zeros(number).bool()


def test_a_pair_must_have_as_many_rows() -> None:
    with pytest.raises(ValueError, match="`action` must have as many rows as `observation`, 32,"):
        check_inputs(
            torch.float32,
            observation=(torch.zeros(32, 3), 3),
            action=(torch.zeros(31, 2), 2),
        )


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, r"`action` must be finite, got \[nan\] in row 2"),
        (-math.inf, r"`action` must be finite, got \[-inf\] in row 2"),
        (1e38, r"`action` must lie within 1000 of zero, got \[9.99\S+e\+37\] in row 2"),
        (-1001.0, r"`action` must lie within 1000 of zero, got \[-1001.0\] in row 2"),
    ],
)
def test_what_cannot_be_computed_with_is_named_with_its_row(value: float, message: str) -> None:
    action = torch.zeros(4, 1)
    action[2] = value
    with pytest.raises(ValueError, match=message):
        check_inputs(torch.float32, observation=(torch.zeros(4, 3), 3), action=(action, 1))


def test_large_values_within_the_bound_are_taken_however_many() -> None:
    observation = torch.full((1_000, 3), 0.99e14)  # whose norm is beyond it
    check_inputs(torch.float32, observation=(observation, 3))


@pytest.mark.parametrize(
    ("field", "value", "limit"),
    [
        ("observation", 1e25, r"1e\+14"),
        ("reward", 1e25, r"1e\+14"),
        ("next_observation", 1e25, r"1e\+14"),
        ("action", 1e25, "1000"),
        ("action", 1001.0, "1000"),
    ],
)
def test_a_transition_with_an_absurd_number_is_refused(
    field: str, value: float, limit: str
) -> None:
    flags = torch.zeros(4, dtype=torch.bool)
    numbers = torch.zeros(4, 3), torch.zeros(4, 2), torch.zeros(4), torch.zeros(4, 3)
    transition = Transition(*numbers, flags, flags)
    getattr(transition, field)[1] = value
    with pytest.raises(ValueError, match=f"`{field}` must lie within {limit} of zero, got"):
        check_transition(transition, 3, 2)


def test_actions_within_the_bound_are_taken_however_many() -> None:
    batch = transition(batch=1_000)._replace(action=torch.full((1_000, 2), -1e3))
    check_transition(batch, 3, 2)
    check_inputs(torch.float32, action=(batch.action, 2), observation=(batch.observation, 3))


@pytest.mark.parametrize("count", [True, 2.0, None, "3"])
def test_a_count_must_be_a_whole_number(count: object) -> None:
    with pytest.raises(TypeError, match="`members` must be a whole number, got"):
        check_counts(members=count)


def test_a_count_of_numpy_is_a_count() -> None:
    check_counts(members=np.int64(3))
    with pytest.raises(ValueError, match="`members` must be at most"):
        check_counts(members=10**18)


@pytest.mark.parametrize(
    "value",
    [None, "1", True, math.nan, math.inf, 1j, [1.0], 10**400, Fraction(1, 10), torch.tensor(0.1)],
)
def test_what_is_no_finite_number_is_none(value: object) -> None:
    assert not is_number(value)


@pytest.mark.parametrize("value", [0, -1.5, np.float32(2), np.int64(3)])
def test_numbers_of_any_kind_are_numbers(value: object) -> None:
    assert is_number(value)


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (Fraction(1, 10), TypeError, r"an int or a float, got Fraction\(1, 10\)"),
        (torch.tensor(0.1), TypeError, r"an int or a float, got tensor\(0.1000\)"),
        (True, TypeError, "an int or a float, got True"),
        (10**400, ValueError, "positive and finite, got 1000"),
        (-math.inf, ValueError, "positive and finite, got -inf"),
    ],
)
def test_what_is_not_positive_or_no_number_is_refused_by_the_rule_that_it_breaks(
    value: object, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=f"`scale` must be {message}"):
        check_positive(width=2, scale=value)


def test_several_steps_are_not_taken_for_one() -> None:
    check_single_steps(None)
    check_single_steps(torch.ones(3, dtype=torch.long))
    with pytest.raises(ValueError, match=r"`next_observation` must be .* one of 3 steps"):
        check_single_steps(torch.tensor([1, 3, 2]))
