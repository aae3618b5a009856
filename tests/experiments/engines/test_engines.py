import sys
from types import SimpleNamespace

import pytest

from deep_curiosity import requirements
from deep_curiosity.experiments.engines import EngineArgs, LocalEngine, make_engine
from deep_curiosity.experiments.engines.base import Outcome, make_job
from tests.experiments.engines import functions


@pytest.mark.parametrize(("name", "package"), [("ray", "ray"), ("slurm", "submitit")])
def test_an_engine_whose_package_is_missing_names_the_command(
    name, package, monkeypatch, tmp_path
):
    monkeypatch.setattr(requirements, "find_spec", lambda wanted: None)
    with pytest.raises(ImportError, match=rf"{package}.*pip install 'deep-curiosity\[{name}\]'"):
        make_engine(EngineArgs(engine=name), tmp_path)


def test_processes_of_this_machine_are_the_default(tmp_path):
    with make_engine(EngineArgs(workers=3), tmp_path) as engine:
        assert isinstance(engine, LocalEngine) and engine.workers == 3


def test_files_of_slurm_lie_below_the_folder_that_is_meant(tmp_path, monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.setenv("HOME", str(tmp_path))
    args = EngineArgs(engine="slurm", engine_options=("cluster=local",))
    with make_engine(args, "~/runs") as engine:
        assert engine._executor.folder == tmp_path / "runs" / "slurm"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": "auto"}, "`address` must be left out without the engine ray, got auto"),
        ({"engine_options": ("a=1",)}, "`engine_options` must be left out for .*local, got a"),
    ],
    ids=str,
)
def test_what_would_do_nothing_is_refused(options, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        make_engine(EngineArgs(**options), tmp_path)


def test_an_option_that_is_no_pair_is_refused_by_its_own_name(tmp_path):
    message = "`engine_options` must be written as name=value, got 'foo'"
    with pytest.raises(ValueError, match=message):
        make_engine(EngineArgs(engine_options=("foo",)), tmp_path)


def test_a_job_that_calls_sys_exit_has_failed_and_ctrl_c_is_no_failure():
    assert make_job(functions.leave).run() == Outcome(error="SystemExit: 0")
    with pytest.raises(KeyboardInterrupt):
        make_job(functions.interrupt).run()


@pytest.mark.parametrize(
    "option", ["nonsense=3", "slurm_nonsense=1", "cluster=nix", "timeout_min=soon", "folder=x"]
)
def test_what_slurm_does_not_take_is_refused_by_the_name_of_the_option(option, tmp_path):
    pytest.importorskip("submitit")
    message = f"`engine_options` must be what the engine slurm takes, got {option}: "
    with pytest.raises(ValueError, match=message):
        make_engine(EngineArgs(engine="slurm", engine_options=(option,)), tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"engine_options": ("nonsense=3",)}, "`engine_options` must be .*ray takes, got nons"),
        ({"engine_options": ("runs_per_gpu=x",)}, "`engine_options` must be .*got runs_per_gpu=x"),
        ({"engine_options": ("address=auto",)}, "`engine_options` must be .*got address=auto: "),
        ({"address": "garbage"}, "`address` must be what the engine ray takes, got garbage: Unk"),
    ],
    ids=str,
)
def test_what_ray_does_not_take_is_refused_by_the_name_of_the_option(
    options, message, tmp_path, monkeypatch
):
    def init(**given):
        raise RuntimeError("Unknown keyword argument(s)")

    ray = SimpleNamespace(__spec__=object(), is_initialized=lambda: False, init=init)
    monkeypatch.setitem(sys.modules, "ray", ray)
    with pytest.raises(ValueError, match=message):
        make_engine(EngineArgs(engine="ray", **options), tmp_path)
