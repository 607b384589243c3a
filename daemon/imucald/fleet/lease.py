"""The lease of a fleet's folder: only the driver that holds the lease may write to the folder."""

from __future__ import annotations

import os
import socket
import time
import uuid
from pathlib import Path

import msgspec

from imucald.core.errors import ImucaldError
from imucald.fleet.store import Store

NAME = "_lease.json"
STALE_S = 120.0
"""If an owner on another machine does not renew the lease for this time, the owner counts as dead
[s]."""


class Owner(msgspec.Struct, frozen=True):
    """The process that holds the lease. started: start time of the process in the kernel's ticks.
    The start time is stored because process ids are reused."""

    token: str
    host: str
    pid: int
    started: str
    beat: float


class Lease:
    """A lease, used in a `with` statement."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._owner = Owner(
            uuid.uuid4().hex, socket.gethostname(), os.getpid(), _started(os.getpid()), time.time()
        )

    def __enter__(self) -> Lease:
        """Take the lease. Raises ImucaldError if another running process holds the lease."""
        data = msgspec.json.encode(self._owner)
        for _ in range(2):
            if self._store.create(NAME, data):
                break
            holder = holder_of(self._store)
            if holder is not None and _lives(holder):
                age = time.time() - holder.beat
                raise ImucaldError(
                    f"{self._store.url}: another run is writing there (process {holder.pid} on "
                    f"{holder.host}, last sign of life {age:.0f} s ago); wait for it, or give this "
                    "one another --out"
                )
            self._store.remove(NAME)
        else:
            raise ImucaldError(
                f"{self._store.url}: another run has started in this folder at the "
                "same time; wait for it, or give this run another --out"
            )
        self._check()
        return self

    def beat(self) -> None:
        """Renew the lease every 20 s. Raises ImucaldError if another run has taken the
        lease."""
        now = time.time()
        if now - self._owner.beat < 20.0:
            return
        self._check()
        self._owner = msgspec.structs.replace(self._owner, beat=now)
        self._store.write(NAME, msgspec.json.encode(self._owner))

    def _check(self) -> None:
        holder = holder_of(self._store)
        if holder is None or holder.token != self._owner.token:
            raise ImucaldError(
                f"{self._store.url}: another run has taken over this folder, so this run ends"
            )

    def __exit__(self, *_: object) -> None:
        """Release the lease if this process still holds it."""
        holder = holder_of(self._store)
        if holder is not None and holder.token == self._owner.token:
            self._store.remove(NAME)


def holder_of(store: Store) -> Owner | None:
    """Return the holder of a folder's lease; None if there is no lease or the lease cannot be
    read."""
    try:
        return msgspec.json.decode(store.read(NAME), type=Owner)
    except (ImucaldError, msgspec.DecodeError):
        return None


def _lives(owner: Owner) -> bool:
    if owner.host == socket.gethostname():
        return _started(owner.pid) == owner.started != ""
    return time.time() - owner.beat < STALE_S


def _started(pid: int) -> str:
    """Return the start time of a process (field 22 of /proc/PID/stat, proc(5)); empty if the
    process does not exist."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    return text.rpartition(")")[2].split()[19]
