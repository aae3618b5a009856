"""All tasks of a study together."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from deep_curiosity.experiments.grid import summary_of
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.experiments.together import (
    LEVELS,
    _latest,
    _profile,
    are_comparable,
    complete_agents,
    have_joint_curve,
    plot_together,
    summarize_together,
)
from deep_curiosity.training import Config

SHORT = Config.of(total_steps=1_000, learning_starts=100)
TASKS = [Task("maze", SHORT, 10.0), Task("hill", SHORT.override(total_steps=2_000), 100.0)]
STUDY = Study(TASKS, {"bold": {}, "shy": {}}, columns=("evaluation_return",), curves=True)
RETURNS = {
    ("maze", "bold"): 20.0,
    ("hill", "bold"): 50.0,
    ("maze", "shy"): 0.0,
    ("hill", "shy"): 0.0,
}


def rows_of(study=STUDY, seeds=2):
    return [
        {"task": task.name, "agent": agent, "seed": seed, "evaluation_return": value}
        | {"solved": int(value >= task.solved_return), "area": value / 2}
        for seed in range(seeds)
        for task in study.tasks
        for agent in study.agents
        for value in [RETURNS[task.name, agent]]
    ]


def test_returns_are_in_units_of_what_counts_as_solved():
    header, _, bold, shy = summarize_together(STUDY, rows_of())[0].splitlines()
    assert (
        header
        == "| all tasks | runs solved | evaluation return, solved is 1 | area, solved is 1 |"
    )
    # two runs at 20 of 10, two at 50 of 100; the middle half is one of each
    assert bold == "| bold | 2 of 4 | 1.25 [1.25, 1.25] | 0.625 [0.625, 0.625] |"
    assert shy == "| shy | 0 of 4 | 0 [0, 0] | 0 [0, 0] |"


def test_an_agent_without_the_seeds_of_the_others_is_left_out_and_named():
    rows = rows_of()
    assert complete_agents(STUDY, rows) == ["bold", "shy"]
    of_one_task = [row for row in rows if row["task"] == "maze"]
    assert complete_agents(STUDY, of_one_task) == []
    for agent, other in (("bold", "shy"), ("shy", "bold")):  # the first one, too
        lost = [row for row in rows if (row["agent"], row["seed"]) != (agent, 0)]
        assert complete_agents(STUDY, lost) == [other]
        text = "\n".join(summarize_together(STUDY, lost))
        assert f"Without all runs, and left out: {agent}." in text


def test_agents_with_as_many_runs_of_other_seeds_are_not_paired():
    rows = [row for row in rows_of(seeds=3) if row["seed"] != (2 if row["agent"] == "bold" else 0)]
    assert complete_agents(STUDY, rows) == []  # neither has all seeds that there are


@pytest.mark.parametrize(
    "study",
    [
        replace(STUDY, tasks=TASKS[:1]),
        replace(STUDY, tasks=[TASKS[0], Task("hill", SHORT)]),
        replace(STUDY, tasks=[TASKS[0], Task("hill", SHORT, 0.0)]),
        replace(STUDY, tasks=[TASKS[0], Task("hill", SHORT, -200.0)]),
        replace(STUDY, label="hunger"),
    ],
)
def test_what_cannot_be_compared_is_not(study):
    assert are_comparable(STUDY) and not are_comparable(study)
    assert summarize_together(study, []) == []


def test_a_task_that_is_shown_apart_counts_by_itself_alone():
    apart = replace(TASKS[1], is_shown_apart=True)
    study = replace(STUDY, tasks=[*TASKS[:1], replace(TASKS[0], name="cave"), apart])
    rows = rows_of() + [row | {"task": "cave"} for row in rows_of() if row["task"] == "maze"]
    summary = summary_of(study, rows)
    assert "| hill | bold | 0 of 2 | 50 [50, 50] |" in summary
    assert "| bold | 4 of 4 | 2 [2, 2] | 1 [1, 1] |" in summary
    assert "| shy | 1 [1, 1] |" in summary  # bold better than it
    assert replace(study, tasks=[apart]).joint.tasks == [apart]


def test_what_a_study_measures_otherwise_has_no_joint_mean():
    rows = [{**row, "area": None} for row in rows_of()]
    del rows[0]["evaluation_return"]
    assert summarize_together(STUDY, rows)[0].splitlines()[2] == "| bold | 2 of 4 |"


@pytest.fixture
def kept(monkeypatch):
    """The figures that are saved."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **options: figures.append(self))
    return figures


@pytest.fixture
def curves():
    return [
        {"task": task.name, "agent": agent, "seed": seed, "step": int(share * total)}
        | {"evaluation_return": share * RETURNS[task.name, agent]}
        for task in TASKS
        for total in [task.config.run.total_steps]
        for agent in STUDY.agents
        for seed in range(2)
        for share in (0.5, 1.0)
    ]


def test_curves_of_different_lengths_are_joined_at_shares_of_their_steps(kept, curves, tmp_path):
    plot_together(tmp_path / "figure.png", STUDY, rows_of(), curves)
    over_time, profile = kept[0].axes
    bold, shy = over_time.lines
    assert bold.get_ydata().tolist() == [0.0] * 10 + [0.625] * 10 + [1.25]
    assert shy.get_ydata().tolist() == [0.0] * 21
    levels, shares = profile.lines[0].get_data()
    reached = dict(zip(levels.round(2).tolist(), shares.tolist(), strict=True))
    assert (reached[0.0], reached[0.5], reached[0.55], reached[1.5]) == (1.0, 1.0, 0.5, 0.5)
    assert [text.get_text() for text in over_time.texts] == ["shy", "bold"]


def test_an_agent_keeps_its_colour_where_one_before_it_is_left_out(kept, curves, tmp_path):
    study = replace(STUDY, agents={"bold": {}, "absent": {}, "shy": {}})
    plot_together(tmp_path / "figure.png", study, rows_of(), curves)
    assert [line.get_color() for line in kept[0].axes[0].lines] == ["C0", "C2"]


def test_an_agent_with_a_run_without_evaluations_has_no_curve(kept, curves, tmp_path):
    lost = ("hill", "shy", 1)
    curves = [row for row in curves if (row["task"], row["agent"], row["seed"]) != lost]
    plot_together(tmp_path / "figure.png", STUDY, rows_of(), curves)
    over_time, profile = kept[0].axes
    assert [text.get_text() for text in over_time.texts] == ["bold"]
    assert len(profile.lines) == 2
    plot_together(tmp_path / "figure.png", STUDY, rows_of(), [])
    assert len(kept[1].axes[0].lines) == 0


def test_an_evaluation_past_the_last_step_of_several_environments_counts_at_the_end(
    kept, curves, tmp_path
):
    ends = {"maze": 1_000, "hill": 2_000}
    late = [
        row | {"step": row["step"] + 12 * (row["step"] == ends[row["task"]])} for row in curves
    ]
    plot_together(tmp_path / "figure.png", STUDY, rows_of(), late)
    assert kept[0].axes[0].lines[0].get_ydata()[-1] == 1.25


@pytest.mark.parametrize("value", [None, float("nan")], ids=str)
def test_a_run_without_a_return_is_counted_and_hides_no_column(kept, curves, tmp_path, value):
    rows = rows_of()
    assert (rows[0]["task"], rows[0]["agent"]) == ("maze", "bold")
    rows[0]["evaluation_return"] = value
    _, _, bold, shy = summarize_together(STUDY, rows)[0].splitlines()
    assert bold == "| bold | 2 of 4 | 1 [1, 1], 3 of 4 runs | 0.625 [0.625, 0.625] |"
    assert shy == "| shy | 0 of 4 | 0 [0, 0] | 0 [0, 0] |"
    plot_together(tmp_path / "figure.png", STUDY, rows, curves)
    assert kept[0].axes[1].lines[0].get_ydata()[0] == 0.75  # it ends above no level
    for row in rows:
        row["evaluation_return"] = value if row["task"] == "maze" else row["evaluation_return"]
    assert "| bold | 2 of 4 |  | 0.625" in summarize_together(STUDY, rows)[0]


def test_agents_that_each_lack_a_run_are_both_left_out():
    lost = [
        row for row in rows_of() if (row["agent"], row["seed"]) not in {("bold", 0), ("shy", 1)}
    ]
    assert complete_agents(STUDY, lost) == []
    assert summarize_together(STUDY, lost) == ["Without all runs, and left out: bold, shy.", ""]


def test_a_task_that_is_shown_apart_needs_no_return_of_its_own():
    apart = Task("other", SHORT, 1.0, is_shown_apart=True)
    study = replace(STUDY, tasks=[*TASKS, apart])
    others = [{"task": "other", "agent": "bold", "seed": 0, "evaluation_return": "?", "solved": 0}]
    rows = [row | {"evaluation_return": np.float32(row["evaluation_return"])} for row in rows_of()]
    assert have_joint_curve(study.joint, [*rows, *others])
    assert "evaluation return, solved is 1" in summarize_together(study.joint, [*rows, *others])[0]


def test_an_agent_with_steps_of_its_own_is_drawn_over_these():
    study = replace(STUDY, agents={"bold": {}, "long": {"total_steps": 4_000}}, tasks=TASKS[:1])
    curves = [
        {"task": "maze", "agent": "long", "seed": 0, "step": step, "evaluation_return": step / 100}
        for step in (1_000, 2_000, 3_000, 4_000)
    ]
    (latest,) = _latest(study, study.tasks[0], curves, "long")
    assert latest[[0, 4, 5, 10, 15, 20]] == pytest.approx([0.0, 0.0, 1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize("place", range(31))
def test_a_run_that_ends_exactly_at_a_level_reaches_it(place):
    tasks = [Task("maze", SHORT, 20.0), Task("hill", SHORT, 100.0)]
    study = replace(STUDY, tasks=tasks, agents={"bold": {}})
    rows = [
        {"task": task.name, "agent": "bold", "seed": 0}
        | {"evaluation_return": place * task.solved_return / 20}
        for task in tasks
    ]
    shares = [estimate.value for estimate in _profile(study, rows, "bold")]
    assert shares == [float(each <= place) for each in range(len(LEVELS))]
