"""A study on a Ray cluster that loses workers and a node, beside one on this machine in peace.

The cluster is made here, of two nodes on this machine; nothing else is ever killed.
"""

import json
import os
import random
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple
from unittest import mock

from deep_curiosity.experiments.engines.base import Engine
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.engines.ray import RayEngine
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.progress import latest_step
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.experiments.tables import markdown_table, read_table
from deep_curiosity.requirements import require
from deep_curiosity.training.config import Config
from deep_curiosity.training.log import PROGRESS, SUMMARY

KILLS: tuple[Literal["worker", "node"], ...] = ("worker", "node", "worker")
TITLE = "# A cluster that loses workers and a node"
TIMED = ("steps_per_second", "wall_seconds", "time/steps_per_second")
"""Columns that a clock fills."""
LOOKING_SECONDS = 0.2  # from one look for runs that are at work to the next
HEAD, OTHER = "127.0.0.2", "127.0.0.3"  # Ray rewrites 127.0.0.1 to the address of the host


class Loss(NamedTuple):
    """A worker or a node that was killed."""

    kind: str
    second: float
    """Since the study was begun on the cluster."""
    finished: int
    """Runs at that moment."""
    lost: str
    """Runs that were cut off, each with the step that it had written down."""


class Cluster:
    """Two nodes of Ray on this machine, a core each; the second one can be killed."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster as RayCluster

        self._nodes = RayCluster()
        self._add(HEAD)
        self._doomed = self._add(OTHER)

    def _add(self, address: str) -> Any:
        return self._nodes.add_node(node_ip_address=address, num_cpus=1, object_store_memory=2**27)

    def engine(self) -> RayEngine:
        """What computes on it."""
        return RayEngine(self._nodes.address, _node_ip_address=HEAD)

    def workers_of_doomed(self, workers: Sequence[int]) -> list[int]:
        """Those processes that the second node has started."""
        (raylet,) = self._doomed.all_processes["raylet"]
        return [worker for worker in workers if _parent(worker) == raylet.process.pid]

    def kill_node(self) -> None:
        """Kill the second node, and wait for its end.

        As long as nobody has asked for the status of the dead process, its worker takes it for
        alive and goes on.
        """
        self._nodes.remove_node(self._doomed, allow_graceful=False)

    def close(self) -> None:
        """End what is left."""
        self._nodes.shutdown()


@contextmanager
def two_nodes() -> Iterator[Cluster]:
    """A cluster for the time of the block.

    Raises:
        ImportError: If Ray is missing, with the command that installs it.
    """
    require("ray", extra="ray")
    patience = {"RAY_raylet_start_wait_time_s": "180", "RAY_worker_niceness": "0"}
    with mock.patch.dict(os.environ, patience):
        cluster = Cluster()
        try:
            yield cluster
        finally:
            cluster.close()


def _parent(process: int) -> int:
    """Process that started one; zero where that is gone."""
    try:
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    except FileNotFoundError:
        return 0


def working(runs: Path) -> dict[int, Path]:
    """Processes that hold a run which has taken some steps, and its folder."""
    folders = [path.parent for path in runs.rglob(PROGRESS) if latest_step(path.parent) > 0]
    holders = {holder: folder for folder in folders for holder in _holders(folder)}
    return {process: folder for process, folder in holders.items() if _parent(process)}


def _holders(folder: Path) -> Iterator[int]:
    """Processes that hold a run, dead ones too."""
    for lease in folder.glob("lease.*.json"):
        with suppress(FileNotFoundError):  # it has just ended
            yield int(json.loads(lease.read_text())["pid"])


class Killer(threading.Thread):
    """Kills workers and a node while a study computes, each at a random moment.

    Args:
        cluster: Where it computes.
        runs: Folder of its runs.
        seed: Of the moments.
        pause: Seconds from one kill to the next, at most.
    """

    def __init__(self, cluster: Cluster, runs: Path, *, seed: int, pause: float) -> None:
        super().__init__(daemon=True)
        self.losses: list[Loss] = []
        self._cluster = cluster
        self._runs = runs
        self._chance = random.Random(seed)
        self._pause = pause
        self._begun = time.monotonic()

    def run(self) -> None:
        """Kill one after another."""
        for kind in KILLS:
            time.sleep(self._chance.uniform(0.0, self._pause))
            while not self._kill(kind):
                time.sleep(LOOKING_SECONDS)

    def _kill(self, kind: str) -> bool:
        """Whether there was something at work to be killed, which then is."""
        workers = working(self._runs)
        processes = [*workers]
        if kind == "node":
            processes = self._cluster.workers_of_doomed(processes)
        if not processes:
            return False
        lost = processes if kind == "node" else [self._chance.choice(processes)]
        lost_runs = ", ".join(_described(self._runs, workers[process]) for process in lost)
        finished = sum(1 for _ in self._runs.rglob(SUMMARY))
        moment = time.monotonic() - self._begun
        if kind == "node":
            self._cluster.kill_node()
        else:
            with suppress(ProcessLookupError):
                os.kill(lost[0], signal.SIGKILL)
        self.losses.append(Loss(kind, moment, finished, lost_runs))
        return True


def _described(runs: Path, folder: Path) -> str:
    return f"{folder.relative_to(runs)} at step {latest_step(folder)}"


def make_study(seeds: int, total_steps: int) -> Study:
    """Two tasks and two agents, whose runs take some seconds."""
    config = Config.of(
        env_id="PendulumSwingup",
        total_steps=total_steps,
        learning_starts=20,
        hidden_dim=16,
        batch_size=32,
        components=16,
        num_members=2,
        log_interval=20,
        evaluation_interval=100,
        evaluation_episodes=1,
        checkpoint_interval=40,
        replay_capacity=1_000,
        compile="off",
        matmul_precision="highest",
    )
    tasks = [Task("pendulum", config), Task("maze", config.override(env_id="PointMaze"))]
    return Study(tasks, {"curiosity": {}, "none": {"bonus": "none"}}, seeds=seeds, curves=True)


@dataclass(frozen=True)
class Comparison:
    """A study on the cluster beside the same one on this machine.

    Args:
        runs: Of the study.
        rows: Of its table.
        equal_rows: Those that are as on this machine, but for what a clock fills.
        points: Of all learning curves.
        equal_points: Those that are as on this machine.
        cells: Of the progress.csv of all runs.
        equal_cells: Those that are as on this machine.
        losses: What was killed.
        differing: Columns of the table that are not equal everywhere, such as the commit where
            that has changed meanwhile.
    """

    runs: int
    rows: int
    equal_rows: int
    points: int
    equal_points: int
    cells: int
    equal_cells: int
    losses: Sequence[Loss]
    differing: Sequence[str]

    @property
    def is_sound(self) -> bool:
        """Whether nothing was lost, nothing is there twice, and every figure is the same."""
        return (
            self.runs == self.rows == self.equal_rows
            and self.points == self.equal_points > 0
            and self.cells == self.equal_cells > 0
            and len(self.losses) == len(KILLS)
        )


def torture_cluster(
    study: Study, folder: Path, cluster: Cluster, *, seed: int = 0, pause: float = 30.0
) -> Comparison:
    """Run a study on this machine, then on a cluster that loses workers and a node.

    Args:
        study: What is run.
        folder: Scratch, which is new.
        cluster: Where it is run the second time.
        seed: Of the moments at which they are lost.
        pause: Seconds from one loss to the next, at most.

    Raises:
        RuntimeError: If a run fails.
    """
    _run(study, folder / "local", LocalEngine(2))
    killer = Killer(cluster, folder / "ray" / "runs", seed=seed, pause=pause)
    killer.start()
    _run(study, folder / "ray", cluster.engine())
    return compare(study, folder, killer.losses)


def _run(study: Study, folder: Path, engine: Engine) -> None:
    if failed := run_study(study, runs=folder / "runs", out=folder / "out", engine=engine):
        raise RuntimeError(f"every run must come to its end, got {failed} that failed.")


def compare(study: Study, folder: Path, losses: Sequence[Loss]) -> Comparison:
    """Tables, curves and progress of a study in the folders `local` and `ray` of one."""
    sides = [folder / "local", folder / "ray"]
    tables = [_untimed(read_table(side / "out.csv")) for side in sides]
    curves = [read_table(side / "out_curves.csv") for side in sides]
    paths = sorted({path.relative_to(side) for side in sides for path in side.rglob(PROGRESS)})
    cells = [
        [
            cell
            for path in paths
            for row in _untimed(read_table(side / path))
            for cell in row.items()
        ]
        for side in sides
    ]
    pairs = [*zip(*tables, strict=False)]
    return Comparison(
        len(study.tasks) * len(study.agents) * study.seeds,
        *_count_equal(*tables),
        *_count_equal(*curves),
        *_count_equal(*cells),
        losses,
        sorted({name for one, other in pairs for name in one if one[name] != other.get(name)}),
    )


def _count_equal(here: Sequence[Any], there: Sequence[Any]) -> tuple[int, int]:
    """Entries on either side, the larger number; and those that are equal at their place."""
    equal = sum(one == other for one, other in zip(here, there, strict=False))
    return max(len(here), len(there)), equal


def _untimed(rows: Sequence[dict[str, str]]) -> list[dict[str, str]]:
    return [{name: row[name] for name in row if name not in TIMED} for row in rows]


def page(comparison: Comparison, command: str) -> str:
    """What came of it, in Markdown.

    Args:
        comparison: What came of it.
        command: The command line that asked for it.
    """
    lines = [
        [loss.kind, f"{loss.second:.0f}", str(loss.finished), loss.lost]
        for loss in comparison.losses
    ]
    header = ["killed", "after, s", "runs finished by then", "runs cut off"]
    differing = f"\nColumns that differ: {', '.join(comparison.differing)}.\n"
    return f"""{TITLE}

{comparison.runs} runs on the engine `local`, then on a Ray cluster of two nodes on this machine,
whose workers and second node were killed (SIGKILL) at random moments:

{markdown_table(header, lines)}

Of the table, a row for each run, {comparison.equal_rows} of {comparison.rows} rows are equal to
the last digit, of the learning curves {comparison.equal_points} of {comparison.points} points, of
`progress.csv` of all runs {comparison.equal_cells} of {comparison.cells} cells, times aside.
{differing if comparison.differing else ""}
```sh
{command}
```
"""
