"""Routine control (service 0x31): calibrate again, reset, check the sensors again.

All routines change the daemon's output, so they need an unlocked server and a standing vehicle.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from typing import Final

from imucald.uds.codes import Answer, Nrc
from imucald.uds.host import Host
from imucald.uds.identifiers import IDENTIFIERS

START: Final = 0x01
STOP: Final = 0x02
RESULTS: Final = 0x03

CALIBRATE: Final = 0xF010
"""Start a new supervised calibration. Stopping it restores the former calibration."""
RESET: Final = 0xF011
"""Delete the calibration and the saved state. The reset acts at once and cannot be undone.

The routine runs until the deletion is stored on disk. Until then, a restart would restore the saved
state.
"""

CHECK_SENSORS: Final = 0xF012
"""Repeat the sensor check of the attitude. The vehicle must stand until it is complete."""

GOOD_QUALITIES: Final = (2, 3)
"""Qualities *usable* and *fine*: the calibration is complete. Quality 1 is a restored calibration
that is not confirmed yet. Quality 4 is suspect: the drive contradicts the calibration, so a new
calibration is necessary."""
RESULT_IDENTIFIERS: Final = (0xFD03, 0xFD04, 0xFD05, 0xFD00, 0xFD01)
"""Identifiers at the end of results: state, quality, waiting reasons, angles, deviations."""


class RoutineStatus(enum.IntEnum):
    """The status of a routine. The number is part of its results."""

    RUNNING = 1
    COMPLETED = 2
    STOPPED = 3


class Routines:
    """Service 0x31. unlocked: returns whether security access was granted."""

    def __init__(self, host: Host, unlocked: Callable[[], bool]) -> None:
        self._host = host
        self._unlocked = unlocked
        self._status: dict[int, RoutineStatus] = {}
        self._begin: dict[int, Callable[[], RoutineStatus | None]] = {
            CALIBRATE: self._calibrate,
            RESET: self._reset,
            CHECK_SENSORS: self._check_sensors,
        }

    def poll(self) -> None:
        """Check whether the calibration is complete. The method is also called before each
        request."""
        if self._runs(CALIBRATE) and self._host.quality in GOOD_QUALITIES:
            self._status[CALIBRATE] = RoutineStatus.COMPLETED
            self._host.accept_calibration()
        if self._runs(RESET) and self._host.is_forgotten:
            self._status[RESET] = RoutineStatus.COMPLETED
        if self._runs(CHECK_SENSORS) and self._host.sensors_checked:
            self._status[CHECK_SENSORS] = RoutineStatus.COMPLETED

    def answer(self, data: bytes) -> Answer:
        """Answer a request; data: sub-function, routine, options."""
        sub, routine = data[0], int.from_bytes(data[1:3], "big")
        if routine not in self._begin:
            return Nrc.OUT_OF_RANGE
        if sub != RESULTS and not self._unlocked():
            return Nrc.SECURITY_ACCESS_DENIED
        if len(data) != 3:
            return Nrc.INCORRECT_LENGTH
        if sub == RESULTS:
            return self._results(routine)
        return self._start(routine) if sub == START else self._stop(routine)

    def _start(self, routine: int) -> Answer:
        if self._runs(routine) and routine != RESET:  # delete what was learnt since then, too
            return Nrc.REQUEST_SEQUENCE_ERROR
        if not self._host.standing:
            return Nrc.CONDITIONS_NOT_CORRECT
        status = self._begin[routine]()
        if status is None:
            return Nrc.CONDITIONS_NOT_CORRECT
        self._status[routine] = status
        return self._echo(START, routine)

    def _stop(self, routine: int) -> Answer:
        if not self._runs(routine):
            return Nrc.REQUEST_SEQUENCE_ERROR
        if routine != CALIBRATE or not self._host.standing or not self._host.return_to_former():
            return Nrc.CONDITIONS_NOT_CORRECT
        self._status[routine] = RoutineStatus.STOPPED
        return self._echo(STOP, routine)

    def _results(self, routine: int) -> Answer:
        if routine not in self._status:
            return Nrc.REQUEST_SEQUENCE_ERROR
        parts = [IDENTIFIERS[number].read(self._host) or b"" for number in RESULT_IDENTIFIERS]
        return self._echo(RESULTS, routine) + b"".join(parts)

    def _calibrate(self) -> RoutineStatus:
        self._host.begin_calibration()
        return RoutineStatus.RUNNING

    def _check_sensors(self) -> RoutineStatus | None:
        return RoutineStatus.RUNNING if self._host.check_sensors() else None

    def _reset(self) -> RoutineStatus:
        if self._runs(CALIBRATE):
            self._status[CALIBRATE] = RoutineStatus.STOPPED
        self._host.forget()
        return RoutineStatus.COMPLETED if self._host.is_forgotten else RoutineStatus.RUNNING

    def _runs(self, routine: int) -> bool:
        return self._status.get(routine) is RoutineStatus.RUNNING

    def _echo(self, sub: int, routine: int) -> bytes:
        return struct.pack(">BHB", sub, routine, self._status[routine])
