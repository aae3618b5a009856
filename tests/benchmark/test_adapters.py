import pytest

from deep_curiosity.benchmark.adapters import measure_adapters
from deep_curiosity.benchmark.page import adapters_section
from deep_curiosity.benchmark.tables import grouped
from deep_curiosity.experiments.tables import write_table


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # what MuJoCo says of the task's file
def test_every_adapter_is_measured_against_the_bonus_alone(tmp_path):
    rows = measure_adapters("HalfCheetah-v5", repeats=3, calls=2)
    assert [row["adapter"] for row in rows] == 3 * ["Stable-Baselines3", "torchrl"]
    for own in grouped(rows, "adapter").values():
        # the shortest of several rounds: another process can only make a round longer
        step, curious, plain, direct = (
            min(row[f"{name}_ms"] for row in own)
            for name in ("step", "curious", "plain", "direct")
        )
        assert step > curious > plain > 0 < direct
    write_table(tmp_path / "adapters.csv", rows)
    assert "| Stable-Baselines3 | " in adapters_section(tmp_path)


def test_overhead_is_what_is_left_of_a_sample_in_percent_of_a_step(tmp_path):
    row = {
        "adapter": "some",
        "curious_ms": 6.0,
        "plain_ms": 1.0,
        "direct_ms": 4.0,
        "step_ms": 20.0,
    }
    write_table(tmp_path / "adapters.csv", [row])
    assert "| some | 6 [6, 6] | 1 [1, 1] | 4 [4, 4] | 20 [20, 20] | 5 [5, 5] |" in (
        adapters_section(tmp_path)
    )
