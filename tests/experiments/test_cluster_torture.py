"""A Ray cluster of two nodes on this machine, where workers and nodes are killed while runs train.

Slow: Ray itself takes some seconds to start, and every killed run a few to go on.
"""

import csv
import json
import os
import random
import signal
import threading
import time
from dataclasses import replace

import pytest

from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.study import Study, Task

pytest.importorskip("ray")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),  # whatever Ray and its killed processes leave behind
]
TIMED = {"steps_per_second", "wall_seconds"}
KILLS = ("worker", "node", "worker")


@pytest.fixture
def cluster(monkeypatch):
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_raylet_start_wait_time_s", "180")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # else others starve them on a busy machine
    cluster = Cluster()
    # 127.0.0.1 would be rewritten to the address of the host
    cluster.add_node(node_ip_address="127.0.0.2", num_cpus=1, object_store_memory=2**27)
    yield cluster
    cluster.shutdown()


def add_node(cluster):
    return cluster.add_node(node_ip_address="127.0.0.3", num_cpus=1, object_store_memory=2**27)


def lease_of(folder):
    for lease in folder.glob("lease.*.json"):
        return json.loads(lease.read_text())
    return {}


def working(runs):
    """Processes that hold a run which has taken some steps."""
    return [
        lease_of(path.parent)["pid"]
        for path in runs.rglob("progress.csv")
        if path.stat().st_size > 50 and lease_of(path.parent)
    ]


class Killer(threading.Thread):
    """Kills workers and a node at random moments; another node can be started by no thread."""

    def __init__(self, cluster, node, runs):
        super().__init__(daemon=True)
        self.cluster, self.node, self.runs = cluster, node, runs
        self.killed = []
        self.chance = random.Random(0)

    def run(self):
        for kind in KILLS:
            while not (pids := working(self.runs)):
                time.sleep(0.2)
            time.sleep(self.chance.random() * 3)
            if kind == "worker":
                pids = working(self.runs) or pids
                try:
                    os.kill(self.chance.choice(pids), signal.SIGKILL)
                except ProcessLookupError:
                    pass  # it has just ended
            else:
                self.kill_node()
            self.killed.append(kind)
            time.sleep(3)

    def kill_node(self):
        # waits for the raylet: while it is a zombie, its worker takes it for alive and trains on
        self.cluster.remove_node(self.node, allow_graceful=False)


def table(out):
    with out.with_suffix(".csv").open() as file:
        return [
            {name: value for name, value in row.items() if name not in TIMED}
            for row in csv.DictReader(file)
        ]


def curves(out):
    return out.with_name(f"{out.name}_curves.csv").read_text()


def test_a_study_on_a_cluster_that_loses_workers_and_nodes_ends_with_the_same_table(
    tiny, cluster, tmp_path
):
    from deep_curiosity.experiments.engines.ray import RayEngine

    config = tiny.override(
        total_steps=200, checkpoint_interval=40, log_interval=20, evaluation_interval=100
    )
    study = Study(
        [
            Task("pendulum", config),
            Task("maze", config.override(env_id="PointMaze", env_kwargs={})),
        ],
        {"curiosity": {}, "none": {"bonus": "none"}},
        seeds=1,
        curves=True,
    )
    local = tmp_path / "local"
    assert run_study(study, runs=local / "runs", out=local / "out", engine=LocalEngine(2)) == 0

    node = add_node(cluster)
    there = tmp_path / "ray"
    killer = Killer(cluster, node, there / "runs")
    killer.start()
    engine = RayEngine(cluster.address, _node_ip_address="127.0.0.2")
    assert run_study(study, runs=there / "runs", out=there / "out", engine=engine) == 0
    assert killer.killed == [*KILLS]
    assert table(there / "out") == table(local / "out")
    assert len(table(there / "out")) == 4
    assert curves(there / "out") == curves(local / "out")


def test_a_run_that_raises_is_listed_and_the_others_go_on(tiny, cluster, tmp_path):
    from deep_curiosity.experiments.engines.ray import RayEngine

    study = Study(
        [Task("pendulum", tiny)], {"lost": {"env_id": "NoSuchTask"}, "none": {"bonus": "none"}}
    )
    engine = RayEngine(cluster.address, _node_ip_address="127.0.0.2")
    places = {"runs": tmp_path / "runs", "out": tmp_path / "out"}
    assert run_study(replace(study, seeds=1), **places, engine=engine) == 1
    assert [row["agent"] for row in table(tmp_path / "out")] == ["none"]
