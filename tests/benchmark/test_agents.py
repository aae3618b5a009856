from functools import partial

from deep_curiosity.benchmark.agents import measure_agents
from deep_curiosity.benchmark.own_agent import OwnAgent
from deep_curiosity.benchmark.runners import import_runner


def test_agents_alternate_and_who_is_missing_is_left_out(tiny, capsys):
    configs = {"ours": tiny.override(env_id="HalfCheetah-v5", env_kwargs={}, compile="off")}
    runners = {
        "ours": partial(OwnAgent, configs["ours"]),
        "theirs": partial(import_runner, "no_such_package:Agent"),
    }
    rows, processes = measure_agents(runners, configs, repeats=2, steps=5, num_filled=50)
    assert [(row["runner"], row["repeat"]) for row in rows] == [("ours", 0), ("ours", 1)]
    for row in rows:
        stages = row["sampling_ms"] + row["statistics_ms"] + row["learning_ms"]
        assert 0 < row["agent_ms"] < stages <= row["update_ms"] < 1e3 / row["steps_per_second"]
        assert 0 < row["floor_ms"] < row["update_ms"]
    assert processes[0]["peak_megabytes"] > 100
    assert "theirs is left out: No module named 'no_such_package'" in capsys.readouterr().out
