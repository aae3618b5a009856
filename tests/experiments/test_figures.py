import math

import pytest
from matplotlib.figure import Figure

from deep_curiosity.experiments import figures
from deep_curiosity.experiments.figures import _spread, plot_columns, plot_curves
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.training import Config

TASKS = [Task("maze", Config(), 1.0), Task("hill", Config())]


@pytest.fixture
def saved(monkeypatch):
    """The figure that is saved, to look at what is on it."""
    kept = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **options: kept.append(self))
    return kept


def test_every_agent_has_a_curve_with_its_name_beside_it(saved, tmp_path, make_rows):
    study = Study(TASKS, {"bold": {}, "shy": {}}, curves=True)
    curves = [
        {"task": task.name, "agent": agent, "seed": seed, "step": step}
        | {"evaluation_return": step + seed + len(agent)}
        for task in TASKS
        for agent in study.agents
        for seed in range(2)
        for step in (10, 20)
    ]
    plot_curves(tmp_path / "figure.png", study, make_rows(study, len), curves)
    maze, hill = saved[0].axes
    assert [line.get_ydata().tolist() for line in hill.lines] == [[14.5, 24.5], [13.5, 23.5]]
    assert len(maze.lines) == 3  # and the return from which the task counts as solved
    assert sorted(text.get_text() for text in maze.texts) == ["bold (1/2)", "shy (1/2)"]
    places = [text.xy[1] for text in maze.texts]
    assert abs(places[0] - places[1]) >= figures.LABEL_GAP - 1e-9


def test_a_single_evaluation_is_a_dot_with_its_interval(saved, tmp_path, make_rows):
    study = Study(TASKS[:1], {"bold": {}}, curves=True)
    key = {"task": "maze", "agent": "bold", "step": 10}
    curves = [key | {"seed": seed, "evaluation_return": 2.0 * seed} for seed in range(2)]
    plot_curves(tmp_path / "figure.png", study, make_rows(study, len), curves)
    (axes,) = saved[0].axes
    assert axes.lines[0].get_marker() == "."
    (whisker,) = axes.collections[-1].get_segments()
    assert whisker[:, 0].tolist() == [10, 10] and whisker[1, 1] - whisker[0, 1] > 0


def test_agents_with_names_stand_beneath_each_other(saved, tmp_path, make_rows):
    study = Study(TASKS[:1], {"bold": {}, "shy": {}}, columns=("coverage",))
    plot_columns(tmp_path / "figure.png", study, make_rows(study, len))
    (axes,) = saved[0].axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["bold", "shy"]
    assert axes.get_xlabel() == "coverage"


def test_values_of_a_sweep_stand_along_an_axis(saved, tmp_path, make_rows):
    study = Study(TASKS[:1], {0.5: {}, 2.0: {}}, label="hunger", columns=("coverage",))
    plot_columns(tmp_path / "figure.png", study, make_rows(study, float))
    (axes,) = saved[0].axes
    means = axes.lines[-1]
    assert means.get_xdata().tolist() == [0.5, 2.0] and means.get_ydata().tolist() == [1.0, 2.5]
    assert axes.get_xlabel() == "hunger"


def test_a_sweep_is_drawn_in_the_order_of_its_values(saved, tmp_path, make_rows):
    study = Study(TASKS[:1], {1.0: {}, 0.1: {}, 10.0: {}}, label="hunger", columns=("coverage",))
    plot_columns(tmp_path / "figure.png", study, make_rows(study, float))
    means = saved[0].axes[0].lines[-1]
    assert means.get_xdata().tolist() == [0.1, 1.0, 10.0]
    assert means.get_ydata().tolist() == pytest.approx([0.6, 1.5, 10.5])


def test_of_steps_that_some_run_never_reached_no_mean_of_the_others_is_drawn(
    saved, tmp_path, make_rows
):
    study = Study(TASKS[:1], {"bold": {}, "shy": {}}, columns=("first_success_step",))
    rows = make_rows(study, len)
    rows[0]["first_success_step"] = None
    plot_columns(tmp_path / "figure.png", study, rows)
    (axes,) = saved[0].axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["bold, 1 of 2", "shy"]
    means = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in means] == pytest.approx([math.nan, 3.5], nan_ok=True)


@pytest.mark.parametrize("wanted", [[0.99, 0.99, 1.0], [0.0, 0.5, 0.5], [0.2, 0.98], [-0.1, 0.3]])
def test_labels_lie_neither_upon_another_nor_past_the_top(wanted):
    halves = [0.03, 0.06, 0.03][: len(wanted)]
    places = _spread(wanted, halves)
    edges = [
        edge
        for place, half in zip(places, halves, strict=True)
        for edge in (place - half, place + half)
    ]
    assert edges == pytest.approx(sorted(edges))
    assert edges[-1] <= 1 + 1e-9
    alone = _spread([0.4], [0.03])
    assert alone == [0.4]


@pytest.mark.parametrize(
    "plot", [plot_curves, lambda path, study, rows, _: plot_columns(path, study, rows)]
)
def test_dollars_in_names_are_dollars(saved, tmp_path, make_rows, plot):
    study = Study([Task("$y^^$", Config())], {"$x^^$": {}}, columns=("coverage",), curves=True)
    key = {"task": "$y^^$", "agent": "$x^^$", "step": 10}
    curves = [key | {"seed": seed, "evaluation_return": 2.0 * seed} for seed in range(2)]
    plot(tmp_path / "figure.png", study, make_rows(study, len), curves)
    saved[0].draw_without_rendering()  # which reads mathematics, and refuses this
    assert saved[0].axes[0].get_title() == r"\$y^^\$"


def test_a_value_that_is_missing_is_in_no_figure(saved, tmp_path, make_rows):
    study = Study(TASKS[:1], {"bold": {}, "shy": {}}, columns=("coverage",))
    rows = make_rows(study, len)
    rows[0]["coverage"] = float("nan")
    plot_columns(tmp_path / "figure.png", study, rows)
    assert [line.get_xdata().tolist() for line in saved[0].axes[0].lines[:2]] == [[5.0], [5.0]]
