import json
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import deep_curiosity as dc
from deep_curiosity.trained.export import Actor
from deep_curiosity.training.config import Config
from deep_curiosity.training.windows import window_dim

pytest.importorskip("safetensors")
RNG = np.random.default_rng(0)
OBSERVATIONS = RNG.normal(size=(5, 3)).astype(np.float32)
OBSERVATIONS[3, 1] = -1e5  # absurd
HUNGER = np.array([0, 0.25, 0.5, 0.75, 1], np.float32)
CONDITIONED = {"hunger": "conditioned:0.5", "policy_mixture_components": 2}
RAW = {"normalize_observations": False}
RUNS = [{}, CONDITIONED | RAW, RAW, {"bonus": "none"}]


def run_torch(path, inputs):
    program = torch.export.load(path).module()
    return program(**{name: torch.from_numpy(value) for name, value in inputs.items()}).numpy()


def run_onnx(path, inputs):
    onnxruntime = pytest.importorskip("onnxruntime")
    (action,) = onnxruntime.InferenceSession(path).run(["action"], inputs)
    return action


RUNNERS = {".pt2": run_torch, ".onnx": run_onnx}


@pytest.mark.parametrize(
    ("suffix", "settings"),
    [
        (".onnx", {}),
        (".onnx", CONDITIONED),
        pytest.param(".onnx", RAW, marks=pytest.mark.slow),
        *((".pt2", settings) for settings in RUNS),
    ],
)
def test_a_file_gives_the_actions_of_the_policy(run_of, tmp_path, suffix, settings):
    folder = run_of(**settings)
    policy = dc.load(folder)
    if suffix == ".onnx":
        pytest.importorskip("onnxscript")
    path = dc.export(folder, tmp_path / f"policy{suffix}")
    given = {"hunger": HUNGER} if policy.is_conditioned else {}
    expected, _ = policy.predict(OBSERVATIONS, **given)
    inputs = {"observation": OBSERVATIONS}
    if policy.is_conditioned:
        inputs["hunger"] = HUNGER[:, None]
    action = RUNNERS[suffix](path, inputs)
    np.testing.assert_allclose(action, expected, rtol=0, atol=1e-6)
    first = {name: value[:1] for name, value in inputs.items()}
    np.testing.assert_allclose(RUNNERS[suffix](path, first), expected[:1], rtol=0, atol=1e-6)
    assert np.ptp(expected, axis=0).min() > 1e-3


@pytest.mark.parametrize("suffix", RUNNERS)
def test_a_file_gives_actions_as_fine_as_their_space(far_run, tmp_path, suffix):
    if suffix == ".onnx":
        pytest.importorskip("onnxscript")
    path = dc.export(far_run, tmp_path / f"policy{suffix}")
    action = RUNNERS[suffix](path, {"observation": OBSERVATIONS})
    policy = dc.load(far_run)
    np.testing.assert_allclose(action, policy.predict(OBSERVATIONS)[0], rtol=0, atol=1e-6)
    assert action.dtype == np.float64
    assert (action >= policy.spaces.action_low).all() and (
        action <= policy.spaces.action_high
    ).all()


def test_a_file_may_hold_the_curious_policy(run_of, tmp_path):
    path = dc.export(run_of(), tmp_path / "policy.pt2", curious=True)
    policy = dc.load(run_of())
    action = run_torch(path, {"observation": OBSERVATIONS})
    expected, _ = policy.predict(OBSERVATIONS, curious=True)
    np.testing.assert_allclose(action, expected, rtol=0, atol=1e-6)
    assert not np.allclose(action, policy.predict(OBSERVATIONS)[0], rtol=0, atol=1e-3)


def test_a_file_takes_windows_where_frames_were_stacked(run_of, tmp_path):
    folder = run_of(frame_stack=3)
    path = dc.export(folder, tmp_path / "policy.pt2")
    policy = dc.load(folder)
    _, state = policy.predict(OBSERVATIONS)
    expected, state = policy.predict(OBSERVATIONS + 0.1, state)
    window, _ = state
    assert window.shape == (5, window_dim(3, 2, 3))
    action = run_torch(path, {"observation": window})
    np.testing.assert_allclose(action, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("settings", [*RUNS, {"frame_stack": 3}, {"bonus": "rnd"}])
def test_a_folder_is_loaded_as_the_run_is(run_of, tmp_path, settings):
    folder = run_of(**settings)
    out = dc.export(folder, tmp_path / "policy")
    original, copy = dc.load(folder), dc.load(out)
    np.testing.assert_array_equal(original.predict(OBSERVATIONS)[0], copy.predict(OBSERVATIONS)[0])
    if original.has_curious_policy:
        curious = [each.predict(OBSERVATIONS, curious=True)[0] for each in (original, copy)]
        np.testing.assert_array_equal(*curious)
    if settings.get("bonus") != "none":
        state = dc.load_bonus(folder).state_dict()
        for name, value in dc.load_bonus(out).state_dict().items():
            torch.testing.assert_close(value, state[name], rtol=0, atol=0, equal_nan=True)


def test_a_folder_that_is_older_than_the_cut_of_absurd_numbers_acts_as_before(run_of, tmp_path):
    from safetensors.torch import load_file, save_file

    out = dc.export(run_of(), tmp_path / "policy")
    weights = load_file(out / "policy.safetensors")
    del weights["usual_observation"]
    save_file(weights, out / "policy.safetensors")
    now, before = (dc.load(each).predict(OBSERVATIONS)[0] for each in (run_of(), out))
    np.testing.assert_array_equal(now[:3], before[:3])
    assert not np.allclose(now[3], before[3], rtol=0, atol=1e-2)
    path = dc.export(out, tmp_path / "policy.pt2")
    action = run_torch(path, {"observation": OBSERVATIONS})
    np.testing.assert_allclose(action, before, rtol=0, atol=1e-6)


def test_the_model_goes_with_the_folder(run_of, tmp_path):
    out = dc.export(run_of(), tmp_path / "policy")
    action = [[1.0, 2.0]] * 5
    predictions = [dc.load_model(each).predict(OBSERVATIONS, action) for each in (run_of(), out)]
    for original, copy in zip(*predictions, strict=True):
        np.testing.assert_array_equal(original, copy)


def test_a_folder_says_nothing_of_where_it_was_made(run_of, tmp_path):
    out = dc.export(run_of(), tmp_path / "policy")
    values = json.loads((out / "config.json").read_text())
    assert values["env_id"] == "trained/Slope-v0"
    assert values.keys().isdisjoint({"out", "device", "init_from"})
    again = dc.export(out, tmp_path / "again")
    assert {path.name: path.read_bytes() for path in again.iterdir()} == {
        path.name: path.read_bytes() for path in out.iterdir()
    }


def test_an_exported_policy_is_no_run_to_continue(run_of, tmp_path):
    out = dc.export(run_of(), tmp_path / "policy")
    with pytest.raises(
        ValueError, match=r"got .*policy, which is an exported policy: deep_curios"
    ):
        dc.continue_run(out)
    assert not (out / "checkpoint.pt").exists()


def test_the_format_may_be_named(run_of, tmp_path):
    path = dc.export(run_of(), tmp_path / "policy.bin", format="torch")
    action = run_torch(path, {"observation": OBSERVATIONS})
    np.testing.assert_allclose(action, dc.load(run_of()).predict(OBSERVATIONS)[0], atol=1e-6)


@pytest.mark.parametrize("name", ["policy.pt", "policy.safetensors", "policy.bin"])
def test_an_ending_that_says_nothing_is_refused(run_of, tmp_path, name):
    with pytest.raises(ValueError, match=r"`out` must end in \.onnx or \.pt2, or name a folder"):
        dc.export(run_of(), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_an_ending_may_be_written_large_and_a_folder_have_a_number(run_of, tmp_path):
    assert dc.export(run_of(), tmp_path / "policy.PT2").is_file()
    assert dc.export(run_of(), tmp_path / "v1.2").is_dir()


def test_actions_of_a_file_lie_in_the_box_of_the_task(run_of):
    actor = Actor(dc.load(run_of()))
    low, high = torch.tensor([-0.7, -0.7]), torch.tensor([1.3, 2.7])
    actor.low, actor.high = low, high
    for sign in (-1e3, 1e3):
        with torch.no_grad():
            actor.layers[-1].bias.fill_(sign)
        action = actor(torch.zeros(4, 3))
        assert (action >= low).all() and (action <= high).all()


def test_a_home_folder_is_understood(run_of, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert dc.export(run_of(), "~/policy") == tmp_path / "policy"
    assert dc.load("~/policy").predict(OBSERVATIONS)[0].shape == (5, 2)
    assert Config.of(out="~/run").run.out == tmp_path / "run"
    assert Config.of(out=Path("~/run")).run.out == tmp_path / "run"


def test_a_home_folder_of_nobody_is_a_folder_of_that_name(run_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    unknown = "~nobody-of-this-name/policy"
    with pytest.raises(FileNotFoundError, match=r"`folder` must be .*got ~nobody-of-this-name/po"):
        dc.load(unknown)
    assert dc.export(run_of(), unknown) == Path(unknown)
    assert dc.load(unknown).predict(OBSERVATIONS)[0].shape == (5, 2)


@pytest.mark.parametrize("name", ["policy.pt2", "policy", "sub/policy.pt2"])
def test_a_file_in_the_place_of_a_folder_is_named(run_of, tmp_path, name):
    file = tmp_path / "file.sh"
    file.write_text("a script")
    with pytest.raises(OSError, match=r"`out` must be where all can be written, got .*policy"):
        dc.export(run_of(), file / name)
    assert file.read_text() == "a script"


def test_what_is_no_path_is_named(run_of):
    with pytest.raises(TypeError, match=r"`folder` must be a path, got None\."):
        dc.load(None)
    with pytest.raises(TypeError, match=r"`out` must be a path, got 3\."):
        dc.export(run_of(), 3)


def test_what_cannot_be_written_is_refused(run_of, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(FileExistsError, match="`out` must not be there yet, got "):
        dc.export(run_of(), tmp_path / "there")
    for folder, out in ((run_of(bonus="none"), "policy.pt2"), (run_of(), "policy")):
        with pytest.raises(ValueError, match="`curious` must be False for a run with one policy"):
            dc.export(folder, tmp_path / out, curious=True)
    assert not (tmp_path / "policy").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="sizes of files are limited by POSIX alone")
@pytest.mark.parametrize("out", ["policy.pt2", "policy.onnx", "policy"])
def test_a_disk_that_is_full_is_named_and_nothing_is_left(run_of, tmp_path, out):
    import resource

    folder = run_of()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"`out` must be where all can be .*policy"):
            dc.export(folder, tmp_path / "there" / out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert not any((tmp_path / "there").iterdir())


@pytest.mark.parametrize(("package", "out"), [("onnx", "policy.onnx"), ("safetensors", "policy")])
def test_what_is_missing_is_named(run_of, tmp_path, monkeypatch, package, out):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"{package} .*pip install 'deep-curiosity\[export\]'"):
        dc.export(run_of(), tmp_path / out)
