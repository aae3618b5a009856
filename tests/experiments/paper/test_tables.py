import numpy as np
import pytest

from deep_curiosity.experiments.paper.tables import stationary_bits, write_table
from deep_curiosity.tabular.environments import reliable_unreliable


def test_floats_have_six_decimals_and_the_rest_is_unchanged(tmp_path):
    path = tmp_path / "table.csv"
    write_table(path, ("name", "count", "share"), [("a", 3, np.float64(1 / 3)), ("b, c", 4, 2.0)])
    assert path.read_bytes() == b'name,count,share\na,3,0.333333\n"b, c",4,2.000000\n'


def test_far_sighted_policy_of_the_paper_carries_log_three_minus_one_bits():
    policy = np.array([[3 / 4, 1 / 4], [1 / 2, 1 / 2]])
    assert stationary_bits(reliable_unreliable(), policy) == pytest.approx(np.log2(3) - 1)
