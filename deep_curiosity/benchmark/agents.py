"""Environment steps per second of all runners, measured alternately."""

from collections.abc import Callable, Mapping
from typing import Any

from deep_curiosity.benchmark.operations import count_update
from deep_curiosity.benchmark.runners import Runner, Worker
from deep_curiosity.training.config import Config

Row = dict[str, Any]
"""What was measured in one round, by column."""
OBSERVATION_DIM, ACTION_DIM = 17, 6  # of HalfCheetah-v5
NUM_FILLED = 100_000  # transitions in replay before the first round
WARM_UP_STEPS = 20  # in which compiled code settles


def measure_agents(
    runners: Mapping[str, Callable[[], Runner]],
    own: Mapping[str, Config],
    *,
    repeats: int,
    steps: int,
    num_filled: int = NUM_FILLED,
) -> tuple[list[Row], list[Row]]:
    """Let every runner step its environment in a process of its own, one at a time.

    Args:
        runners: Makes each of them; one whose package is missing is left out.
        own: Settings of those among them that are ours, of which each stage is measured and the
            operations are counted as well.
        repeats: Rounds of measurement; every runner has its turn in each.
        steps: Environment steps of a runner in a round.
        num_filled: Transitions in replay before the first round.

    Returns:
        A row for every runner in every round, and a row for every process.
    """
    workers, processes = start_workers(runners, num_filled)
    rows = []
    for repeat in range(repeats):
        for name, worker in workers.items():
            row = {"runner": name, "repeat": repeat}
            rows.append(row | measure_round(worker, own.get(name), steps))
        print(f"agents: round {repeat + 1} of {repeats}", flush=True)
    for process, worker in zip(processes, workers.values(), strict=True):
        process["peak_megabytes"] = worker.call("step", 1).peak_megabytes
        worker.close()
    return rows, processes


def start_workers(
    runners: Mapping[str, Callable[[], Runner]], num_filled: int
) -> tuple[dict[str, Worker], list[Row]]:
    """Start a process for each runner whose package is there, and let it settle.

    Returns:
        The processes by name, and a row for each with the time until its first update.
    """
    workers: dict[str, Worker] = {}
    processes: list[Row] = []
    for name, factory in runners.items():
        try:
            worker = Worker(factory)
        except ImportError as error:
            print(f"{name} is left out: {error}")
            continue
        worker.call("fill", num_filled)
        seconds = worker.start_seconds + worker.call("step", 1).seconds
        worker.call("step", WARM_UP_STEPS)
        print(f"{name}: first update after {seconds:.1f} s", flush=True)
        workers[name] = worker
        processes.append({"runner": name, "first_update_seconds": seconds})
    return workers, processes


def measure_round(worker: Worker, config: Config | None, steps: int) -> Row:
    """Steps per second and, of an agent of ours, milliseconds of each stage and of the floor."""
    seconds = worker.call("step", steps).seconds
    row = {"steps_per_second": steps / seconds}
    if config is None:
        return row
    stages: dict[str, float] = worker.call("seconds").value
    rate: float = worker.call("matrix_rate").value
    operations = sum(count_update(config, OBSERVATION_DIM, ACTION_DIM).values())
    milliseconds = {f"{stage}_ms": 1e3 * total / steps for stage, total in stages.items()}
    floor = {
        "gigaflop": operations / 1e9,
        "gigaflop_per_second": rate / 1e9,
        "floor_ms": 1e3 * operations / rate,
    }
    return row | milliseconds | floor
