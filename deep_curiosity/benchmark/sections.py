"""What the benchmark measures, section by section: agents, sizes, tables, pictures and texts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import torch

from deep_curiosity.arguments import check_folder
from deep_curiosity.benchmark import figures, page
from deep_curiosity.benchmark.agents import Row, measure_agents
from deep_curiosity.benchmark.costs import measure_bonus, measure_devices, measure_growth
from deep_curiosity.benchmark.own_agent import OwnAgent
from deep_curiosity.benchmark.peers import installed_peers
from deep_curiosity.benchmark.runners import Runner, import_runner
from deep_curiosity.benchmark.switches import measure_switches
from deep_curiosity.benchmark.vector import (
    measure_slow_environments,
    measure_vector_environments,
)
from deep_curiosity.configuration import Group, setting
from deep_curiosity.training.config import Config

STABLE_BASELINES = "deep_curiosity.benchmark.stable_baselines:StableBaselines"
ENV_ID = "HalfCheetah-v5"
AGENTS = {
    "plain": Config.of(env_id=ENV_ID, bonus="none"),
    "plain, exact": Config.of("exact", env_id=ENV_ID, bonus="none"),
    "curious": Config.of(env_id=ENV_ID),
    "curious, exact": Config.of("exact", env_id=ENV_ID),
}
"""Our agents, as the benchmark calls them."""
COMPILE = {"compiled": "on", "eager": "off"}
BONUS_CALLS = 50  # in a round: a tenth of a second
ADAPTER_CALLS = 50  # in a round: three seconds
UPDATES = 20  # in a round: a multiple of the interval at which the marginal is renewed
GPU_BATCHES = (256, 1_024, 4_096)
VECTOR_STEPS = 2_000  # in a round, of all environments
SLOW_STEPS = 160  # likewise: ten of each of sixteen, and less than an episode of one
SLOW_SECONDS = 0.02  # what a slow step waits
TIMED_TASKS = [  # one of each body: the other tasks move the same ones
    f"deep_curiosity/{name}-v0"
    for name in ("PendulumSwingup", "CartpoleSwingup", "PointMaze", "ReacherSparse")
]

NARROW = 64  # wide, as for tasks of few dimensions

STEPPED = ("agents", "narrow", "switches", "cuda")
"""Sections in which agents take steps of an environment, as many as are set."""

Tables = dict[str, list[Row]]
"""What was measured, by the name of the CSV file that it belongs in, without the ending."""


@dataclass(frozen=True)
class Benchmark(Group):
    """What to measure, how often, and where to."""

    repeats: int = setting(7, at_most=1_000)
    """Rounds of measurement; everything that is compared has its turn in each."""
    steps: int = setting(200)
    """Environment steps of an agent in a round; best a multiple of 20."""
    out: Path = Path("docs/benchmark")
    """Folder for tables, pictures and their README.md."""
    only: (
        Literal[
            "agents",
            "narrow",
            "switches",
            "bonus",
            "scaling",
            "vector",
            "slow",
            "adapters",
            "cuda",
        ]
        | None
    ) = None
    """One section; the page keeps what is there of the others."""
    peers: dict[str, str] = field(default_factory=dict)
    """Further agents, each a name and module:callable, which makes a runner as described in
    deep_curiosity/benchmark/runners.py."""

    def __post_init__(self) -> None:
        """Refuse what cannot be measured, or would do nothing in the one section."""
        super().__post_init__()
        check_folder("out", self.out)
        for name, address in self.peers.items():
            module, _, maker = address.partition(":")
            if not (
                name and maker.isidentifier() and all(map(str.isidentifier, module.split(".")))
            ):
                raise ValueError(
                    f"`peers` must each be a name and module:callable, got {name!r} {address!r}."
                )
        for option, default, sections in (
            ("steps", Benchmark.steps, STEPPED),
            ("peers", {}, ("agents",)),
        ):
            value = getattr(self, option)
            if self.only is not None and self.only not in sections and value != default:
                raise ValueError(
                    f"`{option}` must be left out for the section {self.only}, got {value}."
                )


@dataclass(frozen=True)
class Section:
    """A comparison: how it is measured, plotted and described.

    Args:
        measure: Takes the measurements.
        text: Text of the page, from the tables in a folder.
        plots: Picture of each table that has one.
    """

    measure: Callable[[Benchmark], Tables]
    text: Callable[[Path], str]
    plots: Mapping[str, Callable[[Path, list[Row]], None]] = field(default_factory=dict)


class LeftOutError(Exception):
    """A section that cannot be measured here, and why."""


def measure_all_agents(benchmark: Benchmark) -> Tables:
    """Ours, compiled and eager, Stable-Baselines3's, with its precision and ours, and peers."""
    own = own_agents()
    runners: dict[str, Callable[[], Runner]] = {
        **{name: partial(OwnAgent, config) for name, config in own.items()},
        **others(),
        **{name: partial(import_runner, address) for name, address in benchmark.peers.items()},
    }
    rows, processes = measure_agents(
        runners, own, repeats=benchmark.repeats, steps=benchmark.steps
    )
    return {"agents": rows, "processes": processes}


def measure_narrow_agents(benchmark: Benchmark) -> Tables:
    """The same with narrow networks."""
    own = {name: config.override(hidden_dim=NARROW) for name, config in own_agents().items()}
    runners: dict[str, Callable[[], Runner]] = {
        **{name: partial(OwnAgent, config) for name, config in own.items()},
        **others(NARROW),
    }
    rows, processes = measure_agents(
        runners, own, repeats=benchmark.repeats, steps=benchmark.steps
    )
    return {"narrow": rows, "narrow_processes": processes}


def own_agents() -> dict[str, Config]:
    """Ours, compiled and eager, with the precision that this process has."""
    precision = torch.get_float32_matmul_precision()
    return {
        f"{name}, {how}": config.override(compile=switch, matmul_precision=precision)
        for name, config in AGENTS.items()
        for how, switch in COMPILE.items()
    }


def others(hidden_dim: int = 256) -> dict[str, Callable[[], Runner]]:
    """Stable-Baselines3's, as used and with our precision, and peers that are installed."""
    precision = torch.get_float32_matmul_precision()
    return {
        name: partial(import_runner, STABLE_BASELINES, ENV_ID, its_precision, "cpu", hidden_dim)
        for name, its_precision in ((page.AS_USED, "highest"), (page.SAME_PRECISION, precision))
    } | installed_peers(ENV_ID, hidden_dim)


def measure_all_switches(benchmark: Benchmark) -> Tables:
    """The default agents with one optimisation off after another."""
    precision = torch.get_float32_matmul_precision()
    agents = {
        name: AGENTS[name].override(compile="on", matmul_precision=precision)
        for name in ("plain", "curious")
    }
    rows = measure_switches(agents, repeats=benchmark.repeats, steps=benchmark.steps)
    return {"switches": rows}


def measure_full_bonus(benchmark: Benchmark) -> Tables:
    """The full bonus against the ensemble's pass alone."""
    return {"bonus": measure_bonus(repeats=benchmark.repeats, calls=BONUS_CALLS)}


def measure_scaling(benchmark: Benchmark) -> Tables:
    """An update as one size after another grows."""
    config = AGENTS["curious"].override(compile="off")
    return {"scaling": measure_growth(config, repeats=benchmark.repeats, updates=UPDATES)}


def measure_vector(benchmark: Benchmark) -> Tables:
    """The tasks of this package, many environments at a time."""
    rows = measure_vector_environments(TIMED_TASKS, repeats=benchmark.repeats, steps=VECTOR_STEPS)
    return {"vector": rows}


def measure_slow(benchmark: Benchmark) -> Tables:
    """A task whose step waits, each environment in a process, and one after another."""
    rows = measure_slow_environments(
        TIMED_TASKS[0], SLOW_SECONDS, repeats=benchmark.repeats, steps=SLOW_STEPS
    )
    return {"slow": rows}


def measure_all_adapters(benchmark: Benchmark) -> Tables:
    """What an adapter costs beyond the bonus itself."""
    try:
        from deep_curiosity.benchmark.adapters import measure_adapters
    except ImportError as error:
        raise LeftOutError(str(error)) from error
    return {"adapters": measure_adapters(ENV_ID, repeats=benchmark.repeats, calls=ADAPTER_CALLS)}


def measure_cuda(benchmark: Benchmark) -> Tables:
    """Agents, and an update as the batch grows, on a GPU and on the CPU beside it."""
    if not torch.cuda.is_available():
        raise LeftOutError("torch sees no GPU")
    runners: dict[str, Callable[[], Runner]] = {
        f"{name}, {how}, {device}": partial(
            OwnAgent, AGENTS[name].override(compile=COMPILE[how], device=device)
        )
        for device, ways in {"cuda": ("compiled", "eager"), "cpu": ("compiled",)}.items()
        for name in ("plain", "curious")
        for how in ways
    }
    for device in ("cuda", "cpu"):
        runners[f"{page.AS_USED}, {device}"] = partial(
            import_runner, STABLE_BASELINES, ENV_ID, "highest", device
        )
    rows, processes = measure_agents(runners, {}, repeats=benchmark.repeats, steps=benchmark.steps)
    updates = measure_devices(
        AGENTS["curious"], GPU_BATCHES, repeats=benchmark.repeats, updates=UPDATES
    )
    return {"cuda_agents": rows, "cuda_processes": processes, "cuda_updates": updates}


SECTIONS = {
    "agents": Section(measure_all_agents, page.agents_section, {"agents": figures.plot_agents}),
    "narrow": Section(measure_narrow_agents, page.narrow_section, {"narrow": figures.plot_agents}),
    "switches": Section(
        measure_all_switches, page.switches_section, {"switches": figures.plot_switches}
    ),
    "bonus": Section(measure_full_bonus, page.bonus_section, {"bonus": figures.plot_bonus}),
    "scaling": Section(measure_scaling, page.growth_section, {"scaling": figures.plot_growth}),
    "vector": Section(measure_vector, page.vector_section, {"vector": figures.plot_vector}),
    "slow": Section(measure_slow, page.slow_section, {"slow": figures.plot_slow}),
    "adapters": Section(measure_all_adapters, page.adapters_section),
    "cuda": Section(
        measure_cuda,
        page.cuda_section,
        {"cuda_agents": figures.plot_agents, "cuda_updates": figures.plot_devices},
    ),
}
"""All sections by name, in the order of the page."""
