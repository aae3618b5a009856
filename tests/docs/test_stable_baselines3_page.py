import csv

import pytest
from stable_baselines3 import PPO, SAC

from tests.docs.pages import ROOT, run_blocks

PAGE = ROOT / "docs/integrations/stable_baselines3.md"


@pytest.mark.slow
def test_the_blocks_run_as_written():
    names = run_blocks(PAGE)
    assert type(names["model"]) is type(names["again"]) is PPO
    assert names["again"].num_timesteps == 256
    first, second = (names[name].rollout_buffer.bonus for name in ("model", "again"))
    assert int(second.every.num_calls) == 2 * int(first.every.num_calls)
    assert names["SAC"] is SAC


def test_three_lines_are_shown_for_each_kind_of_agent():
    marked = [line[-3:] for line in PAGE.read_text().splitlines() if line[-3:-1] == "# "]
    assert marked == ["# 1", "# 2", "# 3"] * 2


def test_returns_of_tqc_are_those_of_its_runs():
    with PAGE.with_name("tqc.csv").open() as file:
        runs = list(csv.DictReader(file))
    section = PAGE.read_text().partition("## A modern agent: TQC")[2].partition("\n## ")[0]
    assert len(runs) == 2
    for run in runs:
        assert run["evaluation_return"] in section
