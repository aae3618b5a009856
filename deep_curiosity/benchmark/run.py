"""The benchmark: sections measured one after another, and the page that describes them."""

import os
import platform
from collections.abc import Mapping
from pathlib import Path

import torch

from deep_curiosity.benchmark.sections import (
    AGENTS,
    SECTIONS,
    Benchmark,
    LeftOutError,
)
from deep_curiosity.benchmark.tables import read_rows
from deep_curiosity.experiments.tables import check_page, read_table, write_table
from deep_curiosity.speed.machine import fitted_machine
from deep_curiosity.training.source import source_commit

INTRODUCTION = """# Benchmark

`make bench` measures all of this on one thread and writes this page. Tables show the
median and `[lowest, highest]` over rounds, in each of which everything that is compared has its
turn; ratios are taken within a round. The CSV files beside it have every round. Each section names
the commit that was measured: until `0ca7803` a curious agent had no greedy policy, and two critics
of curiosity where it has one today.
"""
MACHINES = "machine.csv"
PAGE = "README.md"


def run_benchmark(benchmark: Benchmark, command: str) -> None:
    """Measure section by section; write tables, pictures and the page.

    Args:
        benchmark: What to measure, how often, and where to.
        command: The command line that asked for it, which the page repeats.

    Raises:
        FileExistsError: If a file in the folder is none that a benchmark has written.
    """
    out = benchmark.out
    check_page(out, INTRODUCTION.splitlines()[0])
    out.mkdir(parents=True, exist_ok=True)
    with fitted_machine(AGENTS["curious"].speed):
        for name, section in SECTIONS.items():
            if benchmark.only not in (None, name):
                continue
            try:
                tables = section.measure(benchmark)
            except LeftOutError as error:
                print(f"{name}: left out, {error}")
                continue
            for table, rows in tables.items():
                write_table(out / f"{table}.csv", rows)
            plot_section(out, name)
            note_machine(out / MACHINES, name, command)
            print(f"{name}: measured", flush=True)
    write_page(out)
    print(f"See {out / PAGE}")


def plot_section(out: Path, name: str) -> None:
    """Plot the tables of a section that lie in a folder."""
    for table, plot in SECTIONS[name].plots.items():
        plot(out / f"{table}.png", read_rows(out / f"{table}.csv"))


def write_page(out: Path) -> None:
    """Write `README.md` of whatever tables lie in the folder."""
    machines = {row["section"]: row for row in read_table(out / MACHINES)}
    text = [INTRODUCTION]
    for name, section in SECTIONS.items():
        if name in machines:
            text += [section.text(out), _machine_line(machines[name])]
    (out / PAGE).write_text("\n".join(text))


def note_machine(path: Path, section: str, command: str) -> None:
    """Keep on what machine, by what command and at which commit a section was measured."""
    row = {
        "section": section,
        "cpu": cpu_name(),
        "gpu": torch.cuda.get_device_name() if section == "cuda" else "",
        "cores": os.cpu_count(),
        "torch": torch.__version__,
        "precision": torch.get_float32_matmul_precision(),
        "command": command,
        "commit": source_commit(),
    }
    write_table(path, [*(other for other in read_table(path) if other["section"] != section), row])


def cpu_name() -> str:
    """Name of the CPU as the system gives it, and its generation, since many share a name."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    pairs = (line.split(":", 1) for line in lines if ":" in line)
    facts = {name.strip(): value.strip() for name, value in pairs}
    if "model name" not in facts:
        return platform.processor()
    return f"{facts['model name']} (family {facts['cpu family']}, model {facts['model']})"


def _machine_line(machine: Mapping[str, str]) -> str:
    gpu = f"{machine['gpu']}, " if machine.get("gpu") else ""
    commit = f" Commit: `{machine['commit']}`." if machine.get("commit") else ""
    return (
        f"Machine: {gpu}{machine['cpu']}, {machine['cores']} cores, torch {machine['torch']}, "
        f"matrix products {machine['precision']}.{commit} Command:\n\n"
        f"```sh\n{machine['command']}\n```\n"
    )
