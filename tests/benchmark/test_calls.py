import importlib.util
import json
import sys

import pytest

from deep_curiosity.benchmark.calls import (
    CONFIG,
    PACKAGE,
    CallRecorder,
    Function,
    describe_calls,
    describe_hops,
    find_hops,
    record_update,
)

MODULE = """
import json

def outer():
    for number in range(3):
        inner(number)
    return json.dumps([*numbers()])

def inner(number):
    return number

def numbers():
    yield inner(1)
"""


names_methods = pytest.mark.skipif(
    sys.version_info < (3, 11), reason="code knows no class that it belongs to"
)


@pytest.fixture
def module(tmp_path):
    path = tmp_path / "package" / "module.py"
    path.parent.mkdir()
    path.write_text(MODULE)
    spec = importlib.util.spec_from_file_location("module", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_calls_of_one_folder_are_counted(module, tmp_path):
    with CallRecorder(tmp_path / "package") as recorder:
        module.outer()
    names = {function.name: count for function, count in recorder.counts.items()}
    assert names == {"outer": 1, "inner": 4, "numbers": 2}  # a generator, up to each yield
    assert recorder.files == {"module.py"}
    assert recorder.depth == 3
    assert describe_calls(recorder).splitlines() == [
        "7 calls, 1 files, depth 3",
        "    7 module.py",
        "        4 inner",
        "        2 numbers",
        "        1 outer",
    ]


def test_the_stack_is_kept_at_landmarks_in_other_folders_too(module, tmp_path):
    with CallRecorder(tmp_path / "package", [json.dumps, module.inner]) as recorder:
        module.outer()
    outer, inner, numbers = (Function("module.py", name) for name in ("outer", "inner", "numbers"))
    assert recorder.stacks(json.dumps) == [[outer]]
    assert recorder.stacks(module.inner) == 3 * [[outer, inner]] + [[outer, numbers, inner]]


def test_another_profiler_is_restored(module, tmp_path):
    def other(frame, event, argument):
        pass

    before = sys.getprofile()
    sys.setprofile(other)
    try:
        with CallRecorder(tmp_path / "package"):
            module.outer()
        assert sys.getprofile() is other
    finally:
        sys.setprofile(before)


@names_methods
@pytest.mark.parametrize("prior", ["uniform", "learned"])
def test_an_update_stays_within_reach_of_a_reader(prior):
    recorder = record_update(CONFIG.override(prior=prior))
    assert recorder.counts[Function("training/learner.py", "Learner.update")] == 1
    assert recorder.counts.total() <= 150
    assert len(recorder.files) <= 12
    assert recorder.depth <= 9
    assert all((PACKAGE / file).exists() for file in recorder.files)
    assert not any(file.startswith("benchmark") for file in recorder.files)


@names_methods
def test_a_transition_hops_from_the_environment_through_replay_to_its_gradient():
    hops = find_hops()
    names = [hop.name for hop in hops]
    assert hops[0].file == "training/single_environment.py"
    assert names.index("Collector.step") < names.index("Learner.store")
    assert names.index("Learner.store") < names.index("Learner.update")
    assert names[-1] == "Adam.step"
    assert len(set(hops)) == len(hops) <= 11
    assert len({hop.file for hop in hops}) <= 6
    assert describe_hops(hops).startswith(f"{len(hops) - 1} hops, ")
