import pytest

pytest.importorskip("optuna")

from optuna.distributions import FloatDistribution

from deep_curiosity.experiments.search import ENDINGS, Search, check_out
from deep_curiosity.experiments.study import Task
from deep_curiosity.training import Config


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_that_are_none_of_a_search_are_left_alone(tmp_path, ending):
    (tmp_path / f"mine{ending}").write_text("task,agent\n")
    with pytest.raises(FileExistsError, match=rf"`out` must name new files.*mine{ending}; choose"):
        check_out(tmp_path / "mine")
    check_out(tmp_path / "mine2")


def test_files_of_an_earlier_search_may_be_written_over(tmp_path):
    (tmp_path / "mine.csv").write_text("trial,state,score\n")
    (tmp_path / "mine.json").write_text("{}")
    check_out(tmp_path / "mine")


PARTS = {
    "tasks": [Task("maze", Config())],
    "space": {"learning_rate": FloatDistribution(1e-4, 1e-2)},
    "ranges": {"maze": (0.0, 1.0)},
}


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"tasks": ["maze"]}, TypeError, "`tasks` must hold objects of Task, got 'maze'"),
        ({"space": ["hunger"]}, TypeError, r"`space` must have entries by name, got \['hunger'\]"),
        ({"ranges": [0, 1]}, TypeError, r"`ranges` must have entries by name, got \[0, 1\]"),
        ({"ranges": {"maze": (0.0,)}}, ValueError, r"two rising returns for maze, got \(0.0,\)"),
        ({"ranges": {"maze": "ab"}}, ValueError, "`ranges` must give two .* maze, got 'ab'"),
        ({"ranges": {"maze": ("0", "1")}}, ValueError, r"for maze, got \('0', '1'\)"),
        ({"ranges": {"maze": 5}}, ValueError, "two rising returns for maze, got 5"),
        ({"seeds": "2"}, TypeError, "`seeds` must be a whole number, got '2'"),
        ({"first_seed": 0.5}, TypeError, "`first_seed` must be a whole number, got 0.5"),
    ],
    ids=str,
)
def test_what_is_no_part_of_a_search_is_refused_by_name(changes, error, message):
    with pytest.raises(error, match=message):
        Search(**PARTS | changes)


def test_tasks_of_a_search_may_come_from_a_generator():
    search = Search(**PARTS | {"tasks": (task for task in PARTS["tasks"])})
    assert [*search.identity()["tasks"]] == ["maze"]
