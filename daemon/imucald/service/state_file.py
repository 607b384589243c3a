"""The saved state: the result of a drive, stored so that no power cut can damage it.

Two files (``.0`` and ``.1``) alternate, each with a generation number. A save replaces the older
file: a new file is forced to the disk and renamed, and the folder is forced to the disk too. At
every instant, the newest file or the previous one is therefore complete. A file is accepted only if
its length and SHA-256 are right, its version is known, it belongs to this vehicle and this sensor,
and its numbers are plausible. A file that is not accepted is renamed, with the reason in its new
name, and never deleted.

Only one daemon may use a state folder: two would overwrite each other's files.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imucald.core.errors import ImucaldError
from imucald.core.files import (
    UNFINISHED,
    free_name,
    put_in_place,
    read_regular,
    sha256,
    split_checksum,
    sync_folder,
    with_checksum,
    write_beside,
)
from imucald.mount.estimate import GOOD_NAMES

MAGIC = "imucald-state"
VERSION = 2
READABLE = (1, 2)
"""Versions that can be read.

Version 1 had no sums of evidence; those of version 2 are not used any more.
"""
MAX_BYTES = 1 << 20
"""A longer file is not a state file."""
SLOTS = (0, 1)
PROBE = "probe"
PROBE_BYTES = 1 << 16
"""Bytes of a test write: usually more than a state has."""
ROTATION_TOLERANCE = 1e-6
"""Largest difference of a stored matrix from a rotation."""
LARGEST_VARIANCE = 4.0
"""Largest variance of an angle [rad^2]: more than that of an unknown angle is invalid."""
LARGEST_NUMBER = 2**53
"""Largest number in a file: up to there a float holds every integer."""
LONGEST_DOUBT = 2000
"""Largest length of the text of the doubt: all existing texts together."""
ORDERED = ("held", "given")
"""Keys that are in a file only if they are true: orders of people."""


@dataclass(frozen=True)
class StateKey:
    """Owner of a state: the vehicle's identity, and a hash of the sensor's definition."""

    vehicle: str
    sensor: str

    @property
    def file_name(self) -> str:
        """A file name that is safe for any identity, and distinct for distinct keys."""
        readable = re.sub(r"[^A-Za-z0-9_-]+", "_", self.vehicle)[:24]
        digest = sha256(f"{self.vehicle}\0{self.sensor}".encode()).hexdigest()[:16]
        return f"{readable}-{digest}.state"


@dataclass(frozen=True)
class SavedState:
    """Content of a saved state.

    rotation: R_vehicle_from_sensor, nine numbers row by row. covariance: nine numbers [rad^2].
    state: "usable" or "fine". doubted: the mount was suspect when it was saved. saved_at: wall
    clock [s], for people only. driven_s: driving time behind it [s]. offsets: offsets of sensors
    and signals, SI. shifts: history of remounts, newest last. evidence: the evidence behind the
    estimate, for people. Its keys "sums" and "sensor" hold what the estimator continues from
    (`mount.joint.known`). held: nothing was learnt. given: a person
    stated the mount. doubt: reason why it was suspect, in words.
    """

    rotation: tuple[float, ...]
    covariance: tuple[float, ...]
    state: str
    doubted: bool = False
    saved_at: float = 0.0
    driven_s: float = 0.0
    offsets: Mapping[str, Any] = field(default_factory=dict)
    shifts: tuple[Mapping[str, Any], ...] = ()
    evidence: Mapping[str, Any] = field(default_factory=dict)
    held: bool = False
    given: bool = False
    doubt: str = ""


@dataclass(frozen=True)
class Loaded:
    """Result of `StateStore.load`: the state, or None; and one line for each file not accepted."""

    state: SavedState | None
    generation: int
    problems: tuple[str, ...]


class _NotBelievedError(Exception):
    """Reason why a file is not accepted: one word for its new name, and a text."""

    def __init__(self, word: str, text: str) -> None:
        super().__init__(text)
        self.word = word


class StateStore:
    """Saves and loads the state of one vehicle and sensor in its own folder."""

    def __init__(self, folder: Path, key: StateKey) -> None:
        self.folder = folder
        self.key = key
        self.generation = 0
        """Generation of the newest state that was saved, loaded or forgotten."""
        self.is_empty = True
        """True if nothing is saved: nothing was saved, or all was forgotten since."""
        self.era = 0
        """Counter that increases when all saved states are forgotten; a save of an earlier era is
        ignored.
        """
        self._forgotten: set[int] = set()
        """Slots whose file was forgotten but may still have its name."""
        self._renaming = threading.Lock()

    def path(self, slot: int) -> Path:
        """Return the path of a slot's file."""
        return self.folder / f"{self.key.file_name}.{slot}"

    def load(self) -> Loaded:
        """Return the newest acceptable state; set aside files that are not acceptable.

        The call never raises.
        """
        best: SavedState | None = None
        generation, highest, problems = 0, 0, []
        for slot in SLOTS:
            try:
                number, state = self._read(self.path(slot))
            except FileNotFoundError:
                continue
            except OSError as error:
                problems.append(
                    f"{self.path(slot)}: cannot be read: {error.strerror}; the file "
                    "stays where it is"
                )
                continue
            except _NotBelievedError as reason:
                problems.append(self._set_aside(self.path(slot), reason))
                continue
            highest = max(highest, number)
            if best is None or number > generation:
                best, generation = state, number
        self.generation, self.is_empty = highest, best is None
        return Loaded(best, generation, tuple(problems))

    def save(self, state: SavedState, era: int | None = None) -> None:
        """Write a new generation.

        Raises OSError if the disk does not take it; nothing is lost then.

        era: era of the state, if it was made earlier. If all was forgotten since, nothing is
        written, and a file that is being written never gets its name.
        """
        era = self.era if era is None else era
        generation = self.generation + 1
        path = self.path(generation % 2)
        unfinished = write_beside(path, encoded(self.key, generation, state))
        with self._renaming:
            if era != self.era:
                unfinished.unlink()
                return
            put_in_place(unfinished, path)
            self.generation, self.is_empty = generation, False
            self._forgotten.discard(generation % 2)
        self.sync()

    def why_not_writable(self) -> str:
        """Return why the folder takes no state now; empty if it does.

        The call does not wait for the disk.
        """
        probe = self.folder / f"{PROBE}{UNFINISHED}"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe.unlink(missing_ok=True)
            with probe.open("xb") as file:
                file.write(bytes(PROBE_BYTES))
        except OSError as error:
            return error.strerror or str(error)
        finally:
            with contextlib.suppress(OSError):
                probe.unlink()
        return ""

    def forget(self) -> None:
        """Set both generations aside, so that nothing is loaded any more.

        Raises OSError if that fails. The call never waits for the disk. `sync` waits; without it a
        power cut may undo the change. After a failure `set_aside_forgotten` continues.
        """
        with self._renaming:
            self.era += 1
            self.is_empty = True
            self._forgotten.update(SLOTS)
        self.set_aside_forgotten()

    def set_aside_forgotten(self) -> None:
        """Set aside forgotten files that still have their name. Raises OSError if that fails."""
        failure: OSError | None = None
        with self._renaming:
            for slot in sorted(self._forgotten):
                path = self.path(slot)
                try:
                    if path.exists():
                        path.rename(free_name(path, "forgotten"))
                except OSError as error:
                    failure = error  # the other file may still succeed
                else:
                    self._forgotten.discard(slot)
        if failure is not None:
            raise failure

    @property
    def is_forgotten(self) -> bool:
        """True if another start would load no forgotten state."""
        return not self._forgotten

    def sync(self) -> None:
        """Force the renames to the disk."""
        sync_folder(self.folder)

    def _read(self, path: Path) -> tuple[int, SavedState]:
        generation, key, state = decoded(read_regular(path, MAX_BYTES))
        if key != self.key:
            word = "vehicle" if key.vehicle != self.key.vehicle else "sensor"
            raise _NotBelievedError(f"other-{word}", f"it belongs to another {word}")
        return generation, state

    def _set_aside(self, path: Path, reason: _NotBelievedError) -> str:
        """Rename the file and keep those that were set aside before."""
        target = free_name(path, reason.word)
        try:
            path.rename(target)
        except OSError as error:
            return (
                f"{path}: {reason}; the file is not used (it could not be renamed: "
                f"{error.strerror})"
            )
        return f"{path}: {reason}; the file is renamed to {target.name}"


def clear_unfinished(folder: Path) -> None:
    """Remove files that a power cut left unfinished; only the folder's only user may do this."""
    for path in folder.glob(f"*{UNFINISHED}"):
        with contextlib.suppress(OSError):
            path.unlink()


def encoded(key: StateKey, generation: int, state: SavedState) -> bytes:
    """Return the bytes of a file: one line with version, length and checksum, then JSON."""
    content = {
        "vehicle": key.vehicle,
        "sensor": key.sensor,
        "generation": generation,
        "rotation": list(state.rotation),
        "covariance": list(state.covariance),
        "state": state.state,
        "doubted": state.doubted,
        "saved_at": state.saved_at,
        "driven_s": state.driven_s,
        "offsets": dict(state.offsets),
        "shifts": [dict(shift) for shift in state.shifts],
        "evidence": dict(state.evidence),
        **{key: True for key in ORDERED if getattr(state, key)},
        **({"doubt": state.doubt[:LONGEST_DOUBT]} if state.doubt else {}),
    }
    body = json.dumps(content, allow_nan=False, indent=1).encode()
    return with_checksum(f"{MAGIC} {VERSION} {len(body)}", body)


def decoded(data: bytes) -> tuple[int, StateKey, SavedState]:
    """Return generation, key and content of a file's bytes. Raises if they are not accepted."""
    title, body, is_right = split_checksum(data)
    words = title.split(b" ")
    if words[0] != MAGIC.encode() or len(words) != 3 or len(data) > MAX_BYTES:
        raise _NotBelievedError("corrupt", "this is not a state file")
    if words[1] not in [str(version).encode() for version in READABLE]:
        version = words[1][:12].decode("ascii", "replace")
        raise _NotBelievedError("other-version", f"its version is {version}, not {VERSION}")
    if words[2] != str(len(body)).encode():
        raise _NotBelievedError("corrupt", "the file is cut, or longer than it says")
    if not is_right:
        raise _NotBelievedError("corrupt", "its checksum is wrong")
    try:
        content = json.loads(body, parse_constant=_finite_float, parse_float=_finite_float)
        generation = content["generation"]
        key = StateKey(str(content["vehicle"]), str(content["sensor"]))
        if type(generation) is not int or not 1 <= generation <= LARGEST_NUMBER:
            raise ValueError("generation")
        return generation, key, _state_from(content)
    except Exception as error:  # whatever a file holds: without it the start goes on
        text = f"its content is not valid ({type(error).__name__}: {error})"
        raise _NotBelievedError("corrupt", text) from None


def _state_from(content: Mapping[str, Any]) -> SavedState:
    rotation, covariance = _nine(content["rotation"]), _nine(content["covariance"])
    if not _is_rotation(rotation):
        raise ValueError("rotation")
    if not _is_covariance(covariance):
        raise ValueError("covariance")
    if content["state"] not in GOOD_NAMES:
        raise ValueError("state")
    ordered = {key: content.get(key, False) for key in ORDERED}
    if not all(isinstance(value, bool) for value in ordered.values()):
        raise ValueError("held, given")
    if not isinstance(content["doubted"], bool) or not isinstance(content["shifts"], list):
        raise ValueError("doubted, shifts")
    doubt = content.get("doubt", "")
    if not isinstance(doubt, str) or len(doubt) > LONGEST_DOUBT or not doubt.isprintable():
        raise ValueError("doubt")
    return SavedState(
        rotation=rotation,
        covariance=covariance,
        state=content["state"],
        doubted=content["doubted"],
        saved_at=_finite(content["saved_at"]),
        driven_s=_finite(content["driven_s"]),
        offsets=dict(content["offsets"]),
        shifts=tuple(dict(shift) for shift in content["shifts"]),
        evidence=dict(content["evidence"]),
        doubt=doubt,
        **ordered,
    )


def _finite_float(text: str) -> float:
    """Return a number that can be saved again; raises ValueError if it is none."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is no finite number")
    return value


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("a number is missing")
    if not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:  # no NaN either
        raise ValueError("a number is too large")
    return float(value)


def _nine(values: Any) -> tuple[float, ...]:
    if not isinstance(values, list) or len(values) != 9:
        raise ValueError("nine numbers are needed")
    return tuple(_finite(v) for v in values)


def _is_rotation(rotation: tuple[float, ...]) -> bool:
    r = np.reshape(rotation, (3, 3))
    error = np.abs(r @ r.T - np.eye(3)).max()
    return bool(error <= ROTATION_TOLERANCE and np.linalg.det(r) > 0.0)


def _is_covariance(covariance: tuple[float, ...]) -> bool:
    """Return whether a covariance is symmetric, positive definite, and not too large."""
    c = np.reshape(covariance, (3, 3))
    is_symmetric = np.abs(c - c.T).max() <= 1e-12 and np.diag(c).max() <= LARGEST_VARIANCE
    return bool(is_symmetric and all(np.linalg.det(c[:n, :n]) > 0.0 for n in (1, 2, 3)))


LOCK_FILE = ".lock"


class FolderInUseError(ImucaldError):
    """Another process uses the folder for its state."""


class FolderLock:
    """Locks a folder until `release`, or until the process ends in any way.

    The folder itself is locked, which also works for a read-only folder. A file in it is locked
    too: it names the holder, and serves where a file system cannot lock folders. Raises
    FolderInUseError with the holder's pid. Raises OSError if neither can be locked.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder
        self._held: list[int] = []
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            self._take()
        except BaseException:
            self.release()
            raise

    def _take(self) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        no_lock: OSError | None = None
        try:
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise self._in_use() from None
        except OSError as error:
            no_lock = error
        try:
            file = os.open(self._path / LOCK_FILE, flags, 0o600)
        except OSError:
            if no_lock is not None:
                raise
            return
        self._held.append(file)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise self._in_use() from None
        with contextlib.suppress(OSError):  # a full disk
            os.ftruncate(file, 0)
            os.pwrite(file, f"{os.getpid()}\n".encode(), 0)

    def _in_use(self) -> FolderInUseError:
        holder = ""
        with contextlib.suppress(OSError):
            flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
            with os.fdopen(os.open(self._path / LOCK_FILE, flags), "rb") as file:
                holder = (file.read(20) or b"").decode("ascii", "replace").strip()
        return FolderInUseError(
            f"{self._path} is in use by process {holder or '?'}; name another folder with "
            "--state-dir"
        )

    def renew(self) -> bool:
        """Lock again if another folder now has the name; return whether that was so.

        Raises as the constructor does, and FolderInUseError if another process was faster.
        """
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(self._path.stat(), os.fstat(self._folder)):
                return False
        now = FolderLock(self._path)
        self.release()
        self._folder, self._held = now._folder, now._held
        return True

    def release(self) -> None:
        """Release the folder for others."""
        for descriptor in (self._folder, *self._held):
            os.close(descriptor)
        self._held = []
