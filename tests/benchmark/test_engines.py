import pytest

from deep_curiosity.benchmark import engines
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.tables import read_table


def test_every_engine_has_its_turn_in_every_round(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(engines, "ENGINES", {"local, 1 worker": lambda: LocalEngine(1)})
    seconds = iter([4.0, 5.0])
    monkeypatch.setattr(engines, "time_study", lambda *_: next(seconds))
    engines.main(engines.Args(rounds=2, runs=2, steps=100, out=tmp_path / "engines.csv"))
    rows = read_table(tmp_path / "engines.csv")
    assert [(row["repeat"], row["steps_per_second"]) for row in rows] == [("0", "50"), ("1", "40")]
    assert capsys.readouterr().out.startswith("local, 1 worker: 4.5 [4, 5] s, 1 [1, 1] times")


@pytest.mark.slow
def test_a_study_is_timed_from_its_first_run_to_the_end_of_its_last(tmp_path):
    assert 0 < engines.time_study(lambda: LocalEngine(1), 1, 620, tmp_path) < 600


def test_a_study_with_a_run_that_fails_is_not_timed(tmp_path):
    (tmp_path / "runs/pendulum/curiosity").mkdir(parents=True)
    (tmp_path / "runs/pendulum/curiosity/seed0").write_text("in the place of the folder")
    with pytest.raises(RuntimeError, match="`runs` must come to their end"):
        engines.time_study(lambda: LocalEngine(1), 1, 620, tmp_path)
