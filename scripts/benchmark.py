"""Measures speed, distance to the arithmetic floor, memory and growth into docs/benchmark/.

Everything runs on one thread. What is compared is measured alternately within one run.
"""

import shlex
import sys

from deep_curiosity.arguments import read_arguments
from deep_curiosity.benchmark.run import run_benchmark
from deep_curiosity.benchmark.sections import Benchmark
from deep_curiosity.cli import answering

if __name__ == "__main__":
    with answering():
        benchmark = read_arguments(Benchmark, description=__doc__)
        command = ["python", "scripts/benchmark.py", *map(shlex.quote, sys.argv[1:])]
        run_benchmark(benchmark, " ".join(command))
