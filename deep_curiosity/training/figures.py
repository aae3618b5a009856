"""Pictures of a run, made from the files it left."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.environments import MADE_BY_FUNCTION, picture_features
from deep_curiosity.training.log import read_config, read_progress

PICTURE = "run.png"
MAX_POINTS = 20_000  # states plotted
BONUS_CURVES = {
    "curiosity/nats": "D (upper bound)",
    "curiosity/predictive_power": "predictive power",
    "curiosity/information_gain": "information gain",
}


def plot_run(folder: Path) -> Path:
    """Plot learning curve, bonus and its parts, and visited states of the run in a folder.

    Returns:
        Path of the PNG.
    """
    config = read_config(folder)
    columns = _columns(read_progress(folder))
    state = load_checkpoint(folder)
    figure = Figure(figsize=(13, 3.8), layout="constrained")
    returns, bonus, states = figure.subplots(1, 3)
    _plot_returns(returns, columns, state["run_log"]["episodes"])
    _plot_bonus(bonus, columns)
    replay = state["learner"]["replay"]
    if config.environment.env_id == MADE_BY_FUNCTION:
        window = state["collector"]["observation"].shape[-1]
        features = _ends_of_newest(window, replay, config.environment.frame_stack)
    else:
        features = picture_features(config.environment)
    _plot_states(states, _in_order(replay), features)
    title = f"{config.environment.env_id}, bonus {config.bonus.kind}, seed {config.run.seed}"
    figure.suptitle(title)
    path = folder / PICTURE
    figure.savefig(path, dpi=110)
    return path


def _ends_of_newest(window: int, replay: dict[str, Any], num_frames: int) -> tuple[int, int]:
    """First and last entry of the newest observation of a window of so many entries."""
    action_dim = replay["rows"].shape[-1] - 2 * window - 3  # reward and both ends are the others
    size = (window - (num_frames - 1) * action_dim) // num_frames
    return window - size, window - 1


def _in_order(replay: dict[str, Any]) -> np.ndarray:
    """Rows of a replay buffer from the oldest to the newest, which may stand before it."""
    rows = replay["rows"].numpy()
    return np.roll(rows, -(replay["num_added"] % max(1, len(rows))), axis=0)


def _columns(rows: list[dict[str, str]]) -> dict[str, np.ndarray]:
    names = rows[0] if rows else {}
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}


def _plot_returns(
    axes: Axes, columns: dict[str, np.ndarray], episodes: list[tuple[Any, ...]]
) -> None:
    """Return of every training episode, and of the evaluations."""
    axes.set(title="learning curve", xlabel="environment step", ylabel="return")
    if episodes:
        returns, lengths, *_ = zip(*episodes, strict=True)
        axes.plot(np.cumsum(lengths), returns, ".", alpha=0.4, label="training episode")
    if columns:
        evaluated = np.isfinite(columns["eval/return"])
        steps, values = columns["step"][evaluated], columns["eval/return"][evaluated]
        axes.plot(steps, values, ".-", color="black", label="evaluation")
    if episodes or columns:
        axes.legend(fontsize=8)


def _plot_bonus(axes: Axes, columns: dict[str, np.ndarray]) -> None:
    """Divergence in nats, and what it is made of."""
    axes.set(title="bonus and its parts", xlabel="environment step", ylabel="nats")
    plotted = [name for name in BONUS_CURVES if name in columns]
    for name in plotted:
        axes.plot(columns["step"], columns[name], ".-", label=BONUS_CURVES[name])
    if plotted:
        axes.set_ylim(bottom=0)
        axes.legend(fontsize=8)
    else:
        axes.text(0.5, 0.5, "no bonus", ha="center", va="center", transform=axes.transAxes)


def _plot_states(axes: Axes, rows: np.ndarray, features: tuple[int, int]) -> None:
    """Visited states in two features of the observation, coloured by when they were visited."""
    thinned = rows[:: max(1, len(rows) // MAX_POINTS)]
    age = np.linspace(0, 1, len(thinned))
    first, second = features
    points = axes.scatter(thinned[:, first], thinned[:, second], c=age, s=2, cmap="viridis")
    axes.set(
        title="visited states",
        xlabel=f"observation[{first}]",
        ylabel=f"observation[{second}]",
    )
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.colorbar(points, ax=axes, label="early to late", ticks=[])
