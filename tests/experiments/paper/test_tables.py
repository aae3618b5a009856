import numpy as np
import pytest

from deep_curiosity.experiments.paper.tables import settled, stationary_bits, write_table
from deep_curiosity.tabular.environments import clever_random, reliable_unreliable
from deep_curiosity.tabular.policies import random_log_policy
from deep_curiosity.tabular.solvers import solve_stationary


def test_floats_have_six_decimals_and_the_rest_is_unchanged(tmp_path):
    path = tmp_path / "table.csv"
    write_table(path, ("name", "count", "share"), [("a", 3, np.float64(1 / 3)), ("b, c", 4, 2.0)])
    assert path.read_bytes() == b'name,count,share\na,3,0.333333\n"b, c",4,2.000000\n'


def test_far_sighted_policy_of_the_paper_carries_log_three_minus_one_bits():
    policy = np.array([[3 / 4, 1 / 4], [1 / 2, 1 / 2]])
    assert stationary_bits(reliable_unreliable(), policy) == pytest.approx(np.log2(3) - 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"max_iterations": 2}, "after 2 updates"), ({"damping": 1.0}, "repeats itself every 2")],
)
def test_no_policy_that_has_not_converged_goes_into_a_table(options, message):
    mdp, start = clever_random(11), random_log_policy(2, 11, np.random.default_rng(2))
    with pytest.raises(RuntimeError, match=message):
        settled(solve_stationary(mdp, start, temperature=0.3, **options))
    solution = solve_stationary(reliable_unreliable(), temperature=0.5)
    np.testing.assert_array_equal(settled(solution), solution.policy)
