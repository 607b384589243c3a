"""Saved calibration: decide when it is saved, and which saved parts are used at a start.

A disk may take seconds to confirm a write. The main loop must not wait for the disk, so a thread
writes (`background_writer`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from imucald.core.errors import EstimateError
from imucald.mount.estimate import MountEstimator, MountState
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.joint.known import KnownSensor, known_from
from imucald.mount.mount_in_force import (
    doubt_of,
    known_sensor,
    mount_in_force,
    without_stored,
)
from imucald.mount.restored import RestoredEstimator, StoredMount
from imucald.runtime.summary import plain
from imucald.service.background_writer import Say, StateWriter
from imucald.service.journal import INFO, NOTICE, WARNING
from imucald.service.saved_state import SavedState, StateStore

SAVE_PERIOD_S = 10.0
"""Period between saves of a changing estimate [s]. A power cut loses at most the estimates of one
period."""
STOP_WAIT_S = 0.6
"""Longest wait for the disk when the daemon stops [s]. A stop may take one second in total."""

_OFFSETS = ("accel_bias", "gyro_bias", "yaw_rate_offset", "steering_offset", "speed_delay")
SENSOR = "sensor"
"""Key of the properties of the sensor itself in the evidence of a saved state."""
_EVIDENCE = (
    *("evidence_std_deg", "evidence_share", "launches_and_brakings", "left_turns"),
    *("right_turns", "stops", "distance", "manoeuvres"),
)

SENSOR_CHECK = "sensor_check"
"""Key of the sensor check's result in the saved offsets."""


class CalibrationStore:
    """Restores an estimator from the saved state, and saves its estimates.

    say: function that takes a log line and its priority. clock: monotonic [s].
    """

    def __init__(
        self,
        store: StateStore,
        say: Say,
        period: float = SAVE_PERIOD_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.store = store
        title = f"the state in {store.folder}"
        self.writer = StateWriter[tuple[int, SavedState | None]](self._write, title, say)
        self.problems: tuple[str, ...] = ()
        """Texts about parts of the saved state that were not valid at the start."""
        self.restored = False
        self.sensor_check: Callable[[], Mapping[str, Any] | None] = lambda: None
        """Function that returns the result of the sensor check to save with the mount, or None."""
        self._say = say
        self._period = period
        self._clock = clock
        self._last = SavedState((), (), "usable")
        self._known = False  # whether `_last` is a state
        self._last_put = -math.inf
        self._before = MountState.WAITING
        self._driven_before = 0.0
        self._is_forgetting = False  # a reset that the disk did not take at once

    def _write(self, content: tuple[int, SavedState | None]) -> None:
        """Save a state; content: era and state. If the state is None, force the renames of
        forgotten files to the disk instead."""
        era, state = content
        failure: OSError | None = None
        try:
            self.store.set_aside_forgotten()
        except OSError as error:
            failure = error  # a newer state still replaces it
        if state is None:
            self.store.sync()
        else:
            self.store.save(state, era)
        if failure is not None and not self.store.is_forgotten:
            raise failure  # so that it is tried again

    def restore(self, estimator: MountEstimator) -> MountEstimator:
        """Return an estimator that starts with the saved mount. Return `estimator` unchanged if no
        saved mount is used. A mount that the configuration holds takes precedence over the saved
        mount.
        """
        is_held = isinstance(estimator, RestoredEstimator) and estimator.is_held
        if is_held:
            self._say("the mount comes from the configuration and is held", NOTICE)
        loaded = self.store.load()
        self.problems = loaded.problems
        for problem in loaded.problems:
            self._say(f"saved state: {problem}", WARNING)
        saved = loaded.content
        if is_held:
            if saved is not None:  # its sensor check is still used
                self._last, self._known, self._driven_before = saved, True, saved.driven_s
            return estimator
        if saved is None:
            self._say(
                f"no saved state in {self.store.folder}; the calibration starts without a mount",
                INFO,
            )
            return estimator
        try:
            stored = stored_mount(saved, self._sensor(saved))
            restored = RestoredEstimator(without_stored(estimator), stored, saved.held)
        except Exception as error:  # whatever a file holds: without it the start goes on
            problem = f"it cannot be used ({type(error).__name__}: {error})"
            self.problems = (*self.problems, problem)
            self._say(f"saved state: {problem}", WARNING)
            return estimator
        self._last, self._known, self.restored = saved, True, True
        self._driven_before = saved.driven_s
        text = f"mount restored from generation {loaded.generation}"
        text += ", which was suspect when it was saved" if saved.doubted else ""
        text += f" ({saved.doubt})" if saved.doubted and saved.doubt else ""
        self._say(text + (", held: nothing is learnt" if saved.held else ""), NOTICE)
        return restored

    def _sensor(self, saved: SavedState) -> KnownSensor | None:
        """Return the saved properties of the sensor itself; None if they are missing or invalid.
        The saved mount can be used without them."""
        kept = saved.evidence.get(SENSOR)
        if kept is None:
            return None
        try:
            sensor = known_from(kept)
            sensor.correction(np.array(saved.rotation).reshape(3, 3))
            return sensor
        except EstimateError as error:
            self._say(f"saved state: {error}; the mount is used without it", WARNING)
            return None

    @property
    def saved_check(self) -> object:
        """The result of the sensor check in the restored state; None if there is no result."""
        return self._last.offsets.get(SENSOR_CHECK) if self._known else None

    @property
    def _is_check_new(self) -> bool:
        check = self.sensor_check()
        return check is not None and check != self.saved_check

    def update(self, estimator: MountEstimator, driven_s: float) -> None:
        """Save the present estimate if a save is due.

        driven_s: driving time since the start [s].
        """
        state, changed = estimator.state, estimator.state is not self._before
        if self._wanted(state, changed):
            self._save(estimator, self._driven_before + driven_s)
        self._before = state
        self.writer.report()
        if self._is_forgetting and self.store.is_forgotten:
            self._is_forgetting = False
            self._say("the saved state is removed now: the reset is final", NOTICE)

    def _wanted(self, state: MountState, changed: bool) -> bool:
        is_due = changed or self._clock() - self._last_put >= self._period
        if state in BAD:  # once; the earlier good mount is kept, as doubted
            return self._known and (changed or (is_due and self._is_check_new))
        if state is MountState.RESTORED:  # nothing new is known of the mount
            return is_due and self._is_check_new
        return is_due and state in GOOD

    def _save(self, estimator: MountEstimator, driven_s: float) -> None:
        self._last_put = self._clock()
        if estimator.state in BAD:
            if self._is_saved_as_doubted(estimator) and not self._is_check_new:
                return
            shift = {"at": round(time.time(), 1), "driven_s": round(driven_s, 1)}
            shifts = (*self._last.shifts, *(() if self._last.doubted else (shift,)))
            doubted = replace(
                self._last, doubted=True, doubt=doubt_of(estimator), shifts=shifts[-32:]
            )
            self._last = self._with_check(doubted)
        else:
            is_open = estimator.state is MountState.RESTORED  # as it was restored or stated
            if is_open and self._known:
                saved: SavedState | None = self._last
            else:
                stored = mount_in_force(estimator) if is_open else None
                saved = saved_state(estimator, driven_s, time.time(), self._last.shifts, stored)
            if saved is None:
                return
            saved = self._with_check(saved)
            if self._is_saved(saved):
                return
            self._last, self._known = saved, True
        self.writer.put((self.store.era, self._last))

    def _with_check(self, saved: SavedState) -> SavedState:
        check = self.sensor_check()
        if check is None:
            return saved
        return replace(saved, offsets={**saved.offsets, SENSOR_CHECK: check})

    def _is_saved_as_doubted(self, estimator: MountEstimator) -> bool:
        is_same = self._last.doubted and self._last.doubt == doubt_of(estimator)
        return is_same and not self.writer.last_error

    def _is_saved(self, state: SavedState) -> bool:
        """Return whether the state is equal to the saved state within 0.002 deg and 1 % of the
        variances. Equal states are not saved again, so that a standing vehicle does not wear out
        the memory.
        """
        if not self._known or self.writer.last_error:
            return False
        then = self._last
        same = (state.state, state.doubted, state.shifts) == (then.state, then.doubted, then.shifts)
        same = same and state.offsets.get(SENSOR_CHECK) == then.offsets.get(SENSOR_CHECK)
        moved = np.abs(np.subtract(state.rotation, then.rotation)).max()
        variance, before = (np.array(s.covariance)[::4] for s in (state, then))
        firmer = np.abs(variance / before - 1.0).max()
        return same and bool(moved < math.radians(0.002) and firmer < 0.01)

    def forget(self) -> str:
        """Forget the saved state: its files are renamed and not loaded again.

        The call does not wait for the disk. A file that is being written now is never renamed to
        its final name. The writing thread forces the renames to the disk. Returns the reason if the
        disk refuses the renames now, else an empty text. The thread tries again until the renames
        succeed or a newer state is saved.
        """
        self.writer.discard()
        self._known = False
        reason = ""
        try:
            self.store.forget()
        except OSError as error:
            reason = error.strerror or str(error)
            text = (
                f"the saved state could not be removed: {error}; imucald tries again until it "
                "succeeds; a restart before then would bring the old state back"
            )
            self._say(text, WARNING)
        self._is_forgetting = bool(reason)
        self.writer.put((self.store.era, None))
        return reason

    def save_order(self, estimator: MountEstimator, driven_s: float) -> str:
        """Save the present mount at once, in any state, because a person ordered the save. Returns
        the reason if the disk cannot be written now, else an empty text. A failed save is tried
        again.
        """
        stored = mount_in_force(estimator)
        state = None
        if stored is not None:
            driven_s += self._driven_before
            state = saved_state(estimator, driven_s, time.time(), self._last.shifts, stored)
        if state is not None:
            self._last, self._known = self._with_check(state), True
            self._last_put, self._before = self._clock(), estimator.state
            self.writer.put((self.store.era, self._last))
        return self.store.why_not_writable()

    def save_now(self, estimator: MountEstimator, driven_s: float) -> None:
        """Save the last estimate, and wait for the disk for at most `STOP_WAIT_S`."""
        if self._wanted(estimator.state, changed=True):
            self._save(estimator, self._driven_before + driven_s)
        self.writer.flush(STOP_WAIT_S)

    def end(self) -> None:
        """End saving. A write in progress is finished."""
        self.writer.close(0.0)
        self._report_not_forgotten()

    def close(self, estimator: MountEstimator, driven_s: float) -> None:
        """Save the last estimate and end saving. The wait for the disk is limited
        (`STOP_WAIT_S`)."""
        self.save_now(estimator, driven_s)
        if not self.writer.close(STOP_WAIT_S) and self.store.is_forgotten:
            self._say(
                "the disk did not write the state in time; the previous state is still saved",
                WARNING,
            )
        self._report_not_forgotten()
        self.writer.report()

    def _report_not_forgotten(self) -> None:
        """Log a warning at the end if a reset was not written to the disk."""
        if not self.store.is_forgotten:
            text = f"the state that was reset could not be removed from {self.store.folder}"
            self._say(f"{text}: the next start restores this state; reset again after it", WARNING)

    def status(self) -> dict[str, Any]:
        """Return the part of `imucald status` about saving."""
        return {
            "folder": str(self.store.folder),
            "generation": 0 if self.store.is_empty else self.store.generation,
            "restored_at_start": self.restored,
            **self.writer.status(),
            "to_be_forgotten": not self.store.is_forgotten,
            "problems": list(self.problems),
            "remounts": len(self._last.shifts) if self._known else 0,
        }


def stored_mount(saved: SavedState, sensor: KnownSensor | None = None) -> StoredMount:
    """Convert a saved state to the form that the estimator uses. sensor: saved properties of the
    sensor."""
    R = np.array(saved.rotation).reshape(3, 3)
    applied = None if sensor is None or saved.given else sensor.correction(R)
    return StoredMount(
        R,
        np.array(saved.covariance).reshape(3, 3),
        MountState[saved.state.upper()],
        saved.doubted,
        saved.given,
        saved.doubt,
        applied,
        None if sensor is None or applied is None else sensor.away().sent(),
        sensor,
    )


def saved_state(
    estimator: MountEstimator,
    driven_s: float,
    wall: float,
    shifts: Sequence[Mapping[str, Any]] = (),
    stored: StoredMount | None = None,
) -> SavedState | None:
    """Return the saved form of an estimator's estimate; None if it cannot be saved.

    stored: the mount to save instead of the estimated mount. A held mount is saved with its values
    at the beginning of the hold, so its uncertainty does not grow.
    """
    estimate, sensor = estimator.estimate(), known_sensor(estimator)
    in_front = estimator if isinstance(estimator, RestoredEstimator) else None
    is_held = in_front is not None and in_front.is_held
    stored = mount_in_force(estimator) if is_held else stored
    R, C, state = estimate.R_vehicle_from_sensor, estimate.covariance, estimate.state
    if stored is not None:
        R, C, state = stored.R_vehicle_from_sensor, stored.covariance, stored.state
    if R is None or C is None or not (np.isfinite(R).all() and np.isfinite(C).all()):
        return None
    details = estimate.details
    symmetric = 0.5 * (C + C.T)
    return SavedState(
        rotation=tuple(R.ravel().tolist()),
        covariance=tuple(symmetric.ravel().tolist()),
        state=state.name.lower(),
        doubted=stored is not None and stored.doubted,
        doubt=stored.doubt if stored is not None and stored.doubted else "",
        held=is_held,
        given=in_front is not None and in_front.serves_stored and in_front.stored.is_given,
        saved_at=round(wall, 1),
        driven_s=round(driven_s, 1),
        offsets={k: plain(details[k], None) for k in _OFFSETS if k in details},
        shifts=tuple(shifts),
        evidence={
            **{k: plain(details[k], None) for k in _EVIDENCE if k in details},
            **({} if sensor is None else {SENSOR: sensor.plain()}),
        },
    )
