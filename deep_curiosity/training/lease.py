"""A lease on the folder of a run, so that two processes never write into it, on shared disks too.

The lease is a file, `lease.N.json`, that tells host, process and a random id; its time of change
is the heartbeat. It is made by a hard link, which only one of several processes can make, also on
a network disk. A lease is stale, and the next number may be taken, where its process is dead on
the same machine, or where it has had no heartbeat for `STALE_AFTER` seconds by the clock of the
disk.
"""

import json
import os
import secrets
import socket
import threading
import time
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

HEARTBEAT = 20.0
"""Seconds from one heartbeat to the next."""
STALE_AFTER = 600.0
"""Seconds without a heartbeat after which the lease of another machine may be taken over."""


class LeaseError(RuntimeError):
    """Another process holds the folder."""


class Lease:
    """The right to write into a folder, held from its making to `release`.

    Args:
        folder: Of a run; it exists.

    Raises:
        LeaseError: If another process holds it, naming host, process and since when.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.id = secrets.token_hex(8)
        self._stopped = threading.Event()
        self._path = self._acquire()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Make sure that the folder is still held.

        Raises:
            LeaseError: If another process has taken it over.
        """
        numbers = [*_leases(self.folder)]
        own = _number(self._path)
        if own in numbers and max(numbers) == own and _read(self._path).get("id") == self.id:
            return
        others = [_path(self.folder, number) for number in numbers if number != own]
        holder = _description(others[-1]) if others else "an unknown process"
        raise LeaseError(
            f"`out` must be held by the run that writes there, got {self.folder}, which was taken "
            f"over by {holder}; nothing more is written."
        )

    def release(self) -> None:
        """Give the folder free, unless it is another's by now."""
        self._stopped.set()
        self._thread.join()
        if _read(self._path).get("id") == self.id:
            self._path.unlink(missing_ok=True)

    def _acquire(self) -> Path:
        """Take the number after the last lease, if that is stale."""
        draft = self.folder / f"lease.{self.id}.partial"
        try:
            draft.write_text(json.dumps(_holder() | {"id": self.id}) + "\n")
            now = draft.stat().st_mtime  # by the clock of the disk, as the heartbeats
            numbers = [*_leases(self.folder)]
            self._refuse_if_held(numbers, now)
            path = _path(self.folder, max(numbers, default=0) + 1)
            _link(draft, path)
        except FileExistsError:
            raise self._held(_path(self.folder, max(_leases(self.folder), default=1))) from None
        finally:
            draft.unlink(missing_ok=True)
        try:
            self._refuse_if_held([n for n in _leases(self.folder) if n != _number(path)], now)
        except LeaseError:
            path.unlink(missing_ok=True)
            raise
        self._clear_away(path, now)
        return path

    def _refuse_if_held(self, numbers: list[int], now: float) -> None:
        for number in numbers:
            path = _path(self.folder, number)
            if not _is_stale(path, now):
                raise self._held(path)

    def _held(self, path: Path) -> LeaseError:
        return LeaseError(
            f"`out` must not be written by two runs at once, got {self.folder}, which is held by "
            f"{_description(path)}. Where that process is gone from another machine, wait until "
            f"{STALE_AFTER:.0f} s after its last heartbeat, or delete {path}."
        )

    def _clear_away(self, own: Path, now: float) -> None:
        """Delete stale leases, and drafts of processes that were killed."""
        for number in _leases(self.folder):
            if number < _number(own):
                _path(self.folder, number).unlink(missing_ok=True)
        for draft in self.folder.glob("lease.*.partial"):
            with suppress(FileNotFoundError):
                if now - draft.stat().st_mtime > STALE_AFTER:
                    draft.unlink()

    def _beat(self) -> None:
        while not self._stopped.wait(HEARTBEAT):
            with suppress(OSError):  # a lease that was lost is noticed by `check`
                os.utime(self._path)


def _link(draft: Path, path: Path) -> None:
    """Make a file that nobody else has made, whole at once where the disk knows links.

    Raises:
        FileExistsError: If somebody has.
    """
    try:
        os.link(draft, path)
    except FileExistsError:
        raise
    except (NotImplementedError, OSError):  # some disks know no links
        with path.open("x") as file:
            file.write(draft.read_text())


def _path(folder: Path, number: int) -> Path:
    return folder / f"lease.{number}.json"


def _number(path: Path) -> int:
    return int(path.name.split(".")[1])


def _leases(folder: Path) -> list[int]:
    """Numbers of the leases in a folder, in ascending order."""
    return sorted(
        _number(path) for path in folder.glob("lease.*.json") if path.name.split(".")[1].isdigit()
    )


def _read(path: Path) -> dict[str, Any]:
    """What a lease tells; nothing where it is gone or cannot be read."""
    try:
        holder = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return holder if isinstance(holder, dict) else {}


def _is_stale(path: Path, now: float) -> bool:
    """Whether the process of a lease is gone, or has long given no sign."""
    holder = _read(path)
    try:
        silent = now - path.stat().st_mtime > STALE_AFTER
    except FileNotFoundError:
        return True
    if os.name == "posix" and holder.get("machine") == _machine():
        return _is_dead(holder.get("pid", 0), holder.get("process_started"))
    return silent


def _holder() -> dict[str, Any]:
    """What a lease tells of the present process."""
    return {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "since": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": _machine(),
        "process_started": _start_of(os.getpid()),
    }


def _description(path: Path) -> str:
    holder = _read(path)
    if not holder:
        return f"whoever wrote {path}"
    with suppress(OSError):
        ago = max(0.0, time.time() - path.stat().st_mtime)
        return (
            f"process {holder.get('pid')} on {holder.get('host')} since {holder.get('since')} "
            f"(last heartbeat {ago:.0f} s ago)"
        )
    return f"process {holder.get('pid')} on {holder.get('host')} since {holder.get('since')}"


def _machine() -> str:
    """Where processes can be looked up by number: host, boot, and namespace of processes."""
    parts = [socket.gethostname()]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        parts.append(os.readlink("/proc/self/ns/pid"))
    return " ".join(parts)


def _is_dead(pid: int, started: str | None) -> bool:
    """Whether the process of this machine that had a number, and began at a time, is gone."""
    try:
        os.kill(pid, 0)  # asks, and sends nothing
    except ProcessLookupError:
        return True
    except OSError:  # of another user
        return False
    start = _start_of(pid)
    return None not in (start, started) and start != started


def _start_of(pid: int) -> str | None:
    """When a process was started, in the system's own count; `None` where it cannot be told.

    It tells a process from one that had its number before; empty for one that has ended.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return "" if fields[0] in "ZX" else fields[19]  # the first is the third of all fields
