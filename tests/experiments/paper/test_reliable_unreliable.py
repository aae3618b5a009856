import numpy as np
import pytest

from deep_curiosity.experiments.paper.reliable_unreliable import write_reliable_unreliable


@pytest.mark.slow
def test_a_longer_horizon_moves_one_half_to_three_quarters(tmp_path):
    rows = write_reliable_unreliable(tmp_path, seed=0, num_discounts=3)
    assert [row.curiosity_discount for row in rows] == [0, 0.5, 0.9, 0.99, 0.999, 1]
    shares = [0.5, 0.6464, 0.7321, 0.7483, 0.7498, 0.75]
    assert [row.pi_stay_given_0 for row in rows] == pytest.approx(shares, abs=5.1e-5)
    assert rows[0][3:] == pytest.approx((0.5, 0.5), abs=1e-6)
    assert rows[-1][3:] == pytest.approx((2 / 3, np.log2(3) - 1), abs=1e-6)
    assert len((tmp_path / "reliable_unreliable.csv").read_text().splitlines()) == 1 + 3 * 6
    assert (tmp_path / "reliable_unreliable.png").stat().st_size > 0
