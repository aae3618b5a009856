from deep_curiosity.benchmark import many_runs


def test_a_small_study_of_sleeping_runs_loses_none_and_is_near_its_bound(tmp_path, monkeypatch):
    monkeypatch.setattr(many_runs, "MINUTE", 0.01)
    monkeypatch.setattr(many_runs, "FAILING", 0.5)
    study = many_runs.make_study(agents=2, seeds=6)
    summary, rows = many_runs.simulate(study, tmp_path / "runs", workers=4)
    assert (summary["runs"], summary["failed"]) == (12, 0)
    assert summary["worker_deaths"] > 1
    assert 30 <= summary["bound_minutes"] < 33
    assert len((tmp_path / "runs/table.csv").read_text().splitlines()) == 1 + 12
    for folder in (tmp_path / "runs").glob("*/*/*"):
        steps = (folder / "progress.csv").read_text().split()[1:]
        assert [int(step) for step in steps] == [*range(100, 1_001, 100)]  # each minute once
    many_runs.plot(tmp_path / "picture.png", summary, rows)
    assert (tmp_path / "picture.png").exists()
