"""Dtc codes outlive the daemon, whatever becomes of their file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from imucald.core.files import with_checksum
from imucald.service.records import MAX_BYTES
from imucald.service.uds_records import DtcStore
from imucald.uds.dtc import NOT_CALIBRATED, SENSOR_MOVED
from imucald.uds.host import FrameCounts, Symptoms
from uds_bench import Clock
from uds_bus import UdsBench, asking, with_diagnostics


class Kept:
    """Stores of one file, one after the other."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "state" / "car.troubles"
        self.clock = Clock()
        self.lines: list[str] = []

    def store(self) -> DtcStore:
        return DtcStore(self.path, self._say, self.clock)

    def _say(self, text: str, priority: int) -> None:
        self.lines.append(text)


def fail(store: DtcStore, moved: bool = True) -> None:
    store.memory.update(0.0, Symptoms(usable=True, moved=moved, missing={}, counts=FrameCounts()))


def status(store: DtcStore, dtc=SENSOR_MOVED) -> int:
    return int(store.memory.find(dtc.number).status)


@pytest.fixture
def kept(tmp_path) -> Kept:
    return Kept(tmp_path)


def test_codes_come_back_as_of_an_earlier_run(kept):
    first = kept.store()
    fail(first)
    first.close()
    second = kept.store()
    assert status(second) == 0x6C, "pending, confirmed, failed since clearing; not tested yet"
    assert second.memory.find(SENSOR_MOVED.number).occurrences == 1
    assert kept.lines == []


def test_they_are_written_when_they_change_and_not_too_often(kept):
    store = kept.store()
    store.update()
    assert not kept.path.exists()
    fail(store)
    store.update()
    store.writer.flush(5.0)
    written = kept.path.read_bytes()
    fail(store, moved=False)
    kept.clock.now += 9.0
    store.update()
    store.writer.flush(5.0)
    assert kept.path.read_bytes() == written
    kept.clock.now += 2.0
    store.update()
    store.writer.flush(5.0)
    assert kept.path.read_bytes() != written
    assert list(kept.path.parent.iterdir()) == [kept.path], "no temporary file is left"
    store.close()


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda data: data[:-1],
        lambda data: data.replace(b"[", b"{", 1),
        lambda data: bytes([data[0] ^ 1]) + data[1:],
        lambda data: data[:40] + bytes([data[40] ^ 4]) + data[41:],
        lambda data: data + b" " * MAX_BYTES,
        lambda _: b"\xff" * 500,
    ],
)
def test_a_damaged_file_is_set_aside_and_reported(kept, damage):
    first = kept.store()
    fail(first)
    first.close()
    damaged = damage(kept.path.read_bytes())
    for number in (1, 2):
        kept.path.write_bytes(damaged)
        again = kept.store()
        assert status(again) == 0x50
        aside = kept.path.with_name(f"car.troubles.corrupt.{number}")
        assert aside.read_bytes() == damaged
        assert "damaged" in kept.lines[-1]
    fail(again)
    again.close()
    assert status(kept.store()) == 0x6C, "and begun anew"


def test_codes_in_the_first_format_are_read_and_written_in_the_present_one(kept):
    first = kept.store()
    fail(first)
    kept.path.parent.mkdir()
    body = json.dumps(first.memory.saved()).encode()
    kept.path.write_bytes(with_checksum("imucald-troubles 1", body))
    again = kept.store()
    assert status(again) == 0x6C
    fail(again)
    again.close()
    assert kept.path.read_bytes().startswith(b"imucald-troubles 2 ")
    assert status(kept.store()) == 0x6C
    assert kept.lines == []


def test_a_folder_that_cannot_be_written_is_reported_once(kept):
    kept.path.parent.write_text("a file where a folder should be")
    store = kept.store()
    for moved in (True, False, True):
        fail(store, moved)
        store.update()
        store.writer.flush(5.0)
        kept.clock.now += 20.0
    store.close()
    assert len([line for line in kept.lines if "cannot be saved" in line]) == 1
    assert status(store) == 0x2F


def test_without_a_folder_they_are_kept_in_memory():
    store = DtcStore(None, print)
    fail(store)
    store.update()
    store.close()
    assert status(store) == 0x2F


def test_a_tester_finds_the_codes_of_the_last_run(tmp_path):
    config = with_diagnostics(tmp_path, cycles=1)
    with UdsBench(tmp_path, config) as bench:
        bench.play(1.0)
        bench.send(0x640, bytes(8))
        bench.wait_for(
            lambda: bool(
                bench.service.parts.diagnostics.uds.server.dtcs.find(0xDA1181).status & 0x08
            )
        )
    with UdsBench(tmp_path, config) as bench, asking(bench.tester_bus) as client:
        found = client.get_dtc_by_status_mask(0x08).service_data.dtcs
        assert 0xDA1181 in {d.id for d in found}
        client.clear_dtc(0xDA1181)
    with UdsBench(tmp_path, config) as bench, asking(bench.tester_bus) as client:
        found = client.get_dtc_by_status_mask(0x08).service_data.dtcs
        assert 0xDA1181 not in {d.id for d in found}
        assert NOT_CALIBRATED.number in {d.id for d in client.get_supported_dtc().service_data.dtcs}
