import csv

import pytest

from deep_curiosity.experiments.paper.rate_return import write_rate_return


def test_half_a_bit_returns_more_than_a_constant_action_and_less_than_the_best(tmp_path):
    summary = write_rate_return(tmp_path, seed=0, num_temperatures=5)
    assert summary.constant < summary.value < summary.best
    assert (summary.value, summary.temperature) == pytest.approx((9.5648, 0.9001), abs=5.1e-5)
    with (tmp_path / "rate_return.csv").open() as file:
        rates = [float(row["rate_bits"]) for row in csv.DictReader(file)]
    assert rates == sorted(rates) and rates[-1] == pytest.approx(summary.best_rate, abs=1e-6)
    assert (tmp_path / "rate_return.png").stat().st_size > 0
