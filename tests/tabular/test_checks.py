import numpy as np
import pytest

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


def test_what_obeys_the_rules_passes():
    checks.check_positive("temperature", 0.1)
    checks.check_range("epsilon", 1.0, 0.0, 1.0)
    checks.check_at_least("period", 1, 1)
    checks.check_shape("reward", np.zeros(2), (2,))
    checks.check_distribution("start", np.full((3, 7), 1 / 7))
