import json
import math
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from deep_curiosity.training.config import Config
from deep_curiosity.training.log import (
    CONFIG,
    Log,
    open_folder,
    read_config,
    read_progress,
    read_values,
    write_json,
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
    with pytest.raises(FileNotFoundError, match=r"a run must have a config\.json, got .*none"):
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
    for step in (10, 20, 30):
        log.row(step, {"a": float(step)})
    log.close()
    log = Log(tmp_path, start=20)
    log.row(25, {"a": -1.0})
    log.close()
    assert [row["step"] for row in read_progress(tmp_path)] == ["10", "20", "25"]
    assert [row["a"] for row in read_progress(tmp_path)] == ["10.0", "20.0", "-1.0"]


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
