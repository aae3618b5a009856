"""Measures speed, distance to the arithmetic floor, memory and growth into docs/benchmark/.

Everything runs on one thread. What is compared takes turns within one run.
"""

import os
import platform
import shlex
import sys
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

import torch
import tyro

from deep_curiosity.benchmark.agents import measure_agents
from deep_curiosity.benchmark.runners import import_runner
from deep_curiosity.benchmark.costs import measure_bonus, measure_devices, measure_growth
from deep_curiosity.benchmark.own_agent import OwnAgent
from deep_curiosity.benchmark.page import AS_USED, SAME_PRECISION, write_page
from deep_curiosity.benchmark.figures import (
    draw_agents,
    draw_bonus,
    draw_devices,
    draw_growth,
    draw_vector,
)
from deep_curiosity.benchmark.tables import read_rows, save_rows
from deep_curiosity.benchmark.vector import measure_vector_environments
from deep_curiosity.training import Settings
from deep_curiosity.speed.machine import prepare_machine
from deep_curiosity.training.config import EXACT

STABLE_BASELINES = "deep_curiosity.benchmark.stable_baselines:StableBaselines"
PLAIN = Settings(env_id="HalfCheetah-v5", bonus="none", prior="uniform")
CURIOUS = replace(PLAIN, bonus="curiosity", prior="learned")
OURS = {
    "plain": PLAIN,
    "plain, nothing spared": replace(PLAIN, **EXACT),
    "curious": CURIOUS,
    "curious, nothing spared": replace(CURIOUS, **EXACT),
}
BONUS_CALLS = 50  # in a turn: a tenth of a second
ADAPTER_CALLS = 50  # in a turn: three seconds
UPDATES = 20  # in a turn: a multiple of the interval at which the marginal is renewed
GPU_BATCHES = (256, 1_024, 4_096)
WORLD_STEPS = 2_000  # in a turn, of all worlds
TIMED_TASKS = [  # one of each body: the other tasks move the same ones
    f"deep_curiosity/{name}-v0"
    for name in ("PendulumSwingup", "CartpoleSwingup", "PointMaze", "ReacherSparse")
]


@dataclass(frozen=True)
class Args:
    """What to measure, how often, and where to."""

    repeats: int = 7
    """Turns of everything that is compared."""
    steps: int = 200
    """Environment steps of an agent in a turn; best a multiple of 20."""
    out: Path = Path("docs/benchmark")
    """Folder for tables, pictures and their README.md."""
    only: Literal["agents", "bonus", "scaling", "vector", "adapters", "cuda"] | None = None
    """One section; the page keeps what is there of the others."""
    peers: dict[str, str] = field(default_factory=dict)
    """Further agents, each a name and module:callable, which makes a runner as described in
    deep_curiosity/benchmark/runners.py."""


class LeftOutError(Exception):
    """A section that cannot be measured here, and why."""


def main(args: Args) -> None:
    """Measure section by section; write tables, pictures and the page."""
    args.out.mkdir(parents=True, exist_ok=True)
    prepare_machine(replace(CURIOUS, compile="off"))
    for section, measure in SECTIONS.items():
        if args.only not in (None, section):
            continue
        try:
            measure(args)
        except LeftOutError as error:
            print(f"{section}: left out, {error}")
            continue
        note_machine(args.out / "machine.csv", section)
        print(f"{section}: measured", flush=True)
    write_page(args.out)
    print(f"See {args.out / 'README.md'}")


def agents(args: Args) -> None:
    """Ours, compiled and eager, and Stable-Baselines3's, with its precision and with ours."""
    precision = torch.get_float32_matmul_precision()
    ours = {
        f"{name}, {how}": replace(settings, compile=switch)
        for name, settings in OURS.items()
        for how, switch in {"compiled": "on", "eager": "off"}.items()
    }
    runners = {name: partial(OwnAgent, own, precision) for name, own in ours.items()} | {
        AS_USED: partial(import_runner, STABLE_BASELINES, PLAIN.env_id, "highest"),
        SAME_PRECISION: partial(import_runner, STABLE_BASELINES, PLAIN.env_id, precision),
    }
    runners |= {name: partial(import_runner, address) for name, address in args.peers.items()}
    turns, processes = measure_agents(runners, ours, repeats=args.repeats, steps=args.steps)
    save_rows(args.out / "agents.csv", turns)
    save_rows(args.out / "processes.csv", processes)
    draw_agents(args.out / "agents.png", turns, ours)


def bonus(args: Args) -> None:
    """The full bonus against the ensemble's pass alone."""
    rows = measure_bonus(repeats=args.repeats, calls=BONUS_CALLS)
    save_rows(args.out / "bonus.csv", rows)
    draw_bonus(args.out / "bonus.png", rows)


def scaling(args: Args) -> None:
    """An update as one size after another grows."""
    rows = measure_growth(replace(CURIOUS, compile="off"), repeats=args.repeats, updates=UPDATES)
    save_rows(args.out / "scaling.csv", rows)
    draw_growth(args.out / "scaling.png", rows)


def vector(args: Args) -> None:
    """The tasks of this package, many worlds at a time."""
    rows = measure_vector_environments(TIMED_TASKS, repeats=args.repeats, steps=WORLD_STEPS)
    save_rows(args.out / "vector.csv", rows)
    draw_vector(args.out / "vector.png", rows)


def adapters(args: Args) -> None:
    """What an adapter costs beyond the bonus itself."""
    try:
        from deep_curiosity.benchmark.adapters import measure_adapters
    except ImportError as error:
        raise LeftOutError(str(error)) from error
    rows = measure_adapters(PLAIN.env_id, repeats=args.repeats, calls=ADAPTER_CALLS)
    save_rows(args.out / "adapters.csv", rows)


def cuda(args: Args) -> None:
    """Agents, and an update as the batch grows, on a GPU and on the CPU beside it."""
    if not torch.cuda.is_available():
        raise LeftOutError("torch sees no GPU")
    ours = {
        f"{name}, {how}, {device}": replace(OURS[name], compile=switch, device=device)
        for device, ways in {
            "cuda": {"compiled": "on", "eager": "off"},
            "cpu": {"compiled": "on"},
        }.items()
        for name in ("plain", "curious")
        for how, switch in ways.items()
    }
    runners = {name: partial(OwnAgent, own, "auto") for name, own in ours.items()} | {
        f"{AS_USED}, {device}": partial(
            import_runner, STABLE_BASELINES, PLAIN.env_id, "highest", device
        )
        for device in ("cuda", "cpu")
    }
    turns, processes = measure_agents(runners, {}, repeats=args.repeats, steps=args.steps)
    save_rows(args.out / "cuda_agents.csv", turns)
    save_rows(args.out / "cuda_processes.csv", processes)
    draw_agents(args.out / "cuda_agents.png", turns, ours)

    rows = measure_devices(CURIOUS, GPU_BATCHES, repeats=args.repeats, updates=UPDATES)
    save_rows(args.out / "cuda_updates.csv", rows)
    draw_devices(args.out / "cuda_updates.png", rows)


SECTIONS = {
    "agents": agents,
    "bonus": bonus,
    "scaling": scaling,
    "vector": vector,
    "adapters": adapters,
    "cuda": cuda,
}


def note_machine(path: Path, section: str) -> None:
    """Keep on what machine, and by what command, a section was measured."""
    row = {
        "section": section,
        "cpu": cpu_name(),
        "gpu": torch.cuda.get_device_name() if section == "cuda" else "",
        "cores": os.cpu_count(),
        "torch": torch.__version__,
        "precision": torch.get_float32_matmul_precision(),
        "command": " ".join(["python", "scripts/benchmark.py", *map(shlex.quote, sys.argv[1:])]),
    }
    save_rows(path, [*(other for other in read_rows(path) if other["section"] != section), row])


def cpu_name() -> str:
    """What the system calls its CPU, and its generation: many share a name."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    pairs = (line.split(":", 1) for line in lines if ":" in line)
    facts = {name.strip(): value.strip() for name, value in pairs}
    if "model name" not in facts:
        return platform.processor()
    return f"{facts['model name']} (family {facts['cpu family']}, model {facts['model']})"


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
