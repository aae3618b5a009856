"""Measures speed, distance to the arithmetic floor, memory and growth into docs/benchmark/.

Everything runs on one thread. What is compared is measured alternately within one run.
"""

import shlex
import sys

import tyro

from deep_curiosity.benchmark.run import run_benchmark
from deep_curiosity.benchmark.sections import Benchmark

if __name__ == "__main__":
    benchmark = tyro.cli(Benchmark, description=__doc__)
    command = ["python", "scripts/benchmark.py", *map(shlex.quote, sys.argv[1:])]
    try:
        run_benchmark(benchmark, " ".join(command))
    except OSError as error:
        sys.exit(f"error: {error}")
