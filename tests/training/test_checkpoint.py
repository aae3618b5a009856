import pytest
import torch

from deep_curiosity.training import checkpoint
from deep_curiosity.training.checkpoint import NEWEST, PREVIOUS, load_checkpoint, save_checkpoint


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
    with pytest.raises(FileNotFoundError, match=r"`resume` must name a folder.*it holds none"):
        load_checkpoint(tmp_path)
    (tmp_path / NEWEST).write_bytes(b"no archive")
    with pytest.raises(FileNotFoundError, match="is damaged"):
        load_checkpoint(tmp_path)


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), RuntimeError("write")])
def test_a_full_disk_costs_no_checkpoint(tmp_path, monkeypatch, error):
    save_checkpoint(tmp_path, {"step": 1})

    def full(state, file):
        file.write(b"half of it")
        raise error

    monkeypatch.setattr(checkpoint.torch, "save", full)
    with pytest.raises(OSError, match="could not be written"):
        save_checkpoint(tmp_path, {"step": 2})
    monkeypatch.undo()
    assert load_checkpoint(tmp_path)["step"] == 1
    assert [path.name for path in tmp_path.iterdir()] == [NEWEST]
