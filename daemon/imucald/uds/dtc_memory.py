"""The memory of DTCs, with the status bits of ISO 14229-1, and the tests that set DTCs.

An operation cycle is one run of the daemon.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from imucald.uds.dtc import (
    ACCELEROMETER_MISSING,
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
    Dtc,
)
from imucald.uds.host import Symptoms

WINDOW_S: Final = 10.0
"""Window for counting faults of frames [s]. The test is passed after this time without a fault."""
FAULTS: Final = 3
"""Number of faults in the window that fail the test. Bus noise causes only single faults."""
AGED_OUT: Final = 40
"""Number of consecutive cycles without a failure after which a confirmed code is removed."""
DUPLICATE_FAULTS: Final = ("duplicate_sender",)
CHECKSUM_FAULTS: Final = ("checksum",)
COUNTER_FAULTS: Final = (
    "counter_invalid",
    "counter_repeated",
    "counter_reversed",
    "counter_jump",
)


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
            CHECKSUM_FAILING.number: FaultRate(FAULTS),
            COUNTER_FAILING.number: FaultRate(FAULTS),
            ID_CONFLICT.number: FaultRate(1),
            DUPLICATE_SENDER.number: FaultRate(FAULTS),
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
        yield (
            CHECKSUM_FAILING,
            self._rate(CHECKSUM_FAILING, now, _sum(faults, CHECKSUM_FAULTS), alive),
        )
        yield COUNTER_FAILING, self._rate(COUNTER_FAILING, now, _sum(faults, COUNTER_FAULTS), alive)
        duplicates = _sum(faults, DUPLICATE_FAULTS)
        yield DUPLICATE_SENDER, self._rate(DUPLICATE_SENDER, now, duplicates, alive)
        yield ID_CONFLICT, self._rate(ID_CONFLICT, now, s.counts.conflicts, True)

    def _rate(self, dtc: Dtc, now: float, total: int, alive: bool) -> bool | None:
        return self._rates[dtc.number].judge(now, total, alive)

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
            kept = _kept(saved.get(f"{number:06X}"))
            if kept is not None:
                record.status = DtcStatus(kept[0])
                record.occurrences, record.aged = kept[1:]
                record.new_cycle()


def _sum(faults: Mapping[str, int], reasons: tuple[str, ...]) -> int:
    return sum(faults.get(reason, 0) for reason in reasons)


def _kept(found: object) -> tuple[int, int, int] | None:
    """Return status, occurrences and cycles without failure; None if the data are invalid."""
    if not isinstance(found, list) or len(found) != 3:
        return None
    status, occurrences, aged = found
    plain = all(type(number) is int and 0 <= number <= 255 for number in found)
    return (status, occurrences, aged) if plain and status <= AVAILABLE else None
