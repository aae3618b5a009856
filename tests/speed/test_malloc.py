import subprocess
import sys
from pathlib import Path

import pytest

from deep_curiosity.speed import malloc
from deep_curiosity.speed.malloc import memory_kept
from tests.speed.programs import output_of

HUGE_PAGES = Path("/sys/kernel/mm/transparent_hugepage/enabled")
TAKE = "blocks = [torch.ones(5_000_000) for _ in range(3)]"  # 60 MB
pytestmark = pytest.mark.skipif(
    not Path("/proc/self/smaps_rollup").exists(), reason="is not Linux"
)


def printed_number(*lines):
    """What a fresh process prints, which keeps its memory."""
    code = [
        "import torch",
        "from deep_curiosity.speed.malloc import memory_kept",
        "with memory_kept():",
        *(f"    {line}" for line in lines),
    ]
    command = [sys.executable, "-c", "\n".join(code)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_freed_memory_does_not_return_page_by_page():
    faults = printed_number(
        "from resource import RUSAGE_SELF, getrusage",
        TAKE,
        "del blocks",
        "before = getrusage(RUSAGE_SELF).ru_minflt",
        TAKE,
        "print(getrusage(RUSAGE_SELF).ru_minflt - before)",
    )
    assert faults < 5_000  # a third of the pages that were freed, however large they are


@pytest.mark.skipif(
    not HUGE_PAGES.exists() or "[never]" in HUGE_PAGES.read_text(),
    reason="the system grants no huge pages",
)
def test_memory_lies_in_huge_pages():
    kilobytes = printed_number(
        TAKE,
        "from pathlib import Path",
        "lines = Path('/proc/self/smaps_rollup').read_text().splitlines()[1:]",
        "sizes = dict(line.split(':') for line in lines)",
        "print(sizes['AnonHugePages'].split()[0])",
    )
    assert kilobytes > 50_000


KEPT_TWICE = """
import torch
from pathlib import Path
from deep_curiosity.speed.malloc import memory_kept

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

def freed():
    before = resident()
    blocks = [torch.ones(1_000_000) for _ in range(15)]  # 60 MB
    del blocks
    return resident() - before

for _ in range(2):
    before = resident()
    with memory_kept():
        print("inside", freed() > 40)
    print("behind", resident() - before < 20)
"""


def test_memory_is_kept_inside_alone_as_often_as_one_likes():
    assert output_of(KEPT_TWICE) == ["inside True", "behind True"] * 2


class Recorder:
    """A C library that does nothing but record its thresholds."""

    def __init__(self):
        self.options, self.trimmed = {}, 0

    def mallopt(self, option, value):
        self.options[option] = value

    def malloc_trim(self, _):
        self.trimmed += 1


def test_thresholds_are_the_usual_ones_also_behind_an_error(monkeypatch):
    library = Recorder()
    monkeypatch.setattr(malloc, "_libc", lambda: library)
    monkeypatch.setattr(malloc, "_ask_for_huge_pages", lambda libc: [])
    for number in range(2):
        with pytest.raises(RuntimeError, match="inside"), memory_kept():
            assert library.options[malloc.MMAP_THRESHOLD] == malloc.LARGEST_OF_HEAP
            assert library.options[malloc.LARGEST_FAST_BIN] == 0
            raise RuntimeError("inside")
        assert library.options == {
            malloc.TRIM_THRESHOLD: malloc.USUAL_THRESHOLD,
            malloc.MMAP_THRESHOLD: malloc.USUAL_THRESHOLD,
            malloc.LARGEST_FAST_BIN: malloc.USUAL_FAST_BIN,
        }
        assert library.trimmed == number + 1


def test_without_such_a_library_nothing_is_done(monkeypatch):
    monkeypatch.setattr(malloc, "_libc", lambda: None)
    with memory_kept():
        pass
