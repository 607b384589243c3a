"""Trouble codes outlive the daemon, whatever becomes of their file."""

from __future__ import annotations

from pathlib import Path

import pytest

from imucald.service.dtc_store import MAX_BYTES, TroubleKeeper
from imucald.uds.dtc import NOT_CALIBRATED, SENSOR_MOVED
from imucald.uds.host import Counts, Symptoms
from uds_bus import UdsBench, asking, with_diagnostics
from uds_subject import Clock


class Kept:
    """Keepers of one file, one after the other."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "state" / "car.troubles"
        self.clock = Clock()
        self.said: list[str] = []

    def keeper(self) -> TroubleKeeper:
        return TroubleKeeper(self.path, self.said.append, self.clock)


def fail(keeper: TroubleKeeper, moved: bool = True) -> None:
    keeper.memory.update(0.0, Symptoms(usable=True, moved=moved, missing={}, counts=Counts()))


def status(keeper: TroubleKeeper, trouble=SENSOR_MOVED) -> int:
    return int(keeper.memory.find(trouble.number).status)


@pytest.fixture
def kept(tmp_path) -> Kept:
    return Kept(tmp_path)


def test_codes_come_back_as_of_an_earlier_run(kept):
    first = kept.keeper()
    fail(first)
    first.close()
    second = kept.keeper()
    assert status(second) == 0x6C, "pending, confirmed, failed since clearing; not tested yet"
    assert second.memory.find(SENSOR_MOVED.number).occurrences == 1
    assert kept.said == []


def test_they_are_written_when_they_change_and_not_too_often(kept):
    keeper = kept.keeper()
    keeper.update()
    assert not kept.path.exists()
    fail(keeper)
    keeper.update()
    keeper._writer.flush(5.0)
    written = kept.path.read_bytes()
    fail(keeper, moved=False)
    kept.clock.now += 9.0
    keeper.update()
    keeper._writer.flush(5.0)
    assert kept.path.read_bytes() == written
    kept.clock.now += 2.0
    keeper.update()
    keeper._writer.flush(5.0)
    assert kept.path.read_bytes() != written
    assert list(kept.path.parent.iterdir()) == [kept.path], "no temporary file is left"
    keeper.close()


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
def test_a_damaged_file_is_set_aside_and_said(kept, damage):
    first = kept.keeper()
    fail(first)
    first.close()
    damaged = damage(kept.path.read_bytes())
    for number in (1, 2):
        kept.path.write_bytes(damaged)
        again = kept.keeper()
        assert status(again) == 0x50
        aside = kept.path.with_name(f"car.troubles.corrupt.{number}")
        assert aside.read_bytes() == damaged
        assert "damaged" in kept.said[-1]
    fail(again)
    again.close()
    assert status(kept.keeper()) == 0x6C, "and begun anew"


def test_a_folder_that_cannot_be_written_is_said_once(kept):
    kept.path.parent.write_text("a file where a folder should be")
    keeper = kept.keeper()
    for moved in (True, False, True):
        fail(keeper, moved)
        keeper.update()
        keeper._writer.flush(5.0)
        kept.clock.now += 20.0
    keeper.close()
    assert len([line for line in kept.said if "cannot be saved" in line]) == 1
    assert status(keeper) == 0x2F


def test_without_a_folder_they_are_kept_in_memory():
    keeper = TroubleKeeper(None, print)
    fail(keeper)
    keeper.update()
    keeper.close()
    assert status(keeper) == 0x2F


def test_a_tester_finds_the_codes_of_the_last_run(tmp_path):
    config = with_diagnostics(tmp_path, cycles=1)
    with UdsBench(tmp_path, config) as bench:
        bench.play(1.0)
        bench.send(0x640, bytes(8))
        bench.wait_for(
            lambda: bool(bench.service.diagnostics.server.troubles.find(0xDA1181).status & 0x08)
        )
    with UdsBench(tmp_path, config) as bench, asking(bench.tester_bus) as client:
        found = client.get_dtc_by_status_mask(0x08).service_data.dtcs
        assert 0xDA1181 in {d.id for d in found}
        client.clear_dtc(0xDA1181)
    with UdsBench(tmp_path, config) as bench, asking(bench.tester_bus) as client:
        found = client.get_dtc_by_status_mask(0x08).service_data.dtcs
        assert 0xDA1181 not in {d.id for d in found}
        assert NOT_CALIBRATED.number in {d.id for d in client.get_supported_dtc().service_data.dtcs}
