import json

import pytest

from deep_curiosity.experiments import runs
from deep_curiosity.experiments.runs import (
    RunStoppedError,
    find_finished,
    finished_key,
    measure_area,
    run_foreign,
    run_once,
    run_own,
    scheduled_evaluations,
)
from deep_curiosity.experiments.study import Cell, Study, Task
from deep_curiosity.training import train
from deep_curiosity.training.lease import LeaseError
from deep_curiosity.training.log import open_folder


def test_a_folder_with_a_run_of_other_settings_is_refused(tiny):
    run_once(tiny.override(total_steps=30))
    with pytest.raises(FileExistsError, match="differs in batch_size, num_members; move it away"):
        run_once(tiny.override(batch_size=16, num_members=3))
    assert run_once(tiny.override(total_steps=40))["total_steps"] == 40  # the same run, continued


def test_a_longer_run_is_none_to_stand_for_a_shorter_one(tiny):
    run_once(tiny.override(total_steps=40))
    with pytest.raises(
        FileExistsError, match=r"than the 30 steps that are wanted, got .* taken 40"
    ):
        run_once(tiny.override(total_steps=30))


@pytest.mark.parametrize("name", ["hunger", "temperature"])
def test_a_run_whose_schedule_would_be_stretched_is_not_continued(tiny, name):
    scheduled = tiny.override(**{name: "linear:1:0.1"})
    run_once(scheduled.override(total_steps=30))
    with pytest.raises(FileExistsError, match="differs in total_steps; move it away"):
        run_once(scheduled.override(total_steps=40))


def test_steps_that_several_environments_take_together_make_no_longer_run(tiny):
    several = tiny.override(num_envs=4, total_steps=30)
    summary = run_once(several)
    assert summary["total_steps"] == 32 and run_once(several)["total_steps"] == 32


def test_a_finished_run_is_read(tiny, monkeypatch):
    summary = run_once(tiny)
    monkeypatch.setattr(runs, "train", None)
    assert run_once(tiny) == json.loads(json.dumps(summary))


DAMAGED = ["", '{"total_st', "{}", "[]", '{"total_steps": 60}', '{"total_steps": null}']


@pytest.mark.parametrize("text", DAMAGED, ids=repr)
def test_a_run_whose_summary_is_damaged_is_finished_again(tiny, text):
    summary = run_once(tiny)
    progress = (tiny.run.out / "progress.csv").read_bytes()
    (tiny.run.out / "summary.json").write_text(text)
    again = run_once(tiny)
    assert again["evaluation_return"] == summary["evaluation_return"]
    assert json.loads((tiny.run.out / "summary.json").read_text()) == again
    assert (tiny.run.out / "progress.csv").read_bytes() == progress
    for checkpoint in tiny.run.out.glob("checkpoint*.pt"):
        checkpoint.write_bytes(b"damaged")
    (tiny.run.out / "summary.json").write_text("[]")
    with pytest.raises(ValueError, match=r"`summary.json` must be .*, got .*run/summary.json, wh"):
        run_once(tiny)


def test_a_finished_run_that_has_lost_its_progress_is_none_to_measure(tiny):
    task = Task("pendulum", tiny)
    cell = Cell(Study([task], {"a": {}}, seeds=1), task, "a", 0, tiny.run.out)
    path = tiny.run.out / "progress.csv"
    assert len(run_own(cell).curve) == 2
    whole = path.read_bytes()
    header, *rows = whole.splitlines(keepends=True)
    path.write_bytes(whole.replace(b"\r\n40,", b"\r\ninf,"))
    with pytest.raises(ValueError, match=r"`step` must be a whole .* inf .*progress\.csv, which"):
        run_own(cell)
    for left in (b"", header[:20], header, header + rows[0]):
        path.write_bytes(left)
        with pytest.raises(
            ValueError, match=r"`progress.csv` must .* last step .*, 60, got .*run"
        ):
            run_own(cell)
    path.unlink()
    with pytest.raises(ValueError, match="missing or ends at step 0; --resume mends it"):
        run_own(cell)
    with pytest.warns(UserWarning, match=r"progress.csv was missing; it is mended"):
        train(tiny, resume=True, show_progress=False)
    assert path.read_bytes() == whole and len(run_own(cell).curve) == 2


def test_a_run_that_is_stopped_is_none_to_measure_and_goes_on(tiny):
    with pytest.raises(RunStoppedError, match=r"must reach its 60 steps .* stopped at step 40"):
        run_once(tiny, on_evaluation=lambda step, values: True)
    assert run_once(tiny)["total_steps"] == 60


OLD = ("g without versions", '{"total_steps": 60}')


def finish(config, steps=None):
    """Leave what a run that has ended leaves, without training."""
    open_folder(config)
    total_steps = config.run.total_steps if steps is None else steps
    summary = {"total_steps": total_steps, "versions": {"deep-curiosity": "1", "commit": None}}
    (config.run.out / "summary.json").write_text(json.dumps(summary))


def test_a_run_of_the_same_settings_is_found_wherever_it_lies(tiny, tmp_path):
    there = tiny.override(env_id="PointMaze", env_kwargs={}, out=tmp_path / "runs" / "other study")
    finish(there.override(matmul_precision="high"))
    finished = find_finished(tmp_path / "runs")
    wanted = there.override(out=tmp_path / "runs" / "here")
    assert finished[finished_key(wanted)] == there.run.out
    assert finished_key(wanted.override(seed=1)) not in finished


def test_a_curve_has_what_every_seed_has_and_the_last_step(tiny, monkeypatch):
    found = [(20, 1.0), (30, 2.0), (40, 3.0), (55, 4.0)]  # a run that ended at step 30 once
    monkeypatch.setattr("deep_curiosity.experiments.runs.read_evaluations", lambda _: found)
    config = tiny.override(evaluation_interval=20)
    assert scheduled_evaluations(config, last=55) == [(20, 1.0), (40, 3.0), (55, 4.0)]
    assert scheduled_evaluations(config) == [(20, 1.0), (40, 3.0)]


def test_the_area_is_of_scheduled_evaluations_alone(tiny, monkeypatch):
    progress = [{"step": step, "eval/return": step / 10} for step in (20, 40, 45, 60)]
    monkeypatch.setattr(runs, "read_progress", lambda folder: progress)
    config = tiny.override(evaluation_interval=20)
    assert measure_area(config, {"evaluation_return": 7.0}) == [
        {"area": pytest.approx(4.0), "evaluation_return": 7.0}
    ]


def test_another_library_s_result_is_kept_and_one_of_other_settings_refused(tiny, tmp_path):
    def cell(settings):
        study = Study([Task("maze", tiny)], {"theirs": settings}, run=run_theirs)
        return Cell(study, study.tasks[0], "theirs", 3, tmp_path / "cell")

    def run_theirs(cell):
        return run_foreign(cell, trained)

    calls = []

    def trained(cell):
        calls.append(cell.seed)
        return {"evaluation_return": 1.0}, [{"step": 5, "evaluation_return": 1.0}]

    first, again = (run_foreign(cell({"kind": "SAC"}), trained) for _ in range(2))
    assert calls == [3] and first == again
    assert first.rows == [{"evaluation_return": 1.0}]
    with pytest.raises(FileExistsError, match="no result of other settings"):
        run_foreign(cell({"kind": "TD3"}), trained)
    for text in ("{", "[]", "{}"):
        (tmp_path / "cell" / "result.json").write_text(text)
        with pytest.raises(ValueError, match=r"whole, got .*cell/result\.json, which is"):
            run_foreign(cell({"kind": "SAC"}), trained)


@pytest.mark.parametrize("value", ["nan", ""], ids=str)
def test_a_run_without_a_return_has_no_area(tiny, monkeypatch, value):
    monkeypatch.setattr(runs, "read_progress", lambda _: [{"step": 20, "eval/return": value}])
    config = tiny.override(evaluation_interval=20)
    (row,) = measure_area(config, {"evaluation_return": None})
    assert row == {"area": None, "evaluation_return": None}


def test_only_runs_that_have_come_to_their_end_are_found(tiny, tmp_path):
    finish(tiny.override(out=tmp_path / "b whole"))
    open_folder(tiny.override(out=tmp_path / "a begun"))
    finish(tiny.override(out=tmp_path / "c stopped"), steps=20)
    for name, text in (("d torn", '{"total_st'), ("e other", "[]"), ("f empty", "{}"), OLD):
        open_folder(tiny.override(out=tmp_path / name))
        (tmp_path / name / "summary.json").write_text(text)
    assert find_finished(tmp_path) == {finished_key(tiny): tmp_path / "b whole"}


def test_a_run_that_another_process_begins_meanwhile_is_held(tiny, tmp_path, monkeypatch):
    def train(config, **options):
        open_folder(config)  # by the other process, since it was looked for
        open_folder(config)

    monkeypatch.setattr(runs, "train", train)
    with pytest.raises(LeaseError, match=r"begun by two processes .* not hold a run already"):
        run_once(tiny.override(out=tmp_path / "both"))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "progress.csv").touch()
    with pytest.raises(FileExistsError, match="no file that a run would write over"):
        run_once(tiny.override(out=tmp_path / "mine"))


def test_a_finished_run_is_found_behind_a_link(tiny, tmp_path):
    there = tiny.override(out=tmp_path / "elsewhere" / "run")
    finish(there)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "linked").symlink_to(tmp_path / "elsewhere")
    assert find_finished(tmp_path / "runs") == {
        finished_key(there): tmp_path / "runs" / "linked" / "run"
    }
