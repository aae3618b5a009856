import io
import random
import warnings
from pathlib import Path

import pytest
import torch

from deep_curiosity.training import checkpoint
from deep_curiosity.training.checkpoint import (
    ASIDE,
    NEWEST,
    PREVIOUS,
    load_checkpoint,
    load_weights,
    save_checkpoint,
)
from deep_curiosity.training.lease import LeaseError


def test_the_newest_is_loaded_and_the_one_before_it_kept(tmp_path):
    for step in range(3):
        save_checkpoint(tmp_path, {"step": step, "weights": torch.full((2,), float(step))})
    assert load_checkpoint(tmp_path)["step"] == 2
    assert torch.load(tmp_path / PREVIOUS)["step"] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [PREVIOUS, NEWEST]


@pytest.mark.parametrize("length", [0, 100, 700])
def test_a_truncated_one_gives_way_to_the_one_before_it(tmp_path, length):
    for step in range(2):
        save_checkpoint(tmp_path, {"step": step})
    newest = tmp_path / NEWEST
    newest.write_bytes(newest.read_bytes()[:length])
    with pytest.warns(UserWarning, match="is damaged"):
        assert load_checkpoint(tmp_path)["step"] == 0


def test_without_a_readable_one_the_damage_is_told(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"`folder` must name a folder.*it holds none"):
        load_checkpoint(tmp_path)
    (tmp_path / NEWEST).write_bytes(b"no archive")
    with pytest.raises(FileNotFoundError, match="is damaged"):
        load_checkpoint(tmp_path)
    (tmp_path / PREVIOUS).write_bytes(b"")
    with pytest.raises(FileNotFoundError, match=rf"{NEWEST} is damaged .*; .*{PREVIOUS} is dam"):
        load_checkpoint(tmp_path)


def test_weights_of_another_size_are_refused_in_a_line(tmp_path):
    kept, part = torch.nn.Linear(2, 3).state_dict(), torch.nn.Linear(2, 4)
    with pytest.raises(ValueError, match=r"^`config\.json` in .*: size mismatch for weight.*\.$"):
        load_weights(part, kept, tmp_path)
    with pytest.raises(ValueError, match=r'got others: Missing key\(s\) in state_dict: "bias"'):
        load_weights(torch.nn.Linear(2, 3), {"weight": kept["weight"]}, tmp_path)


def flipped(content, bit):
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def same(first, second):
    return first["step"] == second["step"] and torch.equal(first["weights"], second["weights"])


@pytest.mark.parametrize("checksum", ["of all", "of the entries, as earlier versions wrote"])
def test_any_flipped_bit_is_detected_or_harmless(tmp_path, checksum):
    states = [{"step": step, "weights": torch.randn(40, 40)} for step in (1, 2)]
    for state in states:
        save_checkpoint(tmp_path, state)
    newest = tmp_path / NEWEST
    whole = newest.read_bytes()
    if checksum != "of all":
        whole = whole[: -len(checkpoint.DIGEST_MARK) - checkpoint.DIGEST_LENGTH]
    chance, detected = random.Random(0), 0
    for bit in chance.sample(range(8 * len(whole)), 200):
        newest.write_bytes(flipped(whole, bit))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            loaded = load_checkpoint(tmp_path)
        told = [str(warning.message) for warning in caught if warning.category is UserWarning]
        assert same(loaded, states[0 if told else 1]), bit
        assert not told or f"{newest} is damaged" in told[0]
        detected += len(told)
    assert detected > (180 if checksum == "of all" else 100)


def test_one_that_is_damaged_does_not_take_the_place_of_the_one_before_it(tmp_path):
    for step in range(2):
        save_checkpoint(tmp_path, {"step": step})
    (tmp_path / NEWEST).write_bytes(b"")
    with pytest.warns(UserWarning, match="is damaged"):
        load_checkpoint(tmp_path)
    assert (tmp_path / NEWEST).read_bytes() == b""  # who only reads changes nothing
    with pytest.warns(UserWarning, match="is damaged"):
        load_checkpoint(tmp_path, mend=True)
    save_checkpoint(tmp_path, {"step": 2})
    (tmp_path / NEWEST).write_bytes(b"")
    with pytest.warns(UserWarning, match="is damaged"):
        assert load_checkpoint(tmp_path)["step"] == 0


def test_one_that_could_not_be_read_this_time_is_put_aside(tmp_path, monkeypatch):
    def failing(path):
        if path.name == NEWEST:
            raise OSError(5, "Input/output error")
        check_digest(path)

    for step in range(2):
        save_checkpoint(tmp_path, {"step": step})
    check_digest = checkpoint._check_digest
    with monkeypatch.context() as disk, pytest.warns(UserWarning, match="Input/output error"):
        disk.setattr(checkpoint, "_check_digest", failing)
        assert load_checkpoint(tmp_path, mend=True)["step"] == 0
    (tmp_path / ASIDE).replace(tmp_path / NEWEST)
    assert load_checkpoint(tmp_path)["step"] == 1


def test_one_that_may_not_be_written_leaves_what_is_there(tmp_path):
    def refuse():
        raise LeaseError("another holds the folder")

    save_checkpoint(tmp_path, {"step": 1})
    with pytest.raises(LeaseError, match="another"):
        save_checkpoint(tmp_path, {"step": 2}, check=refuse)
    assert load_checkpoint(tmp_path)["step"] == 1
    assert [path.name for path in tmp_path.iterdir()] == [NEWEST]


def test_a_file_that_holds_something_else_is_no_checkpoint(tmp_path):
    torch.save([1, 2], tmp_path / NEWEST)
    with pytest.raises(FileNotFoundError, match=r"`out` must name a folder.*holds a list and no"):
        load_checkpoint(tmp_path, argument="out")


def test_what_a_killed_process_has_half_written_is_deleted(tmp_path):
    (tmp_path / f"{NEWEST}.0123.partial").write_bytes(b"half of it")
    save_checkpoint(tmp_path, {"step": 1})
    assert [path.name for path in tmp_path.iterdir()] == [NEWEST]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), RuntimeError("write")])
def test_a_full_disk_costs_no_checkpoint(tmp_path, monkeypatch, error):
    save_checkpoint(tmp_path, {"step": 1})

    def full(state, file):
        file.write(b"half of it")
        raise error

    monkeypatch.setattr(checkpoint.torch, "save", full)
    with pytest.raises(OSError, match=f"could not be written: .*{error.args[-1]}"):
        save_checkpoint(tmp_path, {"step": 2})
    monkeypatch.undo()
    assert load_checkpoint(tmp_path)["step"] == 1
    assert [path.name for path in tmp_path.iterdir()] == [NEWEST]


def test_it_is_told_why_a_checkpoint_could_not_be_written(tmp_path, monkeypatch):
    class Full(io.BytesIO):
        def write(self, content):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "open", lambda path, mode: Full())
    with pytest.raises(OSError, match=r"could not be written: .*No space left on device"):
        save_checkpoint(tmp_path, {"step": 1, "weights": torch.zeros(9)})
