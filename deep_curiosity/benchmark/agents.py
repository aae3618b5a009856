"""Environment steps per second of all runners, in turns."""

from collections.abc import Callable, Mapping
from typing import Any

from deep_curiosity.benchmark.runners import Runner, Worker
from deep_curiosity.benchmark.operations import update_operations
from deep_curiosity.training.config import Settings

Row = dict[str, Any]
"""What was measured in one turn, by column."""
OBSERVATION_DIM, ACTION_DIM = 17, 6  # of HalfCheetah-v5
NUM_FILLED = 100_000  # transitions in replay before the first turn
WARM_UP_STEPS = 20  # in which compiled code settles


def measure_agents(
    runners: Mapping[str, Callable[[], Runner]],
    settings: Mapping[str, Settings],
    *,
    repeats: int,
    steps: int,
    num_filled: int = NUM_FILLED,
) -> tuple[list[Row], list[Row]]:
    """Let every runner step its environment in a process of its own, one at a time.

    Args:
        runners: Makes each of them; one whose package is missing is left out.
        settings: Of those among them that are ours, whose parts are measured and counted as well.
        repeats: Turns of each.
        steps: Environment steps in a turn.
        num_filled: Transitions in replay before the first turn.

    Returns:
        A row for every turn, and a row for every process.
    """
    workers: dict[str, Worker] = {}
    processes: list[Row] = []
    for name, factory in runners.items():
        try:
            worker = Worker(factory)
        except ImportError as error:
            print(f"{name} is left out: {error}")
            continue
        worker.ask("fill", num_filled)
        seconds = worker.start_seconds + worker.ask("step", 1).seconds
        worker.ask("step", WARM_UP_STEPS)
        print(f"{name}: first update after {seconds:.1f} s", flush=True)
        workers[name] = worker
        processes.append({"runner": name, "first_update_seconds": seconds})
    turns = []
    for repeat in range(repeats):
        for name, worker in workers.items():
            row = {"runner": name, "repeat": repeat}
            turns.append(row | measure_turn(worker, settings.get(name), steps))
        print(f"agents: turn {repeat + 1} of {repeats}", flush=True)
    for process, worker in zip(processes, workers.values(), strict=True):
        process["peak_megabytes"] = worker.ask("step", 1).peak_megabytes
        worker.close()
    return turns, processes


def measure_turn(worker: Worker, settings: Settings | None, steps: int) -> Row:
    """Steps per second and, of an agent of ours, milliseconds of each part and of the floor."""
    seconds = worker.ask("step", steps).seconds
    row = {"steps_per_second": steps / seconds}
    if settings is None:
        return row
    parts: dict[str, float] = worker.ask("seconds").value
    rate: float = worker.ask("matrix_rate").value
    operations = sum(update_operations(settings, OBSERVATION_DIM, ACTION_DIM).values())
    milliseconds = {f"{part}_ms": 1e3 * total / steps for part, total in parts.items()}
    floor = {
        "gigaflop": operations / 1e9,
        "gigaflop_per_second": rate / 1e9,
        "floor_ms": 1e3 * operations / rate,
    }
    return row | milliseconds | floor
