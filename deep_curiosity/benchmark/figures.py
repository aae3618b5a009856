"""Pictures of what was measured: medians, and ranges over rounds."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from deep_curiosity.benchmark.agents import Row
from deep_curiosity.benchmark.switches import ALL_ON
from deep_curiosity.benchmark.tables import grouped, median, size_name, slope

HIGHLIGHT, GREY = "#1f5fa8", "#888888"
OUR_AGENTS = ("plain", "curious")  # with which the names of our runners begin


def plot_agents(path: Path, rows: Sequence[Row]) -> None:
    """Bars: steps per second of each runner, ours in colour."""
    groups = {str(name): own for (name,), own in grouped(rows, "runner").items()}
    figure = Figure(figsize=(8, 0.42 * len(groups) + 1), layout="constrained")
    axes = figure.subplots()
    _plot_rates(axes, groups, [name for name in groups if name.startswith(OUR_AGENTS)])
    axes.invert_yaxis()
    axes.set_xlabel("environment steps per second, an update after each (median, range)")
    figure.savefig(path, dpi=120)


def plot_switches(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each agent: steps per second with one switch off, and in colour with none."""
    agents = grouped(rows, "agent")
    figure = Figure(figsize=(4.6 * len(agents), 3.2), layout="constrained")
    panels = figure.subplots(1, len(agents), squeeze=False, sharey=True)[0]
    for axes, ((agent,), own) in zip(panels, agents.items(), strict=True):
        groups = {str(name): same for (name,), same in grouped(own, "switched_off").items()}
        _plot_rates(axes, groups, [ALL_ON])
        axes.set(title=agent, xlabel="environment steps per second")
    panels[0].set_ylabel("switched off")
    panels[0].invert_yaxis()
    figure.savefig(path, dpi=120)


def plot_growth(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each size: milliseconds of an update against it, on logarithmic axes."""
    sizes = grouped(rows, "size")
    figure = Figure(figsize=(3.4 * len(sizes), 3.4), layout="constrained")
    panels = figure.subplots(1, len(sizes), squeeze=False, sharey=True)[0]
    for axes, ((size,), own) in zip(panels, sizes.items(), strict=True):
        plot_power(axes, own, "value", "update_ms", "update")
        axes.set_xlabel(size_name(str(size)))
    panels[0].set_ylabel("ms")
    figure.savefig(path, dpi=120)


def plot_devices(path: Path, rows: Sequence[Row]) -> None:
    """Milliseconds of an update against the batch on every device, on logarithmic axes."""
    figure = Figure(figsize=(5.2, 3.8), layout="constrained")
    axes = figure.subplots()
    for (where,), own in grouped(rows, "where").items():
        plot_power(axes, own, "batch_size", "update_ms", str(where))
    axes.set(xlabel="batch", ylabel="ms of an update")
    figure.savefig(path, dpi=120)


def plot_bonus(path: Path, rows: Sequence[Row]) -> None:
    """Milliseconds and megabytes of the eager bonus against components, on logarithmic axes."""
    eager = [row for row in rows if row["how"] == "eager"]
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    time, memory = figure.subplots(1, 2)
    plot_power(time, eager, "components", "bonus_ms", "full bonus")
    plot_power(time, eager, "components", "round_robin_ms", "one model a pair")
    plot_power(time, eager, "components", "ensemble_ms", "ensemble alone")
    plot_power(memory, eager, "components", "megabytes", "full bonus")
    time.set(xlabel="components", ylabel="ms")
    memory.set(xlabel="components", ylabel="MB")
    figure.savefig(path, dpi=120)


def plot_power(axes: Axes, rows: Sequence[Row], over: str, column: str, label: str) -> None:
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


def plot_vector(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each task: steps per second of all environments, native and Gymnasium's."""
    panels = {str(task): own for (task,), own in grouped(rows, "task").items()}
    _plot_vector_panels(path, panels, {"native": "native", "sync": "SyncVectorEnv"}, width=3.6)


def plot_slow(path: Path, rows: Sequence[Row]) -> None:
    """A panel for each sleep: steps per second of all environments, in processes and in one."""
    panels = {
        f"a step sleeps {sleep:g} ms": own for (sleep,), own in grouped(rows, "sleep_ms").items()
    }
    _plot_vector_panels(path, panels, {"async": "a process each", "sync": "one by one"}, width=4.6)


def _plot_vector_panels(
    path: Path, panels: Mapping[str, Sequence[Row]], labels: Mapping[str, str], *, width: float
) -> None:
    """Rates of two ways in a panel for each title, `width` inches wide."""
    figure = Figure(figsize=(width * len(panels), 3.4), layout="constrained")
    all_axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axes, (title, own) in zip(all_axes, panels.items(), strict=True):
        _plot_vector_rates(axes, own, labels)
        axes.set_title(title, fontsize=9)
    all_axes[0].set_ylabel("environment steps per second")
    figure.savefig(path, dpi=120)


def _plot_vector_rates(axes: Axes, rows: Sequence[Row], labels: Mapping[str, str]) -> None:
    """Rates against the number of environments, of two ways: what is shown, and what it beats."""
    groups = grouped(rows, "num_envs")
    numbers = [float(str(number)) for (number,) in groups]
    for (name, label), color in zip(labels.items(), (HIGHLIGHT, GREY), strict=True):
        column = f"{name}_steps_per_second"
        rates = [[row[column] for row in own] for own in groups.values()]
        middle = np.median(rates, axis=1)
        axes.errorbar(
            numbers, middle, _reach(rates), marker="o", capsize=2, color=color, label=label
        )
    _use_logarithms(axes, numbers)
    axes.set_xlabel("environments")
    axes.legend(fontsize=8, loc="upper left")


def _plot_rates(
    axes: Axes, groups: Mapping[str, Sequence[Row]], highlighted: Sequence[str]
) -> None:
    """A bar for each group: its steps per second."""
    rates = [[row["steps_per_second"] for row in own] for own in groups.values()]
    middle = np.median(rates, axis=1)
    colors = [HIGHLIGHT if name in highlighted else GREY for name in groups]
    bars = axes.barh(list(groups), middle, xerr=_reach(rates), color=colors, capsize=3)
    axes.bar_label(bars, fmt="%.0f", label_type="center", color="white")
    axes.spines[["top", "right"]].set_visible(False)


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
