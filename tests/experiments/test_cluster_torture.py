"""A Ray cluster of two nodes on this machine, where workers and a node are killed as runs train.

With Ray they are slow: it takes some seconds to start, and every killed run a few to go on.
"""

import os
from dataclasses import replace

import pytest

from deep_curiosity.experiments.cluster_torture import (
    KILLS,
    Loss,
    compare,
    make_study,
    page,
    torture_cluster,
    two_nodes,
    working,
)
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.tables import read_table
from deep_curiosity.training.lease import Lease

LOSSES = [Loss(kind, 1.0, 0, "pendulum/none/seed0 at step 40") for kind in KILLS]


@pytest.fixture
def cluster():
    pytest.importorskip("ray")
    with two_nodes() as cluster:
        yield cluster


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # whatever Ray and its killed processes leave behind
def test_a_study_on_a_cluster_that_loses_workers_and_a_node_ends_with_the_same_table(
    cluster, tmp_path
):
    comparison = torture_cluster(make_study(1, 200), tmp_path, cluster, pause=3.0)
    assert [loss.kind for loss in comparison.losses] == [*KILLS]
    assert all(" at step " in loss.lost for loss in comparison.losses)
    assert comparison.runs == comparison.rows == comparison.equal_rows == 4
    assert comparison.points == comparison.equal_points == 4 * 2
    assert comparison.cells == comparison.equal_cells > 4 * 10 * 2
    assert comparison.is_sound


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_run_that_raises_is_listed_and_the_others_go_on(cluster, tmp_path):
    study = make_study(1, 60)
    agents = {"lost": {"env_id": "NoSuchTask"}, "none": {"bonus": "none"}}
    places = {"runs": tmp_path / "runs", "out": tmp_path / "out"}
    engine = cluster.engine()
    assert run_study(replace(study, tasks=study.tasks[:1], agents=agents), **places, engine=engine)
    assert [row["agent"] for row in read_table(tmp_path / "out.csv")] == ["none"]


def write(folder, *, table, curves="step\n1\n", progress="step,time/steps_per_second\n20,1.0\n"):
    run = folder / "runs" / "pendulum" / "none" / "seed0"
    run.mkdir(parents=True)
    (folder / "out.csv").write_text(table)
    (folder / "out_curves.csv").write_text(curves)
    (run / "progress.csv").write_text(progress)


SAME = {"table": "return,wall_seconds\n" + 4 * "1.5,3.0\n"}


@pytest.mark.parametrize(
    ("other", "is_sound"),
    [
        ({}, True),
        ({"table": "return,wall_seconds\n" + 4 * "1.5,9.0\n"}, True),  # slower
        ({"table": "return,wall_seconds\n" + 3 * "1.5,3.0\n" + "1.6,3.0\n"}, False),
        ({"table": "return,wall_seconds\n" + 3 * "1.5,3.0\n"}, False),  # lost
        ({"table": "return,wall_seconds\n" + 5 * "1.5,3.0\n"}, False),  # there twice
        ({"curves": "step\n2\n"}, False),
        ({"progress": "step,time/steps_per_second\n20,2.0\n"}, True),
        ({"progress": "step,time/steps_per_second\n40,1.0\n"}, False),
        ({"progress": "step,time/steps_per_second\n20,1.0\n20,1.0\n"}, False),
    ],
)
def test_whatever_differs_but_for_times_is_counted(tmp_path, other, is_sound):
    write(tmp_path / "local", **SAME)
    write(tmp_path / "ray", **SAME | other)
    assert compare(make_study(1, 60), tmp_path, LOSSES).is_sound == is_sound
    assert not compare(make_study(1, 60), tmp_path, LOSSES[:2]).is_sound


def test_the_page_tells_what_was_killed_and_how_much_is_equal(tmp_path):
    for side in ("local", "ray"):
        write(tmp_path / side, **SAME)
    text = page(compare(make_study(1, 60), tmp_path, LOSSES), "python it.py")
    assert "| node | 1 | 0 | pendulum/none/seed0 at step 40 |" in text
    assert "4 of 4 rows are equal" in text and "python it.py" in text
    assert "Columns that differ" not in text


def test_columns_of_the_table_that_differ_are_named(tmp_path):
    write(tmp_path / "local", table="return,commit,wall_seconds\n1.5,a,3.0\n")
    write(tmp_path / "ray", table="return,commit,wall_seconds\n1.5,b,9.0\n")
    comparison = compare(make_study(1, 60), tmp_path, LOSSES)
    assert comparison.differing == ["commit"]
    assert "Columns that differ: commit." in page(comparison, "python it.py")


def test_processes_are_at_work_that_hold_a_run_with_a_step(tmp_path):
    begun, new = (tmp_path / name for name in ("begun", "new"))
    for folder, rows in ((begun, "step\n20\n"), (new, "step\n")):
        folder.mkdir()
        (folder / "progress.csv").write_text(rows)
    leases = [Lease(begun), Lease(new)]
    assert working(tmp_path) == {os.getpid(): begun}
    for lease in leases:
        lease.release()
    assert working(tmp_path) == {}
