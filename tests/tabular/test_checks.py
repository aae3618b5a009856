import numpy as np
import pytest
from jaxtyping import Float

from deep_curiosity.tabular import checks


@pytest.mark.parametrize(
    ("check", "arguments", "message"),
    [
        (checks.check_positive, ("temperature", 0.0), "`temperature` must be positive.*got 0.0"),
        (checks.check_positive, ("temperature", float("inf")), "finite, got inf"),
        (
            checks.check_range,
            ("epsilon", 1.5, 0.0, 1.0),
            r"`epsilon` must lie in \[0.0, 1.0\], got 1.5",
        ),
        (checks.check_range, ("epsilon", float("nan"), 0.0, 1.0), "got nan"),
        (checks.check_at_least, ("period", 0, 1), "`period` must be at least 1, got 0"),
        (checks.check_shape, ("reward", np.zeros(3), (2,)), r"shape \(2,\), got \(3,\)"),
        (checks.check_finite, ("reward", np.array([0, np.nan])), "must be finite, got nan"),
        (checks.check_distribution, ("start", np.array([1.5, -0.5])), "negative, got -0.5"),
        (checks.check_distribution, ("start", np.array([0.5, 0.4])), "sum to 1.*got 0.9"),
        (checks.check_distribution, ("start", np.array([np.inf, 0.4])), "finite, got inf"),
    ],
)
def test_error_names_argument_rule_and_value(check, arguments, message):
    with pytest.raises(ValueError, match=message):
        check(*arguments)


def test_a_distribution_may_be_as_inexact_as_its_numbers():
    exact = np.random.default_rng(0).dirichlet(np.ones(300), size=200)
    rounded = exact.astype(np.float32)
    assert np.abs(rounded.sum(-1) - 1).max() > checks.SUM_TOLERANCE
    checks.check_distribution("transition", rounded)
    with pytest.raises(ValueError, match="must sum to 1"):
        checks.check_distribution("transition", rounded * np.float32(1.01))
    with pytest.raises(ValueError, match="must sum to 1"):
        checks.check_distribution("transition", exact * (1 + 1e-7))


def test_what_obeys_the_rules_passes():
    checks.check_positive("temperature", 0.1)
    checks.check_range("epsilon", 1.0, 0.0, 1.0)
    checks.check_at_least("period", 1, 1)
    checks.check_shape("reward", np.zeros(2), (2,))
    checks.check_distribution("start", np.full((3, 7), 1 / 7))


@checks.checked
def inner_product(
    policy: Float[np.ndarray, "states actions"],
    score: Float[np.ndarray, "states actions"],
    factor: float = 1.0,
) -> Float[np.ndarray, " states"]:
    return factor * np.einsum("xa,xa->x", policy, score)


POLICY, SCORE = np.full((2, 2), 0.5), np.ones((2, 2))


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ((None, SCORE), TypeError, r"`policy` must be an array of \(states, actions\), got None"),
        ((POLICY, SCORE > 0), TypeError, "`score` must be an array of real numbers, got bool"),
        (
            (POLICY, SCORE[0]),
            ValueError,
            r"`score` must have axes \(states, actions\), got",
        ),
        ((POLICY, SCORE[:, :1]), ValueError, "`score` must have 2 actions, as `policy` has, got"),
        ((POLICY[:0], SCORE[:0]), ValueError, "`policy` must have no empty axis, got"),
        ((2 * POLICY, SCORE), ValueError, "`policy` must sum to 1 along its last axis, got 2.0"),
        ((POLICY, SCORE * np.nan), ValueError, "`score` must hold numbers, got nan"),
        ((POLICY, SCORE, "1"), TypeError, "`factor` must be a number, got '1'"),
        ((POLICY, SCORE, np.inf), ValueError, "`factor` must be finite, got inf"),
        (
            (POLICY, 1e300 * SCORE, 1e300),
            ValueError,
            "must leave inner_product with a finite",
        ),
    ],
)
def test_a_checked_function_names_argument_rule_and_value(arguments, kind, message):
    with pytest.raises(kind, match=message):
        inner_product(*arguments)


def test_a_checked_function_answers_what_it_can():
    assert inner_product(POLICY, SCORE, 2.0).tolist() == [2, 2]
    assert np.isposinf(inner_product(POLICY, np.inf * SCORE)).all()  # as a score may be


def test_what_a_checked_function_calls_is_not_checked_again():
    @checks.checked
    def outer(policy: Float[np.ndarray, "states actions"]) -> float:
        return float(inner_product(2 * policy, SCORE)[0])

    assert outer(POLICY) == 2
    with pytest.raises(ValueError, match="`policy` must sum to 1"):
        inner_product(2 * POLICY, SCORE)


@pytest.mark.parametrize("index", [-1, 3])
def test_there_is_no_state_before_the_first_or_after_the_last(index):
    with pytest.raises(ValueError, match=rf"`state` must lie in \[0, 2\], got {index}"):
        checks.check_index("state", index, 3)
