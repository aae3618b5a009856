"""What each switch of `SpeedConfig` gains: an agent with all of them on, and with one off."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from deep_curiosity.benchmark.agents import NUM_FILLED, Row, measure_agents
from deep_curiosity.benchmark.own_agent import OwnAgent
from deep_curiosity.training.config import Config

SWITCHES: dict[str, Any] = {
    "compile": "off",
    "direct_matmul": False,
    "deduplicate": False,
    "numpy_policy": False,
    "keep_memory": False,
}
"""Value of each switch that turns it off."""
ALL_ON = "none"
"""Name of the runner that has no switch turned off."""


def measure_switches(
    agents: Mapping[str, Config],
    switches: Mapping[str, Any] = SWITCHES,
    *,
    repeats: int,
    steps: int,
    num_filled: int = NUM_FILLED,
) -> list[Row]:
    """Steps per second of each agent with one switch off after another, measured alternately.

    Args:
        agents: Settings of each agent, all switches on.
        switches: Value of each switch that turns it off.
        repeats: Rounds of measurement.
        steps: Environment steps of a runner in a round.
        num_filled: Transitions in replay before the first round.

    Returns:
        A row for every agent, switch and round, `switched_off` being `ALL_ON` for the reference.
    """
    rows: list[Row] = []
    for agent, config in agents.items():
        configs = {ALL_ON: config} | {
            name: config.override(**{name: off}) for name, off in switches.items()
        }
        runners = {name: partial(OwnAgent, own) for name, own in configs.items()}
        measured, _ = measure_agents(
            runners, {}, repeats=repeats, steps=steps, num_filled=num_filled
        )
        rows += [{"agent": agent, "switched_off": row.pop("runner"), **row} for row in measured]
    return rows
