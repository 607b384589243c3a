"""The state folder under hostile fortune: resets on slow disks, forged files, a second daemon."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import shuttle
from feed_bench import wait_until
from imucald.core import files
from imucald.core.errors import ImucaldError
from imucald.core.files import free_name, write_file
from imucald.service.calibration_store import CalibrationStore
from imucald.service.folder_lock import FolderInUseError, FolderLock
from imucald.service.parts import ServiceOptions
from imucald.service.records import VERSION
from imucald.service.saved_state import KIND, SavedState, StateKey, StateStore
from imucald.service.service import Service
from service_bench import running

KEY = StateKey("car", "imu")
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
GOOD = SavedState(IDENTITY, tuple(1e-4 * x for x in IDENTITY), "fine")
HUGE = "9" * 400


class SlowDisk:
    """fsync takes until `confirm`; whoever waits for it is counted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked, self.go_on = threading.Event(), threading.Event()
        self.threads: set[str] = set()
        monkeypatch.setattr(files.os, "fsync", self.fsync)

    def fsync(self, _: int) -> None:
        self.threads.add(threading.current_thread().name)
        self.asked.set()
        assert self.go_on.wait(10.0)


def calibration_store(folder: Path) -> CalibrationStore:
    return CalibrationStore(StateStore(folder, KEY), lambda *_: None)


def test_what_a_tester_reset_while_it_was_being_saved_never_comes_back(tmp_path, monkeypatch):
    StateStore(tmp_path, KEY).save(GOOD)
    keeper = calibration_store(tmp_path)
    keeper.store.load()
    disk = SlowDisk(monkeypatch)
    keeper.writer.put((keeper.store.era, GOOD))
    assert disk.asked.wait(5.0)
    began = time.monotonic()
    keeper.forget()
    assert time.monotonic() - began < 0.3, "the loop waits for no disk"
    assert StateStore(tmp_path, KEY).load().content is None, "at once"
    disk.go_on.set()
    assert keeper.writer.close(5.0)
    assert StateStore(tmp_path, KEY).load().content is None, "nor when the disk is done"
    assert disk.threads == {"state"}, "only the thread that writes has waited"
    assert not list(tmp_path.glob("*.tmp"))


def test_what_waited_to_be_saved_when_it_was_reset_is_not_saved_and_what_is_new_is(tmp_path):
    keeper = calibration_store(tmp_path)
    old = keeper.store.era
    keeper.forget()
    keeper.store.save(GOOD, old)
    assert StateStore(tmp_path, KEY).load().content is None
    keeper.store.save(GOOD)
    assert StateStore(tmp_path, KEY).load().content == GOOD
    assert keeper.writer.close(5.0)


def forged(folder: Path, **changes: str) -> None:
    """A state file whose checksum is right and whose numbers are not; values as JSON text."""
    body = StateStore(folder, KEY).encoded(3, GOOD).partition(b"\n")[2].decode()
    content = json.loads(body)
    for name in changes:
        content[name] = f"@{name}@"
    body = json.dumps(content)
    for name, text in changes.items():
        body = body.replace(f'"@{name}@"', text)
    data = body.encode()
    head = f"{KIND} {VERSION} {len(data)} {hashlib.sha256(data).hexdigest()}\n"
    folder.mkdir(exist_ok=True)
    (folder / f"{KEY.file_name}.0").write_bytes(head.encode() + data)


@pytest.mark.parametrize(
    "changes",
    [
        {"saved_at": HUGE},
        {"driven_s": f"-{HUGE}"},
        {"generation": HUGE},
        {"generation": "9007199254740993"},
        {"rotation": f"[{HUGE}, 0, 0, 0, 1, 0, 0, 0, 1]"},
        {"covariance": f"[{HUGE}, 0, 0, 0, 1, 0, 0, 0, 1]"},
        {"saved_at": "1e400"},
        {"saved_at": "9" * 5000},
        {"offsets": "[[1]]"},
        {"shifts": "[1]"},
        {"evidence": "7"},
    ],
    ids=lambda c: next(iter(c)) + "=" + next(iter(c.values()))[:12],
)
def test_a_forged_file_with_a_right_checksum_is_set_aside_and_stops_no_start(changes, tmp_path):
    forged(tmp_path, **changes)
    loaded = StateStore(tmp_path, KEY).load()
    assert loaded.content is None
    assert "is not valid" in loaded.problems[0]
    assert len(list(tmp_path.glob("*.corrupt.1"))) == 1


def test_whatever_the_saved_evidence_holds_the_start_goes_on_without(tmp_path):
    texts = (
        HUGE,
        f'{{"blocks": {HUGE}}}',
        "[]",
        '{"version": null}',
        '{"a": ' * 50 + "1" + "}" * 50,
    )
    for text in texts:
        forged(tmp_path, evidence=f'{{"sums": {text}}}')
        keeper = calibration_store(tmp_path)
        assert keeper.restore(_Estimator()) is not None


class _Estimator:
    """As much of an estimator as restoring needs."""

    correction = None


def test_files_set_aside_are_limited_in_number(tmp_path):
    path = tmp_path / "a"
    for i in range(20):
        path.write_text(str(i))
        os.utime(path, ns=(i * 10**9, i * 10**9))
        path.rename(free_name(path, "corrupt"))
    kept = sorted(int(p.read_text()) for p in tmp_path.iterdir())
    assert kept == list(range(12, 20))


def test_what_a_power_cut_left_unfinished_is_removed_at_the_start(tmp_path):
    state = tmp_path / "state"
    state.mkdir()
    (state / "car.state.0.tmp").touch()
    (state / "car.troubles.tmp").write_bytes(b"half")
    (state / "security.keys.tmp").symlink_to(tmp_path / "elsewhere")
    service(tmp_path).close()
    assert not list(state.glob("*.tmp"))


def test_a_link_in_the_place_of_the_unfinished_file_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "a.tmp").symlink_to(victim)
    write_file(tmp_path / "a", b"new")
    assert (victim.read_text(), (tmp_path / "a").read_text()) == ("precious", "new")


def service(folder: Path) -> Service:
    config = folder / "shuttle.yaml"
    if not config.exists():
        shuttle.write(folder, cycles=1)
    return Service(
        ServiceOptions(
            config,
            interface="virtual",
            channel=f"folder-{time.monotonic_ns()}",
            state_folder=folder / "state",
        )
    )


def test_a_second_daemon_on_one_folder_is_refused_with_the_pid_of_the_first(tmp_path):
    first = service(tmp_path)
    with pytest.raises(FolderInUseError, match=rf"in use by process {os.getpid()}; "):
        service(tmp_path)
    first.close()
    service(tmp_path).close()


def test_a_killed_daemon_leaves_no_lock(tmp_path):
    code = (
        "import sys, time; from pathlib import Path;"
        "from imucald.service.folder_lock import FolderLock;"
        f"lock = FolderLock(Path({str(tmp_path)!r})); print('held', flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    with pytest.raises(ImucaldError, match=f"process {process.pid}"):
        FolderLock(tmp_path)
    process.kill()
    process.wait()
    process.stdout.close()
    FolderLock(tmp_path).release()


def test_the_lock_file_is_neither_followed_nor_waited_for(tmp_path):
    """The folder is locked all the same."""
    target = tmp_path / "target"
    target.write_text("as it was")
    folder = tmp_path / "state"
    folder.mkdir()
    for make in (os.mkfifo, lambda path: path.symlink_to(target)):
        make(folder / ".lock")
        lock = FolderLock(folder)
        with pytest.raises(FolderInUseError):
            FolderLock(folder)
        lock.release()
        (folder / ".lock").unlink()
    assert target.read_text() == "as it was"


def test_a_folder_that_was_deleted_is_locked_again_and_no_second_daemon_starts(tmp_path):
    first = service(tmp_path)
    with running(first):
        for _ in range(2):
            shutil.rmtree(tmp_path / "state")
            wait_until((tmp_path / "state" / ".lock").exists)
            with pytest.raises(FolderInUseError, match=f"process {os.getpid()}"):
                service(tmp_path)


def test_who_comes_too_late_to_lock_a_new_folder_ends_and_saves_nothing(tmp_path):
    first = service(tmp_path)
    shutil.rmtree(tmp_path / "state")
    second = service(tmp_path)
    before = sorted(p.name for p in (tmp_path / "state").iterdir())
    with pytest.raises(FolderInUseError, match="is in use by process"):
        first.run(3.0)
    first.close()
    assert sorted(p.name for p in (tmp_path / "state").iterdir()) == before
    second.close()


def test_a_folder_without_the_lock_file_is_locked_too(tmp_path, monkeypatch):
    """As on a file system that is read-only."""
    opened = os.open

    def read_only(path, flags, *more, **named):
        if flags & (os.O_WRONLY | os.O_RDWR) and Path(path).parent == tmp_path / "state":
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        return opened(path, flags, *more, **named)

    monkeypatch.setattr(os, "open", read_only)
    first = service(tmp_path)
    with pytest.raises(FolderInUseError, match="in use by process"):
        service(tmp_path)
    first.close()


def test_a_folder_that_cannot_be_made_at_the_start_is_locked_as_soon_as_it_can(tmp_path):
    (tmp_path / "state").write_text("in the way")
    first = service(tmp_path)
    with running(first):
        (tmp_path / "state").unlink()
        wait_until((tmp_path / "state" / ".lock").exists)
        with pytest.raises(FolderInUseError):
            service(tmp_path)
