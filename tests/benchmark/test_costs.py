import pytest
import torch

from deep_curiosity.benchmark.costs import measure_growth, peak_allocation


def test_a_row_for_every_size_in_every_round(tiny):
    growth = {"observation_dim": (4, 8), "num_members": (2,)}
    rows = measure_growth(tiny.override(compile="off"), growth, repeats=2, updates=1)
    assert [(row["size"], row["value"], row["repeat"]) for row in rows] == [
        (size, value, repeat)
        for repeat in (0, 1)
        for size, value in (("observation_dim", 4), ("observation_dim", 8), ("num_members", 2))
    ]
    assert all(row["update_ms"] > 0 for row in rows)


@pytest.mark.filterwarnings("ignore")
def test_peak_allocation_counts_what_is_held_at_a_time():
    def two_then_one():
        held = torch.ones(1_000) + torch.ones(1_000)  # three of 4 kB, before two are freed
        return torch.ones(1_000) + held.sum()

    assert peak_allocation(two_then_one) == pytest.approx(12_000, rel=0.05)
