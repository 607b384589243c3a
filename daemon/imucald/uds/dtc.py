"""The diagnostic trouble codes (DTCs), their memory with the status bits of ISO 14229-1, and the
tests that set them.

An operation cycle is one run of the daemon.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

from msgspec import Meta, ValidationError, convert

from imucald.uds.host import Symptoms


@dataclass(frozen=True)
class Dtc:
    """One DTC.

    number: three bytes, the last is the failure type (SAE J2012-DA). confirm_after: duration of the
    failure until the code is confirmed [s].
    """

    number: int
    name: str
    meaning: str
    confirm_after: float = 0.0

    @property
    def display(self) -> str:
        """The code as a tester shows it, such as "C1A10-54"."""
        kind = "PCBU"[self.number >> 22]
        return f"{kind}{self.number >> 8 & 0x3FFF:04X}-{self.number & 0xFF:02X}"


FAULTS: Final = {
    "saturated": (0x22, "many of its values are at the end of its range"),
    "stuck": (0x2A, "one or more of its axes repeat the same value"),
    "implausible": (0x64, "its values are impossible for a road vehicle, or its unit is wrong"),
}
"""Faults of sensors, each with its failure type and its meaning. The failure types are: signal
amplitude above maximum, signal stuck in range, signal plausibility failure."""
FAULTY: Final = {
    sensor: {
        fault: Dtc(code << 8 | kind, f"{sensor}_{fault}", meaning)
        for fault, (kind, meaning) in FAULTS.items()
    }
    for sensor, code in (("accelerometer", 0x5A12), ("gyroscope", 0x5A13), ("magnetometer", 0x5A16))
} | {
    signal: {"stuck": Dtc(code << 8 | FAULTS["stuck"][0], f"{signal}_stuck", meaning)}
    for signal, code, meaning in (
        ("speed", 0x5A14, "it repeats the same value while the motion of the vehicle changes"),
        ("yaw_rate", 0x5A17, "it repeats the same value while the vehicle turns"),
    )
}
"""The DTC of each fault, by sensor or signal."""
# confirmed after 20 min, because a calibration takes minutes of driving
NOT_CALIBRATED = Dtc(0x5A1054, "not_calibrated", "no correction of the sensor is known yet", 1200.0)
SENSOR_MOVED = Dtc(0x5A1176, "sensor_moved", "the sensor seems to have been moved")
ACCELEROMETER_MISSING = Dtc(0x5A1287, "accelerometer_missing", "no good sample for a second")
GYROSCOPE_MISSING = Dtc(0x5A1387, "gyroscope_missing", "no good sample for a second")
SPEED_MISSING = Dtc(0x5A1487, "speed_missing", "no good sample for a second")
CHECKSUM_FAILING = Dtc(
    0xDA1083, "checksum_failing", "three frames with a wrong checksum within ten seconds"
)
COUNTER_FAILING = Dtc(
    0xDA1082,
    "counter_failing",
    "three frames with a repeated, reversed, jumping or invalid counter within ten seconds",
)
DUPLICATE_SENDER = Dtc(
    0xDA1281, "duplicate_sender", "an input comes more often than one sender can send it"
)
ID_CONFLICT = Dtc(0xDA1181, "id_conflict", "another node sends our identifiers")
STATE_CORRUPT = Dtc(0x5A1546, "state_corrupt", "the saved state could not be used")

DTCS: Final = (
    NOT_CALIBRATED,
    SENSOR_MOVED,
    ACCELEROMETER_MISSING,
    GYROSCOPE_MISSING,
    SPEED_MISSING,
    STATE_CORRUPT,
    COUNTER_FAILING,
    CHECKSUM_FAILING,
    ID_CONFLICT,
    DUPLICATE_SENDER,
    *(dtc for faults in FAULTY.values() for dtc in faults.values()),
)
"""All DTCs, in the order in which they are reported."""

WINDOW_S: Final = 10.0
"""Window for counting faults of frames [s]. The test is passed after this time without a fault."""
FRAME_FAULTS: Final = 3
"""Number of faults in the window that fail the test. Bus noise causes only single faults."""
AGED_OUT: Final = 40
"""Number of consecutive cycles without a failure after which a confirmed code is removed."""
OF_FRAMES: Final[Mapping[Dtc, tuple[str, ...]]] = {
    CHECKSUM_FAILING: ("checksum",),
    COUNTER_FAILING: ("counter_invalid", "counter_repeated", "counter_reversed", "counter_jump"),
    DUPLICATE_SENDER: ("duplicate_sender",),
}
"""The reasons for rejected frames that set a code."""


class DtcStatus(enum.IntFlag):
    """The status bits of a code."""

    TEST_FAILED = 0x01
    FAILED_THIS_CYCLE = 0x02
    PENDING = 0x04
    CONFIRMED = 0x08
    NOT_COMPLETED_SINCE_CLEAR = 0x10
    FAILED_SINCE_CLEAR = 0x20
    NOT_COMPLETED_THIS_CYCLE = 0x40


AVAILABLE: Final = 0x7F
"""All supported bits: all except the request of a warning lamp."""
_Status = Annotated[int, Meta(ge=0, le=AVAILABLE)]
_Byte = Annotated[int, Meta(ge=0, le=255)]
CLEARED: Final = DtcStatus.NOT_COMPLETED_SINCE_CLEAR | DtcStatus.NOT_COMPLETED_THIS_CYCLE


_MISSING: Mapping[str, Dtc] = {
    "accelerometer": ACCELEROMETER_MISSING,
    "gyroscope": GYROSCOPE_MISSING,
    "speed": SPEED_MISSING,
}


class FaultRate:
    """A test with a counter of faults. The test fails if there are `limit` faults in the window,
    and passes if there is no fault.

    With fewer than `limit` faults, or before the first frame, there is no result (None).
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._total = 0
        self._recent: deque[float] = deque(maxlen=limit)
        self._alive_since: float | None = None

    def judge(self, now: float, total: int, alive: bool) -> bool | None:
        """Return the result of the test: True means failed. total: value of the counter. alive:
        True if frames arrived."""
        self._recent.extend([now] * min(max(total - self._total, 0), self._limit))
        self._total = total
        if len(self._recent) == self._limit and now - self._recent[0] < WINDOW_S:
            return True
        if not alive:
            self._alive_since = None
            return None
        if self._alive_since is None:
            self._alive_since = now
        quiet_since = max([self._alive_since, *self._recent])
        return False if now - quiet_since >= WINDOW_S else None

    def forget(self) -> None:
        """Ignore all faults so far."""
        self._recent.clear()


@dataclass
class DtcRecord:
    """The stored data of one code. occurrences, aged: 0 to 255."""

    status: DtcStatus = CLEARED
    occurrences: int = 0
    aged: int = 0
    """Number of consecutive cycles without a failure since the code was confirmed."""
    failing_since: float | None = None

    def failed(self, now: float, confirm_after: float) -> None:
        """Register a failed test."""
        if not self.status & DtcStatus.TEST_FAILED:
            self.occurrences = min(self.occurrences + 1, 255)
            self.failing_since = now
        self.status &= ~CLEARED
        self.status |= DtcStatus.TEST_FAILED | DtcStatus.FAILED_THIS_CYCLE
        self.status |= DtcStatus.PENDING | DtcStatus.FAILED_SINCE_CLEAR
        if self.failing_since is None or now - self.failing_since >= confirm_after:
            self.status |= DtcStatus.CONFIRMED
            self.aged = 0

    def passed(self) -> None:
        """Register a passed test."""
        self.status &= ~(CLEARED | DtcStatus.TEST_FAILED)
        self.failing_since = None

    def new_cycle(self) -> None:
        """Begin a new operation cycle."""
        failed = bool(self.status & DtcStatus.FAILED_THIS_CYCLE)
        completed = not self.status & DtcStatus.NOT_COMPLETED_THIS_CYCLE
        if completed and not failed:
            self.status &= ~DtcStatus.PENDING
            if self.status & DtcStatus.CONFIRMED:
                self.aged = min(self.aged + 1, 255)
                if self.aged >= AGED_OUT:
                    self.status &= ~DtcStatus.CONFIRMED
                    self.aged = 0
        self.status &= ~(DtcStatus.FAILED_THIS_CYCLE | DtcStatus.TEST_FAILED)
        self.status |= DtcStatus.NOT_COMPLETED_THIS_CYCLE
        self.failing_since = None


@dataclass
class DtcMemory:
    """The memory of all DTCs. `update` is called several times per second with the symptoms."""

    _records: dict[int, DtcRecord] = field(
        default_factory=lambda: {t.number: DtcRecord() for t in DTCS}
    )
    _rates: dict[int, FaultRate] = field(
        default_factory=lambda: {
            ID_CONFLICT.number: FaultRate(1),
            **{dtc.number: FaultRate(FRAME_FAULTS) for dtc in OF_FRAMES},
        }
    )
    _used: int = 0
    _alive_at: float = float("-inf")

    def __iter__(self) -> Iterator[tuple[Dtc, DtcRecord]]:
        return ((dtc, self._records[dtc.number]) for dtc in DTCS)

    def find(self, number: int) -> DtcRecord | None:
        """Return the record of a code."""
        return self._records.get(number)

    def clear(self, number: int | None = None) -> None:
        """Clear one code, or all codes if number is None. A test that still fails sets its code
        again."""
        for key in self._records if number is None else (number,):
            self._records[key] = DtcRecord()
            if key in self._rates:
                self._rates[key].forget()

    def update(self, now: float, symptoms: Symptoms) -> None:
        """Run all tests. now: monotonic [s]."""
        for dtc, failed in self._results(now, symptoms):
            record = self._records[dtc.number]
            if failed:
                record.failed(now, dtc.confirm_after)
            elif failed is not None:
                record.passed()

    def _results(self, now: float, s: Symptoms) -> Iterator[tuple[Dtc, bool | None]]:
        yield NOT_CALIBRATED, not s.usable
        yield SENSOR_MOVED, True if s.moved else (False if s.usable else None)
        yield STATE_CORRUPT, s.state_corrupt
        for name, is_missing in s.missing.items():
            yield _MISSING[name], is_missing
        for name, found in s.faulty.items():
            for fault, dtc in FAULTY[name].items():
                yield dtc, fault in found
        faults, alive = s.counts.faults, self._is_alive(now, s.counts.used)
        for dtc, reasons in OF_FRAMES.items():
            total = sum(faults.get(reason, 0) for reason in reasons)
            yield dtc, self._rates[dtc.number].judge(now, total, alive)
        yield ID_CONFLICT, self._rates[ID_CONFLICT.number].judge(now, s.counts.conflicts, True)

    def _is_alive(self, now: float, used: int) -> bool:
        """True if good frames arrived within the last second."""
        if used != self._used:
            self._used, self._alive_at = used, now
        return now - self._alive_at < 1.0

    # over restarts ---------------------------------------------------------------------------

    def saved(self) -> dict[str, Any]:
        """Return the data to save for the next start, as plain data for JSON."""
        return {
            f"{number:06X}": [int(r.status), r.occurrences, r.aged]
            for number, r in self._records.items()
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Restore data that `saved` returned in an earlier run. Invalid data are ignored."""
        for number, record in self._records.items():
            try:
                found = convert(saved.get(f"{number:06X}"), tuple[_Status, _Byte, _Byte])
            except ValidationError:
                continue
            record.status = DtcStatus(found[0])
            record.occurrences, record.aged = found[1:]
            record.new_cycle()
