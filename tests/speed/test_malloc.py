import subprocess
import sys
from pathlib import Path

import pytest

HUGE_PAGES = Path("/sys/kernel/mm/transparent_hugepage/enabled")
TAKE = "blocks = [torch.ones(5_000_000) for _ in range(3)]"  # 60 MB
pytestmark = pytest.mark.skipif(
    not Path("/proc/self/smaps_rollup").exists(), reason="is not Linux"
)


def outcome(*lines):
    """What a fresh process prints last, with its memory settled."""
    code = [
        "import torch",
        "from deep_curiosity.speed.malloc import settle_memory",
        "settle_memory()",
        *lines,
    ]
    command = [sys.executable, "-c", "\n".join(code)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_freed_memory_does_not_return_page_by_page():
    faults = outcome(
        "from resource import RUSAGE_SELF, getrusage",
        TAKE,
        "del blocks",
        "before = getrusage(RUSAGE_SELF).ru_minflt",
        TAKE,
        "print(getrusage(RUSAGE_SELF).ru_minflt - before)",
    )
    assert faults < 1_500  # a tenth of the pages that were freed


@pytest.mark.skipif(
    not HUGE_PAGES.exists() or "[never]" in HUGE_PAGES.read_text(),
    reason="the system grants no huge pages",
)
def test_memory_lies_in_huge_pages():
    kilobytes = outcome(
        TAKE,
        "from pathlib import Path",
        "lines = Path('/proc/self/smaps_rollup').read_text().splitlines()[1:]",
        "sizes = dict(line.split(':') for line in lines)",
        "print(sizes['AnonHugePages'].split()[0])",
    )
    assert kilobytes > 50_000
