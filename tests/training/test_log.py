import json
import math
import os
import time
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from deep_curiosity.training.config import YOUNGER, Config, config_key
from deep_curiosity.training.log import (
    CONFIG,
    ORPHAN_SECONDS,
    PROGRESS,
    WRITTEN,
    Log,
    open_folder,
    progress_up_to,
    read_config,
    read_progress,
    read_values,
    write_json,
    write_text,
    written_whole,
)


def test_a_run_reads_its_settings_back_wherever_it_was_moved(tmp_path):
    config = Config.of(bonus="rnd", seed=3, hunger="linear:1:10", out=tmp_path / "run")
    assert open_folder(config) == tmp_path / "run"
    assert read_config(tmp_path / "run") == config
    assert read_values(tmp_path / "run") == config.to_json()
    (tmp_path / "run").rename(tmp_path / "moved")
    assert read_config(tmp_path / "moved") == config.override(out=tmp_path / "moved")


def test_a_folder_that_holds_a_run_is_not_opened_again(tmp_path):
    open_folder(Config.of(out=tmp_path))
    with pytest.raises(FileExistsError, match=r"`out` must not hold a run already.*--resume"):
        open_folder(Config.of(out=tmp_path, seed=1))
    assert read_config(tmp_path).run.seed == 0


def test_a_folder_without_settings_or_with_others_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"`folder` must be .* has a config\.json, got"):
        read_config(tmp_path)
    write_json(tmp_path / CONFIG, {"history": 3})
    with pytest.raises(ValueError, match=r"config\.json: `history` is no setting here"):
        read_config(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hiden_dim": 8}, "`hiden_dim` is no setting here, the nearest is hidden_dim"),
        ({"self": 1}, "`self` is no setting here"),
        ({"preset": "exact"}, "`preset` is no setting here"),
        ({"deduplicate": "no"}, "`deduplicate` must be bool, got 'no'"),
        ({"hidden_dim": "64"}, "`hidden_dim` must be int, got '64'"),
        ({"hidden_dim": 3.5}, "`hidden_dim` must be int, got 3.5"),
        ({"hidden_dim": True}, "`hidden_dim` must be int, got True"),
        ({"hidden_dim": None}, "`hidden_dim` must be int, got None"),
        ({"hidden_dim": 10**9}, "`hidden_dim` must be at most 16384, got 1000000000"),
        ({"learning_rate": math.nan}, "`learning_rate` must be finite, got nan"),
        ({"learning_rate": 10**400}, "`learning_rate` must be finite, got inf"),
        ({"env_kwargs": {"a": math.inf}}, "`env_kwargs` must be finite, got inf"),
        ({"features": [1.5]}, "`features` must be tuple"),
        ({"env_id": "a\0b"}, "`env_id` must have characters, and no NUL"),
        ({"bonus": None}, "`bonus` must be a name or a BonusConfig, got None"),
        ({"bonus": "luck"}, "`bonus` must be one of curiosity, .*got 'luck'"),
    ],
    ids=str,
)
def test_a_file_with_a_setting_that_cannot_be_is_named_with_it(tmp_path, change, message):
    write_json(tmp_path / CONFIG, Config().to_json() | change)
    with pytest.raises(ValueError, match=rf"{tmp_path}/config\.json: {message}"):
        read_config(tmp_path)


@pytest.mark.parametrize("name", ["seed", "bonus", "hidden_dim", "noise_floor"])
def test_a_setting_that_is_missing_in_a_file_is_named(tmp_path, name):
    values = Config().to_json()
    del values[name]
    write_json(tmp_path / CONFIG, values)
    with pytest.raises(ValueError, match=rf"config\.json: `{name}` must be there, such as"):
        read_config(tmp_path)


def test_a_run_from_before_a_setting_goes_on_without_it(tmp_path):
    config = Config.of(seed=3, **YOUNGER)
    values = config.to_json()
    for name, value in YOUNGER.items():
        assert values.pop(name) == value
    write_json(tmp_path / CONFIG, values)
    assert config_key(read_values(tmp_path)) == config_key(config.to_json())
    assert read_config(tmp_path) == config.override(out=tmp_path)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"frame_stack": 3, "features": (0, 1)}, "window"),
        ({"frame_stack": 3}, "newest"),
        ({"features": (0, 1)}, "newest"),
    ],
)
def test_entries_of_a_run_from_before_are_those_of_its_window(tmp_path, settings, expected):
    values = Config.of(**settings).to_json()
    del values["features_of"]
    write_json(tmp_path / CONFIG, values)
    assert read_config(tmp_path).bonus.features_of == expected
    write_json(tmp_path / CONFIG, Config.of(**settings).to_json())
    assert read_config(tmp_path).bonus.features_of == "newest"


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\0\0\0", b"\xff\xfe", b"[1]", b"null", b'{"seed": 1, "seed": 2}', b"[" * 99_999],
    ids=lambda content: repr(content[:9]),
)
def test_a_file_that_holds_no_settings_is_named(tmp_path, content):
    (tmp_path / CONFIG).write_bytes(content)
    with pytest.raises(
        ValueError, match=rf"`config.json` must hold settings in JSON, got {tmp_path}"
    ):
        read_config(tmp_path)


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "values.json"
    write_json(path, {"a": 1, "where": Path("b")})
    assert json.loads(path.read_text()) == {"a": 1, "where": "b"}
    with pytest.raises(TypeError):
        write_json(path, {("no", "key"): 2})
    assert json.loads(path.read_text()) == {"a": 1, "where": "b"}


def test_several_may_write_one_file_and_that_of_the_last_stands(tmp_path):
    path = tmp_path / "values.csv"
    with written_whole(path) as last:
        last.write_text("last")
        with written_whole(path) as first:
            first.write_text("first")
        assert path.read_text() == "first"
    assert path.read_text() == "last"
    assert [*tmp_path.iterdir()] == [path]


def test_what_killed_processes_have_left_of_a_file_is_removed(tmp_path):
    path, now = tmp_path / "values[1].csv", time.time()
    ages = {
        "values[1].0123abcd.partial.csv": 2 * ORPHAN_SECONDS,
        "values[1].4567abcd.partial.csv": ORPHAN_SECONDS / 2,  # perhaps of one that writes
        "values[1].of_mine.partial.csv": 2 * ORPHAN_SECONDS,
        "values1.0123abcd.partial.csv": 2 * ORPHAN_SECONDS,
    }
    for name, age in ages.items():
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (now - age, now - age))
    write_text(path, "whole")
    left = {*ages, path.name} - {"values[1].0123abcd.partial.csv"}
    assert {each.name for each in tmp_path.iterdir()} == left


def test_rows_have_the_columns_of_the_first(tmp_path):
    log = Log(tmp_path)
    assert read_progress(tmp_path) == []
    log.row(10, {"a": 1.5, "b": 2.0})
    log.row(20, {"b": 3.0, "c": 4.0})
    log.close()
    assert read_progress(tmp_path) == [
        {"step": "10", "a": "1.5", "b": "2.0"},
        {"step": "20", "a": "", "b": "3.0"},
    ]


def test_a_continued_log_drops_what_came_after_its_start(tmp_path):
    log = Log(tmp_path)
    for step in (10, 20):
        log.row(step, {"a": float(step)})
    progress = log.progress
    log.row(30, {"a": 30.0})
    log.close()
    log = Log(tmp_path, resumed_at=20, progress=progress)
    log.row(25, {"a": -1.0})
    log.close()
    assert [row["step"] for row in read_progress(tmp_path)] == ["10", "20", "25"]
    assert [row["a"] for row in read_progress(tmp_path)] == ["10.0", "20.0", "-1.0"]
    assert (tmp_path / PROGRESS).read_bytes().decode() == log.progress


DAMAGES = {
    "cut within a row": lambda content: content[:-9],
    "emptied": lambda content: b"",
    "zeros at its end": lambda content: content[:-9] + bytes(9),
    "a flipped digit": lambda content: content.replace(b"20.0", b"21.0"),
    "a row twice": lambda content: content + content.splitlines(keepends=True)[-1],
    "no text": lambda content: b"\xff\xfe" + content,
    "missing": None,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_progress_is_mended_from_the_checkpoint(tmp_path, damage):
    log = Log(tmp_path)
    for step in (10, 20):
        log.row(step, {"a": float(step), "b": None})
    log.close()
    path, whole = tmp_path / PROGRESS, (tmp_path / PROGRESS).read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(DAMAGES[damage](whole))
    if damage == "a row twice":  # as a row that was written after the checkpoint
        Log(tmp_path, resumed_at=20, progress=log.progress).close()
    else:
        with pytest.warns(UserWarning, match=r"progress\.csv was (damaged|missing); it is mended"):
            Log(tmp_path, resumed_at=20, progress=log.progress).close()
    assert path.read_bytes() == whole


def test_damaged_progress_is_kept_beside_the_mended_one(tmp_path):
    (tmp_path / PROGRESS).write_text("my own notes")
    with pytest.warns(UserWarning, match=r"what was there is in .*progress\.csv\.damaged"):
        Log(tmp_path, resumed_at=1, progress="step,a\r\n1,2.0\r\n").close()
    assert (tmp_path / f"{PROGRESS}.damaged").read_text() == "my own notes"


def test_progress_is_never_emptied_to_be_written(tmp_path, monkeypatch):
    log = Log(tmp_path)
    log.row(10, {"a": 1.0})
    progress = log.progress
    log.row(20, {"a": 2.0})
    log.close()
    whole = (tmp_path / PROGRESS).read_bytes()
    monkeypatch.setattr("deep_curiosity.training.log.os.fsync", lambda number: 1 / 0)
    with pytest.raises(ZeroDivisionError):  # as if killed while what is new is written
        Log(tmp_path, resumed_at=10, progress=progress)
    assert (tmp_path / PROGRESS).read_bytes() == whole


@pytest.mark.parametrize(
    "row", ["30,1.0", "30,1.0,2.0,3.0", "30,1.0,x", "\0\0\0", "-3,1,1", "x,1,1"]
)
def test_rows_that_are_none_are_named(tmp_path, row):
    (tmp_path / PROGRESS).write_text(f"step,a,b\r\n10,1.0,\r\n20,nan,2.0\r\n{row}\r\n")
    with pytest.raises(ValueError, match=r"got row 4 of .*progress\.csv.*--resume mends"):
        read_progress(tmp_path)
    assert progress_up_to(tmp_path, 10) == "step,a,b\r\n10,1.0,\r\n"
    assert progress_up_to(tmp_path, 90) == "step,a,b\r\n10,1.0,\r\n20,nan,2.0\r\n"
    assert progress_up_to(tmp_path, 9) == ""


@pytest.mark.parametrize("name", WRITTEN)
def test_a_folder_with_files_that_a_run_would_write_over_is_refused(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(FileExistsError, match=r"`out` must (hold no file|not hold a run)"):
        open_folder(Config.of(out=tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


def test_other_files_in_the_folder_are_left_alone(tmp_path):
    (tmp_path / "job.out").write_text("mine")
    open_folder(Config.of(out=tmp_path))
    assert (tmp_path / "job.out").read_text() == "mine"


@pytest.mark.parametrize("below", [".", "deeper/still"])
def test_a_file_in_the_place_of_the_folder_is_named(tmp_path, below):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OSError, match=r"`out` must name a folder .*, got .*file"):
        open_folder(Config.of(out=tmp_path / "file" / below))
    assert (tmp_path / "file").read_text() == "mine"


def test_scalars_are_events_under_their_tags(tmp_path):
    log = Log(tmp_path)
    for step in (1, 2):
        log.scalars(step, {"eval/return": 10.0 * step, "agent/hunger": 1.0})
    log.close()
    events = EventAccumulator(str(tmp_path)).Reload()
    assert set(events.Tags()["scalars"]) == {"eval/return", "agent/hunger"}
    assert [(e.step, e.value) for e in events.Scalars("eval/return")] == [(1, 10.0), (2, 20.0)]


def test_a_folder_without_progress_has_no_rows(tmp_path):
    assert read_progress(tmp_path) == []
