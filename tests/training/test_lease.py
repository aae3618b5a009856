import json
import os
import subprocess
import sys
import threading

import pytest

from deep_curiosity.training import lease as module
from deep_curiosity.training.lease import STALE_AFTER, Lease, LeaseError


@pytest.fixture
def dead_pid():
    """Number of a process that has ended."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def leases(folder):
    return sorted(path.name for path in folder.iterdir())


def written(folder, **changes):
    """A lease as another process would have left it."""
    path = folder / "lease.4.json"
    path.write_text(json.dumps(module._holder() | {"id": "another"} | changes))
    return path


def test_a_folder_is_held_once_and_given_free(tmp_path):
    first = Lease(tmp_path)
    with pytest.raises(LeaseError, match=f"held by process {os.getpid()} on .* since 20"):
        Lease(tmp_path)
    first.check()
    first.release()
    assert leases(tmp_path) == []
    Lease(tmp_path).release()


def test_of_many_that_want_it_at_once_one_wins(tmp_path, dead_pid):
    for number in range(5):
        folder = tmp_path / str(number)
        folder.mkdir()
        written(folder, pid=dead_pid)
        won, lost, barrier = [], [], threading.Barrier(8)

        def work(folder=folder, won=won, lost=lost, barrier=barrier):
            barrier.wait()
            try:
                won.append(Lease(folder))
            except LeaseError as error:
                lost.append(error)

        threads = [threading.Thread(target=work) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert (len(won), len(lost)) == (1, 7)
        won[0].check()
        assert leases(folder) == ["lease.5.json"]
        won[0].release()


def test_that_of_a_dead_process_is_taken_over_at_once(tmp_path, dead_pid):
    written(tmp_path, pid=dead_pid)
    lease = Lease(tmp_path)
    lease.check()
    assert leases(tmp_path) == ["lease.5.json"]
    lease.release()


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="reads /proc")
def test_a_process_that_has_the_number_of_a_dead_one_is_told_from_it(tmp_path):
    written(tmp_path, process_started="1")
    Lease(tmp_path).release()


def test_that_of_another_machine_is_taken_over_after_a_time_without_heartbeat(tmp_path):
    path = written(tmp_path, machine="another", host="node7", pid=1)
    now = path.stat().st_mtime
    os.utime(path, (now, now - STALE_AFTER + 60))
    with pytest.raises(LeaseError, match=r"process 1 on node7 .*last heartbeat 5\d\d s ago"):
        Lease(tmp_path)
    os.utime(path, (now, now - STALE_AFTER - 60))
    Lease(tmp_path).release()


def test_one_that_cannot_be_read_counts_until_it_is_silent(tmp_path):
    path = tmp_path / "lease.1.json"
    path.write_text("\0\0")
    with pytest.raises(LeaseError, match=r"whoever wrote .*lease\.1\.json"):
        Lease(tmp_path)
    os.utime(path, (0, 0))
    Lease(tmp_path).release()


@pytest.mark.parametrize("loss", ["deleted", "taken over"])
def test_a_holder_notices_that_it_has_lost_the_folder(tmp_path, loss):
    lease = Lease(tmp_path)
    if loss == "deleted":
        (tmp_path / "lease.1.json").unlink()
    else:
        written(tmp_path, host="node7", pid=12)
    expected = "node7" if loss == "taken over" else "unknown"
    with pytest.raises(LeaseError, match=f"taken over by .*{expected}"):
        lease.check()
    lease.release()
    assert leases(tmp_path) == (["lease.4.json"] if loss == "taken over" else [])


def test_the_heartbeat_is_the_time_of_the_file(tmp_path, monkeypatch):
    beaten, utime = threading.Event(), os.utime
    monkeypatch.setattr(module, "HEARTBEAT", 0.01)
    monkeypatch.setattr(module.os, "utime", lambda path: (utime(path), beaten.set()))
    lease = Lease(tmp_path)
    utime(tmp_path / "lease.1.json", (0, 0))
    beaten.clear()
    assert beaten.wait(10)
    lease.release()
    assert not lease._thread.is_alive()


def test_a_disk_without_links_serves_as_well(tmp_path, monkeypatch):
    def refuse(source, target):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(module.os, "link", refuse)
    lease = Lease(tmp_path)
    lease.check()
    with pytest.raises(LeaseError, match="held by process"):
        Lease(tmp_path)
    lease.release()
    assert leases(tmp_path) == []
