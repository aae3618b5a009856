from importlib.resources import files
from typing import get_args, get_type_hints

import pytest

from deep_curiosity.cli import demo, main

pytest.importorskip("safetensors")
AGENTS = get_args(get_type_hints(demo.Args)["agent"])


@pytest.mark.parametrize("agent", AGENTS)
def test_every_agent_that_comes_with_the_package_solves_its_task(agent, capsys):
    assert main(["demo", agent, "--episodes", "2"]) == 0
    for line in capsys.readouterr().out.splitlines():
        achieved = float(line.partition(": return ")[2].split()[0])
        assert achieved > SOLVED[agent]


def test_every_agent_is_offered_and_small():
    folders = {each.name: each for each in files("deep_curiosity").joinpath("demos").iterdir()}
    assert set(folders) == set(AGENTS) == set(SOLVED)
    for folder in folders.values():
        assert sum(len(each.read_bytes()) for each in folder.iterdir()) < 100_000


def test_an_episode_is_the_same_at_the_same_seed_and_another_at_another(capsys):
    def played(seed):
        main(["demo", "maze", "--episodes", "1", "--seed", str(seed)])
        return capsys.readouterr().out

    assert played(3) == played(3)
    assert {played(seed) for seed in range(8)} != {played(0)}


def test_no_episode_is_an_error(refusal):
    assert "`episodes` must be at least 1, got 0." in refusal("demo", "--episodes", 0)


SOLVED = {"maze": 100.0, "pendulum": 20.0, "rover": 20.0}
"""Return that no agent has by chance."""
