import csv

import pytest

from deep_curiosity.experiments.paper.clever_random import write_clever_random


def test_every_solution_carries_one_bit_and_the_undamped_iteration_cycles(tmp_path):
    summary = write_clever_random(tmp_path, seed=0, num_starts=2)
    assert summary.shortfall == pytest.approx(0, abs=1e-6)
    assert summary.least_mass == pytest.approx(1, abs=1e-5)
    assert summary.least_split < 0.6 < 0.7 < summary.largest_split
    assert summary.bits_carried < 0.01 and summary.bits_reported > 10
    with (tmp_path / "clever_random_courses.csv").open() as file:
        rows = list(csv.DictReader(file))
    ends = {
        (row["lambda_nats"], row["damping"]): float(row["p_next_is_0"])
        for row in rows
        if row["update"] == "100"
    }
    assert len(rows) == 400
    assert ends["0.300000", "1.000000"] == pytest.approx(0, abs=1e-6)
    assert ends["1.100000", "1.000000"] == pytest.approx(0.5, abs=1e-3)
    assert ends["0.300000", "0.230769"] == pytest.approx(0.5, abs=1e-3)
    assert (tmp_path / "clever_random.png").stat().st_size > 0
