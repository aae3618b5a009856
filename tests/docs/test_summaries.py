"""Summaries beside the tables of studies: each is what its rows give today."""

import re
from dataclasses import replace

import pytest

from deep_curiosity.experiments.grid import summary_of
from deep_curiosity.experiments.studies import find_study
from deep_curiosity.experiments.tables import read_table
from tests.docs.pages import ROOT

FOLDERS = ("docs/study", "docs/development", "docs/results", "docs/sweeps")
TABLES = {  # whose names are not those of their studies
    "noise-curiosity": "noise",
    "noise-uniform": "noise",
    "harm-learned": "harm",
    "harm-default": "harm",
    "harm-units": "harm",
    "overlap": "results",
    "cartpole_sparse": "goals",
    "overlap_dense": "results_dense",
    "uniform_prior": "results",
    "steady_share": "results",
    "raw_observations": "results",
    "one-nat": "development",
    "shared-prior": "development",
    "half-life-4": "development",
    "half-life-30": "development",
    "curiosity-steps-8": "development",
    "curiosity-discount-99": "development",
    "goals-shared-prior": "goals",
    "units-from-1": "units",
    "units-from-third": "units",
    "units-kept": "units",
    "information-gain": "development",
    "cartpole-swingup": "development",
    "units-eight": "units",
    "units-deviations": "units",
    "units-unshifted": "units",
    "greedy-share": "development",
    "harm-greedy-share": "harm",
}


def rows_of(path):
    return [{name: typed(value) for name, value in row.items()} for row in read_table(path)]


def typed(value):
    """A number where there is one; nothing where there is nothing."""
    try:
        return float(value)
    except ValueError:
        return value or None


def tables():
    """Tables that name the commit of each row; older ones were summarised otherwise."""
    paths = [path for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.csv"))]
    return {
        str(path.relative_to(ROOT)): path
        for path in paths
        if path.with_suffix(".md").exists() and "commit" in rows_of(path)[0]
    }


def part_with_rows(name, rows):
    """The study of the tasks and agents that its table has, tasks in the order of the table."""
    study = find_study(name)[1]
    tasks, agents = (
        {task.name: task for task in study.tasks},
        {str(row[study.label]) for row in rows},
    )
    return replace(
        study,
        tasks=[tasks[name] for name in dict.fromkeys(row["task"] for row in rows)],
        agents={agent: own for agent, own in study.agents.items() if str(agent) in agents},
    )


@pytest.mark.parametrize("path", tables().values(), ids=tables())
def test_the_summary_is_that_of_the_rows(path):
    rows = rows_of(path)
    for row in rows:  # as it is written where no return counts as solved
        row["solved"] = "" if row["solved"] is None else int(row["solved"])
    study = part_with_rows(TABLES.get(path.stem, path.stem), rows)
    expected = summary_of(study, rows)
    found = [
        re.split(r"([-+]?\d[\d.]*(?:e[-+]?\d+)?)", text)
        for text in (expected.strip(), path.with_suffix(".md").read_text().strip())
    ]
    assert found[0][::2] == found[1][::2]
    numbers = [[float(number) for number in parts[1::2]] for parts in found]
    assert numbers[0] == pytest.approx(numbers[1], rel=2e-3)  # rows are rounded to six digits


def test_there_are_tables_to_look_at():
    assert {"docs/study/goals.csv", "docs/study/sparse.csv"} <= set(tables())


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*_curves.csv")), ids=str)
def test_the_agents_of_a_task_have_points_at_the_same_evaluations(path):
    steps = {}
    for row in read_table(path):
        label = next(name for name in row if name not in ("task", "seed"))
        steps.setdefault((row["task"], row[label]), set()).add(row["step"])
    schedules = {task: own for (task, _), own in steps.items()}
    assert all(own == schedules[task] for (task, _), own in steps.items())
