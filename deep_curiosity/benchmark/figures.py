"""Pictures of what was measured: medians, and ranges over turns."""

from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from deep_curiosity.benchmark.agents import Row
from deep_curiosity.benchmark.tables import grouped, median, slope

OURS, THEIRS = "#1f5fa8", "#888888"


def draw_agents(path: Path, rows: Sequence[Row], ours: Container[str]) -> None:
    """Bars: steps per second of each runner, ours in colour."""
    groups = {str(name): own for (name,), own in grouped(rows, "runner").items()}
    figure = Figure(figsize=(8, 0.42 * len(groups) + 1), layout="constrained")
    axes = figure.subplots()
    rates = [[row["steps_per_second"] for row in own] for own in groups.values()]
    middle = np.median(rates, axis=1)
    colors = [OURS if name in ours else THEIRS for name in groups]
    bars = axes.barh(list(groups), middle, xerr=_reach(rates), color=colors, capsize=3)
    axes.bar_label(bars, fmt="%.0f", label_type="center", color="white")
    axes.invert_yaxis()
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("environment steps per second, an update after each (median, range)")
    figure.savefig(path, dpi=120)


def draw_growth(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each size: milliseconds of an update against it, on logarithmic axes."""
    sizes = grouped(rows, "size")
    figure = Figure(figsize=(3.4 * len(sizes), 3.4), layout="constrained")
    panels = figure.subplots(1, len(sizes), squeeze=False, sharey=True)[0]
    for axes, ((size,), own) in zip(panels, sizes.items(), strict=True):
        draw_power(axes, own, "value", "update_ms", "update")
        axes.set_xlabel(str(size).replace("_", " "))
    panels[0].set_ylabel("ms")
    figure.savefig(path, dpi=120)


def draw_devices(path: Path, rows: Sequence[Row]) -> None:
    """Milliseconds of an update against the batch on every device, on logarithmic axes."""
    figure = Figure(figsize=(5.2, 3.8), layout="constrained")
    axes = figure.subplots()
    for (where,), own in grouped(rows, "where").items():
        draw_power(axes, own, "batch_size", "update_ms", str(where))
    axes.set(xlabel="batch", ylabel="ms of an update")
    figure.savefig(path, dpi=120)


def draw_bonus(path: Path, rows: Sequence[Row]) -> None:
    """Milliseconds and megabytes of the eager bonus against components, on logarithmic axes."""
    eager = [row for row in rows if row["how"] == "eager"]
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    time, memory = figure.subplots(1, 2)
    draw_power(time, eager, "components", "bonus_ms", "full bonus")
    draw_power(time, eager, "components", "bonus_by_row_ms", "one model a pair")
    draw_power(time, eager, "components", "ensemble_ms", "ensemble alone")
    draw_power(memory, eager, "components", "megabytes", "full bonus")
    time.set(xlabel="components", ylabel="ms")
    memory.set(xlabel="components", ylabel="MB")
    figure.savefig(path, dpi=120)


def draw_power(axes: Axes, rows: Sequence[Row], over: str, column: str, label: str) -> None:
    """A line on logarithmic axes with its range, and its slope in the legend."""
    points = {float(str(value)): own for (value,), own in grouped(rows, over).items()}
    costs = [[row[column] for row in own] for own in points.values()]
    middle = [median(own, column) for own in points.values()]
    values = list(points)
    everywhere, at_last = slope(values, middle), slope(values[-2:], middle[-2:])
    label = f"{label}: slope {everywhere:.2f}, at last {at_last:.2f}"
    axes.errorbar(values, middle, _reach(costs), marker="o", capsize=2, label=label)
    _use_logarithms(axes, values)
    axes.legend(fontsize=7, loc="upper left")


def draw_vector(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each task: steps per second of all worlds, native and in turn."""
    tasks = grouped(rows, "task")
    figure = Figure(figsize=(3.6 * len(tasks), 3.4), layout="constrained")
    panels = figure.subplots(1, len(tasks), squeeze=False, sharey=True)[0]
    for axes, ((task,), own) in zip(panels, tasks.items(), strict=True):
        groups = grouped(own, "num_envs")
        numbers = [float(str(number)) for (number,) in groups]
        for column, label, color in (
            ("native_steps_per_second", "native", OURS),
            ("sync_steps_per_second", "SyncVectorEnv", THEIRS),
        ):
            rates = [[row[column] for row in same] for same in groups.values()]
            axes.errorbar(
                numbers, np.median(rates, axis=1), _reach(rates),
                marker="o", capsize=2, color=color, label=label,
            )  # fmt: skip
        _use_logarithms(axes, numbers)
        axes.set(title=task, xlabel="worlds")
        axes.title.set_fontsize(9)
        axes.legend(fontsize=8, loc="upper left")
    panels[0].set_ylabel("environment steps per second")
    figure.savefig(path, dpi=120)


def _use_logarithms(axes: Axes, values: Sequence[float]) -> None:
    """Scale both axes by logarithms, with plain numbers: below them, the values taken."""
    axes.loglog()
    axes.set_xticks(values, [f"{value:.0f}" for value in values])
    axes.minorticks_off()
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter("{x:g}")


def _reach(values: Sequence[Sequence[float]]) -> np.ndarray:
    """How far the lowest and the highest of each lie from the median."""
    middle = np.median(values, axis=1)
    return np.stack([middle - np.min(values, axis=1), np.max(values, axis=1) - middle])
