"""What cannot run in the process of the tests, whose type checks no compiler can trace."""

import subprocess
import sys


def output_of(program: str) -> list[str]:
    """Lines that a program of its own prints."""
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2_000:]
    return run.stdout.splitlines()
