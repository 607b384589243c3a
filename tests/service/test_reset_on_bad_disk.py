"""A reset that the disk does not take: it says so, is tried again, and is final in the end."""

from __future__ import annotations

import contextlib
import errno
import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import uds_bench
from full_disk import full_after
from imucald.config.calibration import KnownMount
from imucald.mount.estimate import MountState
from imucald.runtime.mount_orders import TESTER
from imucald.service import records
from imucald.service.asking import ask
from imucald.service.calibration_store import CalibrationStore
from imucald.service.saved_state import StateStore
from imucald.service.service import Service
from imucald.service.uds_host import LiveHost
from service_bench import Bench, running
from service_files import KEY, state

ME = "root (pid 7)"


class ReadOnly:
    """A file system that is mounted read-only, for as long as `on`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.on = False
        self.kept: set[str] = set()
        """Endings of files that cannot be renamed though the rest can be written."""
        for name in ("rename", "replace"):
            monkeypatch.setattr(Path, name, self._guarded(getattr(Path, name), is_rename=True))
        monkeypatch.setattr(records, "write_beside", self._guarded(records.write_beside))

    def _guarded(self, function, is_rename: bool = False):
        def guarded(path: Path, *arguments: object):
            if self.on or (is_rename and path.suffix in self.kept):
                raise OSError(errno.EROFS, "Read-only file system", str(path))
            return function(path, *arguments)

        return guarded


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> ReadOnly:
    return ReadOnly(monkeypatch)


class Kept:
    """A store with two generations on the disk, and what it says."""

    def __init__(self, folder: Path, retry: float = 0.02) -> None:
        self.said: list[str] = []
        store = StateStore(folder, KEY)
        store.save(state(1.0))
        store.save(state(2.0))
        self.keeper = CalibrationStore(store, lambda text, _: self.said.append(text))
        self.keeper.writer._retry = retry

    def wait(self) -> None:
        end = time.monotonic() + 5.0
        while not self.keeper.store.is_forgotten:
            assert time.monotonic() < end
            time.sleep(0.005)


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[Kept]:
    made = Kept(tmp_path)
    yield made
    made.keeper.writer.close(1.0)


def loaded(folder: Path):
    return StateStore(folder, KEY).load().content


def test_a_reset_is_tried_again_until_the_disk_takes_it(kept, disk, tmp_path):
    disk.on = True
    assert kept.keeper.forget() == "Read-only file system"
    assert kept.keeper.status()["to_be_forgotten"]
    assert kept.keeper.status()["generation"] == 0, "it is not what a reset counts as saved"
    assert loaded(tmp_path) == state(2.0)
    time.sleep(0.1)
    assert kept.keeper.writer.failures > 1
    disk.on = False
    kept.wait()
    assert loaded(tmp_path) is None
    assert len(list(tmp_path.glob("*.forgotten.1"))) == 2
    kept.keeper.update(_Waiting(), 1.0)
    assert not kept.keeper.status()["to_be_forgotten"]
    assert "the reset is final" in kept.said[-1]


class _Waiting:
    """As much of an estimator as an update needs."""

    state = MountState.WAITING


def test_a_full_disk_takes_a_reset(kept, tmp_path):
    """A database would need space for its journal."""
    with full_after(0):
        assert kept.keeper.forget() == ""
        assert loaded(tmp_path) is None


def test_a_reset_that_the_disk_takes_at_once_is_reported_as_before(kept, tmp_path):
    assert kept.keeper.forget() == ""
    assert loaded(tmp_path) is None
    assert not kept.keeper.status()["to_be_forgotten"]
    assert kept.said == []


def test_what_is_learnt_after_such_a_reset_is_saved_and_nothing_from_before_it_is_left(
    kept, disk, tmp_path
):
    disk.on = True
    kept.keeper.forget()
    store = kept.keeper.store
    kept.keeper.writer.put((store.era, state(7.0)))  # takes the place of what was to be forgotten
    time.sleep(0.05)
    disk.on = False
    assert kept.keeper.writer.flush(5.0)
    assert store.is_forgotten
    assert loaded(tmp_path) == state(7.0)
    newest = max(
        StateStore(tmp_path, KEY).path(slot) for slot in (0, 1) if store.path(slot).exists()
    )
    newest.write_bytes(b"damaged")
    assert loaded(tmp_path) is None, "the generation before it is not one from before the reset"


def test_a_file_that_can_only_be_replaced_is_replaced_by_what_is_learnt_next(kept, disk, tmp_path):
    disk.kept = {".0", ".1"}  # they keep their names, whatever is done
    kept.keeper.forget()
    kept.keeper.writer.put((kept.keeper.store.era, state(7.0)))
    kept.wait()
    assert loaded(tmp_path) == state(7.0)
    for slot in (0, 1):
        content = kept.keeper.store.path(slot).read_bytes()
        assert b'"driven_s": 7.0' in content


def test_one_generation_that_cannot_be_set_aside_does_not_keep_the_other(kept, disk, tmp_path):
    disk.kept = {".0"}
    assert kept.keeper.forget()
    assert not kept.keeper.store.path(1).exists()
    assert kept.keeper.store.path(0).exists()


def test_a_stop_before_the_disk_took_it_says_that_the_next_start_brings_it_back(kept, disk):
    disk.on = True
    kept.keeper.forget()
    kept.keeper.close(_Waiting(), 1.0)
    assert "the next start restores this state" in " ".join(kept.said)
    assert "the previous state is still saved" not in " ".join(kept.said)


def learnt(bench: Bench) -> Service:
    service = bench.service()
    bench.drive(service)
    service._every_second(time.monotonic())
    assert service.parts.calibration_store is not None
    assert service.parts.calibration_store.writer.flush(5.0)
    return service


def test_order_log_and_status_say_that_it_is_not_on_the_disk_yet(tmp_path, disk):
    bench = Bench(tmp_path)
    service = learnt(bench)
    store = service.parts.calibration_store
    assert store is not None
    store.writer._retry = 0.02
    with running(service):
        assert service.sockets.control is not None
        disk.on = True
        answer = json.loads(ask(service.sockets.control.path, '{"order": "reset"}'))["done"]
        assert "NOT SAVED YET (Read-only file system)" in answer
        assert json.loads(ask(tmp_path / "status.sock", "status"))["saved_state"]["to_be_forgotten"]
        assert not service.state_forgotten
        disk.on = False
        end = time.monotonic() + 5.0
        while "the reset is final" not in bench.log.getvalue():
            assert time.monotonic() < end
            time.sleep(0.01)
        assert service.state_forgotten
        answer = json.loads(ask(service.sockets.control.path, '{"order": "reset"}'))["done"]
        assert "DISK" not in answer
    assert "NOT SAVED YET" in bench.log.getvalue()
    again = bench.service()
    assert again.engine.pipeline.quality == 0
    again.close()


@pytest.mark.parametrize("is_full", [True, False], ids=["full", "no folder"])
def test_every_order_that_will_not_outlast_a_restart_says_so(tmp_path, is_full):
    bench = Bench(tmp_path)
    service = learnt(bench)
    assert "DISK" not in service.orders.hold(ME)
    assert "DISK" not in service.orders.release(ME)
    folder = tmp_path / "state"
    if not is_full:
        service.parts.calibration_store.writer.flush(1.0)
        shutil.rmtree(folder)
        folder.write_text("in the way")
    with full_after(1000) if is_full else contextlib.nullcontext():
        for answer in (
            service.orders.hold(ME),
            service.orders.release(ME),
            service.orders.set_mount(KnownMount(0.0, 0.0, 40.0, 0.5), ME),
        ):
            assert "NOT SAVED YET (F" in answer
    if not is_full:
        folder.unlink()
    assert "DISK" not in service.orders.hold(ME)
    service.close()
    assert not list(folder.glob("*probe*"))


def test_a_mount_that_is_set_says_so_as_well(tmp_path, disk):
    bench = Bench(tmp_path)
    service = learnt(bench)
    disk.on = True
    assert "NOT SAVED YET" in service.orders.set_mount(KnownMount(0.0, 0.0, 40.0, 0.5), ME)
    disk.on = False
    service.close()
    again = bench.service()
    assert again.status()["mount"]["yaw_deg"] == pytest.approx(40.0)
    again.close()


def test_a_tester_sees_its_reset_run_until_the_disk_has_taken_it():
    tester = uds_bench.Bench()
    tester.unlock()
    tester.host.is_forgotten = False
    assert tester.ask("31 01 F0 11") == "71 01 F0 11 01"
    assert tester.ask("31 03 F0 11").startswith("71 03 F0 11 01")
    assert tester.ask("31 02 F0 11") == "7F 31 22", "nothing can be taken back"
    assert tester.ask("31 01 F0 11") == "71 01 F0 11 01", "what was learnt since goes too"
    assert tester.host.done == ["forget", "forget"]
    tester.host.is_forgotten = True
    assert tester.ask("31 03 F0 11").startswith("71 03 F0 11 02")
    assert tester.ask("31 01 F0 11") == "71 01 F0 11 02"


def test_a_tester_on_the_bus_is_told_by_the_same_disk(tmp_path, disk):
    service = learnt(Bench(tmp_path))
    host = LiveHost(service, time.monotonic)
    assert host.is_forgotten
    disk.on = True
    host.forget()
    assert not host.is_forgotten
    assert f"(by {TESTER})" in service.journal.events[-1].text
    disk.on = False
    service.close()
    assert host.is_forgotten
