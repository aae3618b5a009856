import pytest

from deep_curiosity.benchmark.figures import plot_switches
from deep_curiosity.benchmark.page import switches_section
from deep_curiosity.benchmark.sections import AGENTS
from deep_curiosity.benchmark.switches import SWITCHES, measure_switches
from deep_curiosity.experiments.tables import write_table


@pytest.mark.slow
def test_every_agent_is_measured_with_every_switch_off_and_with_none(tiny):
    agents = {
        "plain": tiny.override(bonus="none", compile="off"),
        "curious": tiny.override(compile="off"),
    }
    rows = measure_switches(agents, {"numpy_policy": False}, repeats=2, steps=3, num_filled=50)
    assert [(row["agent"], row["switched_off"], row["repeat"]) for row in rows] == [
        (agent, switch, repeat)
        for agent in agents
        for repeat in (0, 1)
        for switch in ("none", "numpy_policy")
    ]
    assert all(row["steps_per_second"] > 0 for row in rows)


@pytest.mark.parametrize("name", SWITCHES)
def test_every_switch_is_on_unless_it_is_turned_off(name):
    config = AGENTS["curious"].override(compile="on")
    assert getattr(config.override(**{name: SWITCHES[name]}).speed, name) == SWITCHES[name]
    assert getattr(config.speed, name) != SWITCHES[name]


def test_the_gain_is_the_rate_with_all_on_over_that_without(tmp_path):
    rows = [
        {"agent": agent, "switched_off": switch, "repeat": repeat, "steps_per_second": float(rate)}
        for agent, scale in (("plain", 2), ("curious", 1))
        for repeat in (0, 1)
        for switch, rate in (("none", 100 * scale), ("keep_memory", (80 + 20 * repeat) * scale))
    ]
    write_table(tmp_path / "switches.csv", rows)
    text = switches_section(tmp_path)
    assert "| plain | none | 200 [200, 200] | 1 [1, 1] |" in text
    assert "| curious | keep_memory | 90 [80, 100] | 1.125 [1, 1.25] |" in text
    plot_switches(tmp_path / "switches.png", rows)
    assert (tmp_path / "switches.png").stat().st_size > 5_000
