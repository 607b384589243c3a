"""Dtc codes: when they are set, their status bits over tests, clearing, runs and restarts."""

from __future__ import annotations

import pytest

from imucald.uds.dtc import (
    CHECKSUM_FAILING,
    COUNTER_FAILING,
    DTCS,
    DUPLICATE_SENDER,
    FAULTY,
    GYROSCOPE_MISSING,
    ID_CONFLICT,
    NOT_CALIBRATED,
    SENSOR_MOVED,
    SPEED_MISSING,
    STATE_CORRUPT,
    DtcMemory,
)
from imucald.uds.host import FrameCounts, Symptoms
from uds_bench import Bench

UNTESTED = 0x50
PASSED = 0x00
FAILING = 0x2F
"""Failed, in this cycle, pending, confirmed, since clearing."""
OVER = 0x2E


class Run:
    """A memory that is updated every 0.2 s with symptoms that can be changed."""

    def __init__(self, memory: DtcMemory | None = None) -> None:
        self.memory = memory or DtcMemory()
        self.now = 100.0
        self.facts: dict[str, object] = {"usable": True, "moved": False, "missing": {}}
        self.used, self.conflicts = 0, 0
        self.faults: dict[str, int] = {}
        self.used_per_step = 20

    def go(self, seconds: float = 0.2, **facts: object) -> None:
        self.facts |= facts
        for _ in range(round(seconds / 0.2)):
            self.now += 0.2
            self.used += self.used_per_step
            counts = FrameCounts(used=self.used, conflicts=self.conflicts, faults=dict(self.faults))
            self.memory.update(self.now, Symptoms(**self.facts, counts=counts))

    def status(self, dtc) -> int:
        return int(self.memory.find(dtc.number).status)


def test_nothing_is_known_before_the_first_test():
    assert {int(record.status) for _, record in DtcMemory()} == {UNTESTED}


def test_all_is_well():
    run = Run()
    sound = dict.fromkeys(("accelerometer", "gyroscope", "magnetometer", "speed", "yaw_rate"), ())
    run.go(11.0, missing={"accelerometer": False, "gyroscope": False, "speed": False}, faulty=sound)
    for dtc, record in run.memory:
        expected = UNTESTED if dtc is STATE_CORRUPT else PASSED
        assert record.status == expected, dtc.name


def test_not_calibrated_is_pending_at_first_and_confirmed_after_twenty_minutes():
    run = Run()
    run.go(usable=False)
    assert run.status(NOT_CALIBRATED) == 0x27
    run.go(1199.0)
    assert run.status(NOT_CALIBRATED) == 0x27
    run.go(2.0)
    assert run.status(NOT_CALIBRATED) == FAILING
    run.go(usable=True)
    assert run.status(NOT_CALIBRATED) == OVER


def test_a_moved_sensor_is_reported_at_once():
    run = Run()
    run.go(usable=False)
    assert run.status(SENSOR_MOVED) == UNTESTED, "nothing to hold it against"
    run.go(usable=True)
    assert run.status(SENSOR_MOVED) == PASSED
    run.go(moved=True)
    assert run.status(SENSOR_MOVED) == FAILING
    run.go(moved=False)
    assert run.status(SENSOR_MOVED) == OVER


def test_missing_inputs_each_have_their_code():
    run = Run()
    run.go(missing={"accelerometer": False, "speed": True})
    assert run.status(SPEED_MISSING) == FAILING
    assert run.status(GYROSCOPE_MISSING) == UNTESTED, "not configured"
    run.go(missing={"accelerometer": False, "speed": False})
    assert run.status(SPEED_MISSING) == OVER


@pytest.mark.parametrize(
    ("dtc", "reason"),
    [
        (CHECKSUM_FAILING, "checksum"),
        (COUNTER_FAILING, "counter_repeated"),
        (COUNTER_FAILING, "counter_reversed"),
        (COUNTER_FAILING, "counter_jump"),
        (COUNTER_FAILING, "counter_invalid"),
    ],
)
def test_faults_of_frames_set_their_code_when_three_come_together(dtc, reason):
    run = Run()
    run.go(11.0)
    for _ in range(2):
        run.faults[reason] = run.faults.get(reason, 0) + 1
        run.go()
    assert run.status(dtc) == PASSED, "two are noise"
    run.go(12.0)
    run.faults[reason] += 1
    run.go(1.0)
    assert run.status(dtc) == PASSED, "the earlier ones are long ago"
    run.faults[reason] += 2
    run.go()
    assert run.status(dtc) == FAILING
    run.go(9.0)
    assert run.status(dtc) == FAILING
    run.go(3.0)
    assert run.status(dtc) == OVER


def test_faults_before_the_first_look_count():
    run = Run()
    run.faults["checksum"] = 3
    run.go()
    assert run.status(CHECKSUM_FAILING) == FAILING


def test_a_bus_on_which_nothing_is_good_passes_no_test():
    run = Run()
    run.used_per_step = 0
    run.go(60.0)
    assert run.status(CHECKSUM_FAILING) == UNTESTED
    run.faults["checksum"] = 3
    run.go(60.0)
    assert run.status(CHECKSUM_FAILING) == FAILING, "silence heals nothing"


def test_one_foreign_frame_under_our_id_is_a_conflict():
    run = Run()
    run.go(11.0)
    run.conflicts = 1
    run.go()
    assert run.status(ID_CONFLICT) == FAILING
    run.go(11.0)
    assert run.status(ID_CONFLICT) == OVER


def test_a_corrupt_state_is_reported():
    run = Run()
    run.go(state_corrupt=False)
    assert run.status(STATE_CORRUPT) == PASSED
    run.go(state_corrupt=True)
    assert run.status(STATE_CORRUPT) == FAILING


def test_cleared_codes_come_back_only_if_their_test_fails_again():
    run = Run()
    run.faults["checksum"] = 3
    run.go(usable=False, missing={"speed": True})
    run.memory.clear()
    assert {int(record.status) for _, record in run.memory} == {UNTESTED}
    run.go()
    assert run.status(SPEED_MISSING) == FAILING
    assert run.status(CHECKSUM_FAILING) == UNTESTED, "no further fault came"
    assert run.memory.find(SPEED_MISSING.number).occurrences == 1


def test_occurrences_count_up_to_their_largest_value():
    run = Run()
    for _ in range(300):
        run.go(missing={"speed": True})
        run.go(missing={"speed": False})
    assert run.memory.find(SPEED_MISSING.number).occurrences == 255


def test_over_a_restart_what_was_confirmed_stays_and_what_was_pending_ages():
    run = Run()
    run.go(moved=True)
    run.go(moved=False)
    again = Run()
    again.memory.restore(run.memory.saved())
    assert again.status(SENSOR_MOVED) == 0x6C, "pending, confirmed, since clearing; untested yet"
    again.go()
    assert again.status(SENSOR_MOVED) == 0x2C
    third = Run()
    third.memory.restore(again.memory.saved())
    third.go()
    assert third.status(SENSOR_MOVED) == 0x28, "one run without a failure: no longer pending"


def test_a_confirmed_code_is_let_go_after_forty_good_runs():
    run = Run()
    run.go(moved=True)
    memory = run.memory
    for cycle in range(41):
        assert memory.find(SENSOR_MOVED.number).status & 0x08, cycle
        later = Run()
        later.memory.restore(memory.saved())
        later.go(moved=False)
        memory = later.memory
    assert not memory.find(SENSOR_MOVED.number).status & 0x08
    assert memory.find(SENSOR_MOVED.number).aged == 0


@pytest.mark.parametrize(
    "saved", [[], [1, 2], [1, 2, "3"], [300, 0, 0], [0x80, 0, 0], [1, -1, 0], [True, 0, 0], None, 7]
)
def test_a_saved_record_that_makes_no_sense_is_passed_by(saved):
    memory = DtcMemory()
    memory.restore({f"{SENSOR_MOVED.number:06X}": saved, "zzz": [0, 0, 0]})
    assert memory.find(SENSOR_MOVED.number).status == UNTESTED


def test_codes_are_shown_as_a_tester_shows_them():
    shown = {t.name: t.display for t in DTCS}
    assert shown["not_calibrated"] == "C1A10-54"
    assert shown["checksum_failing"] == "U1A10-83"
    assert len({t.number for t in DTCS}) == len(DTCS)


# as the services tell them -----------------------------------------------------------------------


def bench_with(**facts) -> Bench:
    bench = Bench()
    given = {"usable": True, "moved": False, "missing": {}, "counts": FrameCounts(), **facts}
    bench.server.dtcs.update(0.0, Symptoms(**given))
    return bench


def test_codes_are_counted_and_listed_by_status():
    bench = bench_with(moved=True, missing={"speed": True})
    assert bench.ask("19 01 08") == "59 01 7F 00 00 02"
    assert bench.ask("19 02 08") == "59 02 7F 5A 11 76 2F 5A 14 87 2F"
    assert bench.ask("19 02 01") == "59 02 7F 5A 11 76 2F 5A 14 87 2F"
    assert bench.ask("19 02 80") == "59 02 7F", "no code asks for a lamp"
    assert bench.ask("19 82 08") is None
    everything = bench.ask("19 0A")
    assert everything.startswith("59 0A 7F 5A 10 54 00 5A 11 76 2F 5A 12 87 50")
    assert len(everything.split()) == 3 + 4 * len(DTCS)


def test_one_code_in_detail():
    bench = bench_with(moved=True)
    assert bench.ask("19 06 5A 11 76 FF") == "59 06 5A 11 76 2F 01 01 02 00"
    assert bench.ask("19 06 5A 11 76 01") == "59 06 5A 11 76 2F 01 01"
    assert bench.ask("19 06 5A 11 76 02") == "59 06 5A 11 76 2F 02 00"


def test_codes_are_cleared_one_by_one_and_all_together():
    bench = bench_with(moved=True, missing={"speed": True})
    assert bench.ask("14 5A 11 76") == "54"
    assert bench.ask("19 02 08") == "59 02 7F 5A 14 87 2F"
    assert bench.ask("14 FF FF FF") == "54"
    assert bench.ask("19 02 08") == "59 02 7F"


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope", "magnetometer"])
@pytest.mark.parametrize("fault", ["stuck", "saturated", "implausible"])
def test_a_faulty_sensor_has_a_code_for_each_fault(sensor, fault):
    run = Run()
    run.go(faulty={sensor: [fault]})
    failing = {dtc.name for dtc, record in run.memory if record.status == FAILING}
    assert failing == {f"{sensor}_{fault}"}
    run.go(faulty={sensor: []})
    assert run.status(FAULTY[sensor][fault]) == OVER


def test_a_duplicate_sender_is_reported_from_three_frames_on():
    run = Run()
    run.faults["duplicate_sender"] = 2
    run.go()
    assert run.status(DUPLICATE_SENDER) == UNTESTED
    run.faults["duplicate_sender"] = 3
    run.go()
    assert run.status(DUPLICATE_SENDER) == FAILING
    run.go(11.0)
    assert run.status(DUPLICATE_SENDER) == OVER
