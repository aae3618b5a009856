"""What an update and a bonus cost on random transitions, as one size after another grows."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.profiler import ProfilerActivity, profile

from deep_curiosity.benchmark.agents import ACTION_DIM, OBSERVATION_DIM, Row
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.speed.compile import compiled
from deep_curiosity.speed.machine import wait_for
from deep_curiosity.training.collector import Step
from deep_curiosity.training.config import Config
from deep_curiosity.training.learner import Learner
from deep_curiosity.transitions import Transition

GROWTH: dict[str, tuple[int, ...]] = {
    "observation_dim": (4, 17, 105, 376),
    "batch_size": (64, 128, 256, 512, 1024),
    "num_members": (2, 3, 5, 7, 10),
    "components": (64, 128, 256, 512, 1024, 2048),
}
"""Sizes that grow one at a time, the others as by default."""
NUM_PAIRS = 256  # whose bonus is computed
NUM_COMPONENTS = 256  # where the bonus is compiled as well
NUM_TRANSITIONS = 1_000  # in replay
SETTLING_CALLS = 5  # until compiled code and memory are as they stay


def measure_growth(
    config: Config,
    growth: Mapping[str, tuple[int, ...]] = GROWTH,
    *,
    repeats: int,
    updates: int,
) -> list[Row]:
    """Milliseconds of an update at every size, measured alternately.

    Args:
        config: Settings of the agent.
        growth: Values of each size; `observation_dim`, or a setting.
        repeats: Rounds of measurement.
        updates: Updates in a round; best a multiple of the interval at which the marginal is
            renewed.
    """
    learners = [
        ({"size": size, "value": value}, _make_learner(config, size, value))
        for size, values in growth.items()
        for value in values
    ]
    return _time_updates(learners, repeats, updates)


def measure_devices(
    config: Config, batch_sizes: tuple[int, ...], *, repeats: int, updates: int
) -> list[Row]:
    """Milliseconds of an update at every batch on a GPU, eager and compiled, and on the CPU.

    Args:
        config: Settings of the agent.
        batch_sizes: How many transitions an update takes.
        repeats: Rounds of measurement.
        updates: Updates in a round; best a multiple of the interval at which the marginal is
            renewed.
    """
    devices: dict[str, dict[str, Any]] = {
        "GPU, compiled": {"device": "cuda", "compile": "on"},
        "GPU, eager": {"device": "cuda", "compile": "off"},
        "CPU, eager": {"device": "cpu", "compile": "off"},
    }
    learners = [
        (
            {"where": where, "batch_size": batch_size},
            _make_learner(config.override(**speed), "batch_size", batch_size),
        )
        for where, speed in devices.items()
        for batch_size in batch_sizes
    ]
    return _time_updates(learners, repeats, updates)


def _time_updates(
    learners: Sequence[tuple[Row, Learner]], repeats: int, updates: int
) -> list[Row]:
    """A row for every learner in every round, beside what it is labelled with."""
    return [
        label
        | {
            "repeat": repeat,
            "update_ms": 1e3
            * seconds_per_call(learner.update, updates, learner.config.speed.device),
        }
        for repeat in range(repeats)
        for label, learner in learners
    ]


def _make_learner(config: Config, size: str, value: int) -> Learner:
    """A learner of that size, after its first updates."""
    setting: dict[str, Any] = {size: value}
    observation_dim = setting.pop("observation_dim", OBSERVATION_DIM)
    learner = Learner(config.override(**setting), observation_dim, ACTION_DIM)
    learner.replay.extend(*random_steps(NUM_TRANSITIONS, observation_dim))
    seconds_per_call(learner.update, SETTLING_CALLS)
    return learner


def measure_bonus(
    components: tuple[int, ...] = GROWTH["components"], *, repeats: int, calls: int
) -> list[Row]:
    """Milliseconds of the ensemble alone, and of the bonus by all models or one model a pair.

    Memory is the most that the tensors of the full bonus take at a time.

    Args:
        components: Sizes of the marginal, eager; compiled only the default.
        repeats: Rounds of measurement.
        calls: Calls in a round.
    """
    transition = random_batch(NUM_PAIRS)
    cells = [("eager", number) for number in components] + [("compiled", NUM_COMPONENTS)]
    timed = {cell: _bonus_calls(transition, *cell) for cell in cells}
    megabytes = {
        (how, number): peak_allocation(timed[how, number]["bonus_ms"]) / 1e6
        for how, number in cells
        if how == "eager"
    }
    rows = []
    for repeat in range(repeats):
        for how, number in cells:
            row: Row = {"how": how, "components": number, "repeat": repeat}
            row |= alternate(timed[how, number], calls)
            rows.append(row | {"megabytes": megabytes.get((how, number), "")})
    return rows


def _bonus_calls(
    transition: Transition, how: str, components: int
) -> dict[str, Callable[[], Any]]:
    """What is measured of the bonus with a full marginal, by its column, settled."""
    full, round_robin = (
        CuriosityBonus.default(
            OBSERVATION_DIM,
            ACTION_DIM,
            components=components,
            refresh_interval=1,
            members=members,
        )
        for members in ("all", "round_robin")
    )
    for bonus in (full, round_robin):
        for _ in range(0, components, NUM_PAIRS):
            bonus.observe(transition)
    modules = {"ensemble_ms": full.dynamics, "bonus_ms": full, "round_robin_ms": round_robin}
    calls: dict[str, Callable[[], Any]] = {
        name: partial(without_gradient(module, how), transition.observation, transition.action)
        for name, module in modules.items()
    }
    for call in calls.values():
        seconds_per_call(call, SETTLING_CALLS)
    return calls


def alternate(functions: Mapping[str, Callable[[], Any]], calls: int) -> Row:
    """Median milliseconds of a call of each, called alternately."""
    rounds = [
        [1e3 * seconds_per_call(function, 1) for function in functions.values()]
        for _ in range(calls)
    ]
    return dict(zip(functions, np.median(rounds, axis=0).tolist(), strict=True))


def without_gradient(module: nn.Module, how: str) -> Callable[..., Any]:
    """A module as a function that keeps nothing for a gradient, eager or compiled."""

    @torch.no_grad()
    def call(*args: Any) -> Any:
        return module(*args)

    return compiled(call) if how == "compiled" else call


def peak_allocation(function: Callable[[], Any]) -> int:
    """Most bytes that tensors made by a function take at a time, as torch's profiler sees them."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        function()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "trace.json"
        profiler.export_chrome_trace(str(path))
        events = json.loads(path.read_text())["traceEvents"]
    memory = [event for event in events if event["name"] == "[memory]"]
    memory.sort(key=lambda event: event["ts"])
    return int(np.cumsum([event["args"]["Bytes"] for event in memory]).max(initial=0))


def seconds_per_call(function: Callable[[], Any], calls: int, device: str = "cpu") -> float:
    """Mean time of a call, its work on a device included."""
    wait_for(device)
    started = time.perf_counter()
    for _ in range(calls):
        function()
    wait_for(device)
    return (time.perf_counter() - started) / calls


def random_batch(batch: int) -> Transition:
    """Transitions like those of HalfCheetah-v5 in size."""
    replay = ReplayBuffer(batch, OBSERVATION_DIM, ACTION_DIM)
    replay.extend(*random_steps(batch, OBSERVATION_DIM))
    return replay.all()


def random_steps(num_steps: int, observation_dim: int, action_dim: int = ACTION_DIM) -> Step:
    """Steps of normally distributed observations that change a little."""
    generator = np.random.default_rng(0)
    observation, change = generator.normal(size=(2, num_steps, observation_dim))
    return Step(
        observation=observation,
        action=generator.uniform(-1, 1, (num_steps, action_dim)),
        reward=generator.normal(size=num_steps),
        next_observation=observation + 0.1 * change,
        terminated=np.zeros(num_steps, dtype=bool),
        truncated=np.zeros(num_steps, dtype=bool),
    )
