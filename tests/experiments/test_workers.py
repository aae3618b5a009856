import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from deep_curiosity.experiments.grid import run_study
from deep_curiosity.training.checkpoint import load_checkpoint
from tests.experiments.waiting import PATIENCE, wait_until

pytestmark = pytest.mark.slow

STUDY = """
import sys
from pathlib import Path
from deep_curiosity.experiments.grid import run_study
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.training import Config

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    config = Config.of(
        env_id="PendulumSwingup", total_steps=10**7, hidden_dim=8, batch_size=8, components=8,
        learning_starts=10, evaluation_interval=10**7, log_interval=10**7,
        checkpoint_interval=10**7, compile="off", matmul_precision="highest",
    )
    study = Study([Task("endless", config)], {"none": {"bonus": "none"}}, seeds=2)
    run_study(study, runs=folder / "runs", out=folder / "out", workers=2)
"""


def is_alive(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGKILL])
def test_the_runs_of_a_study_end_with_it_and_leave_a_checkpoint(tmp_path, sent):
    script = tmp_path / "study.py"
    script.write_text(STUDY)
    study = subprocess.Popen([sys.executable, script, tmp_path], stderr=subprocess.DEVNULL)
    folders = [tmp_path / "runs" / "endless" / "none" / f"seed{seed}" for seed in range(2)]
    wait_until(lambda: all((folder / "checkpoint.pt").exists() for folder in folders))
    wait_until(lambda: all(list(folder.glob("events*")) for folder in folders))
    workers = [
        json.loads(lease.read_text())["pid"]
        for each in folders
        for lease in each.glob("lease.*.json")
    ]
    assert len(set(workers) - {study.pid}) == 2
    time.sleep(0.5)  # in which some steps are taken
    os.kill(study.pid, sent)
    wait_until(lambda: not any(map(is_alive, workers)))
    study.wait(PATIENCE)
    assert study.returncode != 0
    for folder in folders:
        assert load_checkpoint(folder)["run_log"]["step"] > 0
        assert not list(folder.glob("lease.*"))


def test_a_study_in_a_script_that_a_worker_reads_anew_is_refused(
    small_study, tmp_path, monkeypatch
):
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(RuntimeError, match="`run_study` must be called below `if __name__ == "):
        run_study(small_study, runs=tmp_path / "runs", out=tmp_path / "out")
    assert [*tmp_path.iterdir()] == []
