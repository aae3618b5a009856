import pytest

from deep_curiosity.benchmark import engines
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.tables import read_table


def test_every_runner_has_its_turn_and_is_compared_within_a_round(tmp_path, monkeypatch, capsys):
    seconds = iter([4.0, 5.0, 3.0, 5.0])
    turns = []
    names = ("local, 1 worker", "local, 2 workers")
    for name in names:
        timed = lambda *turn: turns.append(turn) or next(seconds)  # noqa: E731
        monkeypatch.setitem(engines.TIMED, name, timed)
    engines.main(
        engines.Args(rounds=2, runs=2, steps=100, runners=names, out=tmp_path / "engines.csv")
    )
    rows = read_table(tmp_path / "engines.csv")
    assert [(row["runner"], row["repeat"], row["steps_per_second"]) for row in rows] == [
        ("local, 1 worker", "0", "25"),
        ("local, 2 workers", "0", "40"),
        ("local, 2 workers", "1", "66.6667"),
        ("local, 1 worker", "1", "20"),
    ]
    assert [runs for runs, *_ in turns] == [1, 2, 2, 1]
    assert "local, 2 workers: 4 [3, 5] s, 2.467 [1.6, 3.333] times" in capsys.readouterr().out


def test_without_one_worker_there_is_nothing_to_compare_with(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(engines.TIMED, "local, 2 workers", lambda *turn: 4.0)
    out = tmp_path / "engines.csv"
    arguments = engines.Args(rounds=1, runs=2, steps=100, runners=("local, 2 workers",), out=out)
    engines.main(arguments)
    assert "local, 2 workers: 4 [4, 4] s\n" in capsys.readouterr().out
    out.write_text("mine,and\n1,2\n")
    with pytest.raises(FileExistsError, match="`out` must name new files"):
        engines.main(arguments)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"runs": 1}, "`runs` must be at least 2, .* got 1"),
        ({"rounds": 0}, "`rounds` must be at least 1, got 0"),
        ({"steps": 0}, "`steps` must be at least 1, got 0"),
    ],
)
def test_what_cannot_be_timed_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        engines.Args(**settings)


@pytest.mark.slow
def test_a_study_is_timed_from_its_first_run_to_the_end_of_its_last(tmp_path):
    assert 0 < engines.time_study(lambda: LocalEngine(1), 1, 620, tmp_path) < 600


@pytest.mark.slow
def test_two_processes_do_the_same_runs_without_an_engine(tmp_path):
    assert 0 < engines.time_processes(2, 620, tmp_path) < 600
    assert {path.parent.name for path in tmp_path.rglob("summary.json")} == {"seed0", "seed1"}


def test_a_study_with_a_run_that_fails_is_not_timed(tmp_path):
    (tmp_path / "runs/pendulum/curiosity").mkdir(parents=True)
    (tmp_path / "runs/pendulum/curiosity/seed0").write_text("in the place of the folder")
    with pytest.raises(RuntimeError, match="`runs` must come to their end"):
        engines.time_study(lambda: LocalEngine(1), 1, 620, tmp_path)
