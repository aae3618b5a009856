import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from deep_curiosity.experiments.grid import cells_of, check_measure
from deep_curiosity.experiments.studies import (
    FOLDERS,
    comparisons,
    development,
    find_search,
    find_study,
    illustrations,
    results,
    sweeps,
)
from deep_curiosity.training.environments import make_environment, observation_dim

MODULES = comparisons, development, sweeps, illustrations, results
OURS = {name: study for module in MODULES for name, study in module.STUDIES.items()}
PROTOCOL = Path(__file__).parents[3] / "docs/results/protocol.md"
OWN = """
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.training import Config

STUDIES = {"own": Study([Task("maze", Config.of(env_id="PointMaze"))], {"default": {}})}
"""


@pytest.mark.parametrize("name", OURS)
def test_every_run_of_a_study_has_settings_that_can_be(tmp_path, name):
    check_measure(OURS[name])
    cells = cells_of(replace(OURS[name], seeds=1), tmp_path / "runs" / name)
    assert len({cell.folder for cell in cells}) == len(cells)
    for cell in cells:
        assert cell.config.run.seed == cell.seed


@pytest.mark.parametrize("name", OURS)
def test_a_study_is_found_by_its_name(name):
    found, study, folder = find_study(name)
    assert (found, study) == (name, OURS[name])
    assert folder in FOLDERS.values()


def test_names_of_studies_are_unique():
    assert len(OURS) == sum(len(module.STUDIES) for module in MODULES)


def test_a_name_that_is_none_is_answered_with_those_there_are():
    with pytest.raises(ValueError, match=r"`study` must be a file or one of .*got 'dense2'"):
        find_study("dense2")


def test_a_study_of_one_s_own_is_read_from_its_file(tmp_path):
    path = tmp_path / "study_of_my_own.py"
    path.write_text(OWN)
    name, study, _ = find_study(str(path))
    assert name == "own" and study.tasks[0].name == "maze"
    with pytest.raises(ValueError, match=r"`study` must be one of own in .*got 'other'"):
        find_study(f"{path}:other")
    with pytest.raises(FileNotFoundError, match="file that exists"):
        find_study(str(tmp_path / "missing.py"))


def test_colons_may_be_in_the_path_of_a_study_of_one_s_own(tmp_path):
    folder = tmp_path / "a:b"
    folder.mkdir()
    path = folder / "study_behind_a_colon.py"
    path.write_text(OWN)
    for name in (str(path), f"{path}:own"):
        assert find_study(name)[0] == "own"
    with pytest.raises(FileNotFoundError, match=r"got C:\\me\\mine\.py\."):
        find_study(r"C:\me\mine.py")


def test_colons_may_be_in_the_path_of_a_search_of_one_s_own(tmp_path):
    pytest.importorskip("optuna")
    with pytest.raises(FileNotFoundError, match=r"`search` must name .*/a:b/mine\.py\."):
        find_search(f"{tmp_path}/a:b/mine.py:own")


def test_cells_of_the_pendulum_tile_angle_and_speed():
    cells = {
        sweeps.pendulum_cell(np.array([np.cos(angle), np.sin(angle), speed]))
        for angle in np.linspace(-np.pi, np.pi, 1_000)
        for speed in np.linspace(-4, 4, 100)
    }
    assert cells == {(angle, speed) for angle in range(24) for speed in range(16)}


def test_cells_of_a_room_are_counted_once_each():
    rows = torch.tensor(
        [[-1.0, -1.0, 9.0], [-0.81, -0.81, 9.0], [0.01, 1.0, 9.0], [1.0, 1.0, 9.0]]
    )
    assert sweeps.cell_share(rows) == 3 / 100


def test_the_exact_policy_stays_three_quarters_of_the_time_where_curiosity_looks_far():
    assert illustrations.exact_pi_stay(0.0) == pytest.approx(0.5, abs=1e-3)
    assert illustrations.exact_pi_stay(0.97) == pytest.approx(0.745, abs=0.01)


def test_tasks_are_those_of_the_protocol_with_its_budgets():
    rows = re.findall(
        r"^\| .* \| (\d[\d ]*) \| (\d+)(?: of [\d ]+)? \|", PROTOCOL.read_text(), re.M
    )
    stated = [(int(steps.replace(" ", "")), float(solved)) for steps, solved in rows]
    tasks = results.SPARSE_TASKS
    assert stated == [(task.config.run.total_steps, task.solved_return) for task in tasks]


@pytest.mark.parametrize("task", results.SPARSE_TASKS, ids=lambda task: task.name)
def test_networks_are_as_wide_as_the_protocol_says(task):
    if task.name.startswith("dm_control/"):
        pytest.importorskip("shimmy")
    if task.name.startswith(("PointMaze_", "Adroit")):
        pytest.importorskip("gymnasium_robotics")
    entries = observation_dim(make_environment(task.config.environment))
    is_wide = entries > results.MOST_ENTRIES
    assert task.config.agent.hidden_dim == (results.WIDE if is_wide else results.NARROW)


def test_nothing_that_is_reported_was_looked_at_to_choose_defaults():
    chosen_on = {task.name for task in (*development.TASKS, *development.DENSE_TASKS)}
    both = {task.name for task in results.SPARSE_TASKS} & chosen_on
    assert both == {"MountainCarContinuous-v0"}  # which the protocol says


def test_a_file_is_found_below_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "study_at_home.py").write_text(OWN)
    assert find_study("~/study_at_home.py:own")[0] == "own"


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        (
            "up.py",
            "{'../../up': STUDY}",
            r"names that folders can have, got '\.\./\.\./up' in .*up",
        ),
        ("number.py", "{1: STUDY}", "`study` must hold STUDIES by names .*, got 1 in .*number"),
        ("nothing.py", "{}", r"must hold STUDIES, each a Study by its name, got .*nothing\.py"),
        (
            "my.study.py",
            "{'a': STUDY}",
            r"`study` must be a file whose name .* got .*my\.study\.py",
        ),
    ],
)
def test_a_file_whose_name_or_studies_names_cannot_be_is_refused(tmp_path, name, table, message):
    path = tmp_path / f"refused_{name}"
    path.write_text(f"{OWN}STUDY = STUDIES['own']\nSTUDIES = {table}\n")
    with pytest.raises(ValueError, match=message):
        find_study(str(path))
