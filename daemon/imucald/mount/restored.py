"""Warm start: the mount of an earlier drive is used until this drive's own estimate replaces it.

The warm start wraps any estimator. The stored rotation is usable at once, with the state
*restored*. The estimator inside restarts, so its results are new evidence. If the new estimate
agrees with the stored rotation, the stored rotation is confirmed. A confirmed rotation stays in use
until the new estimate is equally certain. If the new estimate contradicts the stored rotation, the
stored rotation becomes *suspect*. Once the new estimate is usable, the applied rotation changes
slowly to the new estimate.

The knowledge of the sensor itself from an earlier drive is prior information of the new evidence
(`joint.known`), so the errors of a known sensor are found again soon.

A *held* mount stays: the drive may confirm or contradict it, but does not change it.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3, vector_from_rotation
from imucald.motion.ticks import TICK_S, TickRow
from imucald.mount.estimate import (
    ANGLES,
    BETWEEN_DRIVES_STD,
    Correction,
    JudgesSignals,
    Missing,
    MountEstimate,
    MountEstimator,
    MountState,
    SentDeviations,
)
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.joint.known import KnownSensor
from imucald.mount.mount_words import contradicted_words
from imucald.mount.off_vertical_limit import PlumbLine
from imucald.mount.slewing import SlewedCorrection

COMPARE_TICKS = 10
"""Number of ticks between two comparisons of the stored mount with the new estimate: one second."""
AGREEMENT = 11.3
"""Chi-square with 3 degrees of freedom (99 %) below which the two mounts agree."""
CONTRADICTION = 16.3
"""Chi-square with 3 degrees of freedom (99.9 %) above which the two mounts contradict each
other."""
DOUBTS = 8
"""Number of contradictions in a row that makes the stored mount suspect. This number of
contradictions takes 8 s, so the contradictions come from at least two solutions.
"""
CONTRADICTIONS = 15
"""Number of contradictions in a row after which the stored mount is dropped. A single bad road
gives fewer contradictions."""
HAND_OVER_RATE = math.radians(1.0)
"""Rate at which the applied correction moves to the new estimate [rad/s]."""
CLEAR_STD = math.radians(20.0)
"""Largest deviation of an angle [rad] at which the angle can show an error of a stated mount."""


class StoredMount(Struct, frozen=True):
    """Result of an earlier drive.

    R_vehicle_from_sensor: (3, 3). covariance: (3, 3) [rad^2], as in `MountEstimate`. state: state
    of the mount in the earlier drive, USABLE or FINE. doubted: the mount was suspect when it was
    stored. is_given: a person stated the mount. doubt: reason in words why the mount was suspect;
    "" if not known. applied: correction that was applied with the mount; None: the rotation alone.
    sent: deviations of the errors that remained in the corrected samples. sensor: knowledge about
    the sensor itself; None if the estimator does not determine it.
    """

    R_vehicle_from_sensor: Matrix3
    covariance: NDArray[np.float64]
    state: MountState = MountState.USABLE
    doubted: bool = False
    is_given: bool = False
    doubt: str = ""
    applied: Correction | None = None
    sent: SentDeviations | None = None
    sensor: KnownSensor | None = None

    @property
    def correction(self) -> Correction:
        """Correction to apply."""
        return self.applied or Correction.turning(self.R_vehicle_from_sensor)


@runtime_checkable
class KnowsSensor(Protocol):
    """Interface of an estimator that finds errors of the sensor itself."""

    def take_stated_mount(self, R: Matrix3) -> None:
        """Use the mount R_vehicle_from_sensor (3, 3) that a person states."""
        ...

    def known_sensor(self) -> KnownSensor | None:
        """Return the knowledge about the sensor itself, which does not depend on the mount."""
        ...

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3 degrees of freedom) between this mount and the mount of the earlier drive;
        None if there is no comparison."""
        ...

    def leave_mount(self) -> None:
        """Discard the mount of the earlier drive because the sensor was moved since, and keep the
        knowledge of the sensor itself."""
        ...

    def take_known_sensor(self, known: KnownSensor, is_moved: bool) -> None:
        """Begin with the knowledge of the sensor from an earlier drive.

        is_moved: the sensor was moved since the earlier drive.
        """
        ...


class Contradicted(Struct, frozen=True):
    """Time at which the drive first showed that the stored mount is wrong.

    t: number of ticks so far, in seconds. turned: rotation between the drive's own mount and the
    stored mount [rad]. None: the drive has no mount yet, and gravity is far from the vertical.
    """

    t: float
    turned: float | None


class Phase(enum.StrEnum):
    """Which mount is in use: the stored mount, or the new estimate, and why."""

    RESTORED = "restored"  # the stored mount; no evidence against or for it
    CONFIRMED = "confirmed"  # the stored mount; new evidence agrees
    DOUBTED = "doubted"  # the stored mount; new evidence contradicts
    HANDING_OVER = "handing_over"  # on the way to the new estimate
    NEW = "new"  # the new estimate


class RestoredEstimator:
    """An estimator that applies the mount of an earlier drive in place of its inner estimator's
    mount.

    is_held: the earlier mount is not replaced. phase: CONFIRMED if the drive has already confirmed
    the mount, otherwise RESTORED. by_configuration: the mount is held by the configuration and not
    by an order.
    """

    def __init__(
        self,
        inner: MountEstimator,
        stored: StoredMount,
        is_held: bool = False,
        phase: Phase = Phase.RESTORED,
        by_configuration: bool = False,
    ) -> None:
        self.inner = inner
        self._judges = inner if isinstance(inner, JudgesSignals) else None
        self.stored = stored
        self.is_held = is_held
        self.by_configuration = by_configuration
        self.phase = Phase.DOUBTED if stored.doubted else phase
        self.distance = math.nan
        """Result of the last comparison, as a chi-square with 3 degrees of freedom."""
        self._turned: float | None = None  # of the drive's own mount against it, contradicted [rad]
        self._contradicted: Contradicted | None = None
        if stored.is_given and isinstance(inner, KnowsSensor):
            inner.take_stated_mount(stored.R_vehicle_from_sensor)
        if stored.sensor is not None and isinstance(inner, KnowsSensor):
            inner.take_known_sensor(stored.sensor, stored.doubted)
        self._prior = stored.covariance + np.diag(np.square(BETWEEN_DRIVES_STD))
        self._served = SlewedCorrection(HAND_OVER_RATE)
        self._served.aim(stored.correction)
        self._plumb_line = PlumbLine()
        self._contradictions = 0
        self._ticks = 0

    @property
    def serves_stored(self) -> bool:
        """True if the stored mount is in use. False during the transition to this drive's own mount
        and after it."""
        return self.phase not in (Phase.HANDING_OVER, Phase.NEW)

    @property
    def correction(self) -> Correction | None:
        """Correction to apply now."""
        return self.inner.correction if self.phase is Phase.NEW else self._served.correction

    @property
    def state(self) -> MountState:
        """RESTORED until the new evidence decides, then the state that follows from this
        evidence."""
        if self.phase is Phase.NEW:
            return MountState.SUSPECT if self._is_contradicted_inside else self.inner.state
        if self.phase is Phase.RESTORED:
            return MountState.RESTORED
        if self.phase is Phase.DOUBTED:
            return MountState.SUSPECT
        if self.phase is Phase.HANDING_OVER:
            return MountState.SUSPECT if self._contradictions else self.inner.state
        known = (self.stored.state, *(() if self.is_held else (self.inner.state,)))
        return MountState.FINE if MountState.FINE in known else MountState.USABLE

    @property
    def stuck_signals(self) -> Mapping[str, bool]:
        """Stuck signals of the vehicle from the inner estimator; empty if the inner estimator does
        not look for stuck signals.
        """
        return {} if self._judges is None else self._judges.stuck_signals

    def step(self, tick: TickRow) -> None:
        """Process one tick."""
        self.inner.step(tick)
        if self.phase is Phase.HANDING_OVER:
            self._follow()
            return
        if self.phase is not Phase.NEW:
            self._plumb_line.take_tick(tick, self._served.correction)
            if self._plumb_line.is_off:
                self.phase = Phase.DOUBTED
        self._ticks += 1
        if self._ticks % COMPARE_TICKS == 0:
            self._compare()
            self._remember_contradiction()

    def gap(self) -> None:
        """Note a jump of time: no difference is taken between values before the jump and values
        after it."""
        self.inner.gap()

    def estimate(self) -> MountEstimate:
        """Return the present estimate."""
        new = self.inner.estimate()
        if self.state is MountState.FINE:  # the drive's own estimate may wait for something still
            new = replace(new, waiting_for={}, missing={})
        if self.is_held or self.state in (MountState.FINE, MountState.SUSPECT):
            new = replace(new, progress=None)
        details = {**new.details, "restored": self._details()}
        if not self.serves_stored:
            return replace(new, state=self.state, details=details)
        served = replace(
            new,
            state=self.state,
            R_vehicle_from_sensor=self.stored.R_vehicle_from_sensor,
            covariance=self._prior,
            details=details,
            matrices=self.stored.applied,
            deviations=self.stored.sent,
        )
        if self.is_held and self.phase is Phase.CONFIRMED:
            return _waiting_for_release(served, self.by_configuration)
        if self._is_statement_wrong and not new.faults:
            return self._against_statement(served)
        return served

    @property
    def _is_statement_wrong(self) -> bool:
        return self._is_shown_wrong and self.phase is Phase.DOUBTED and self.stored.is_given

    @property
    def _is_shown_wrong(self) -> bool:
        """True if this drive shows that the stored mount is wrong, by the drive's own mount or by
        gravity.
        """
        return self._turned is not None or self._plumb_line.is_off

    def _against_statement(self, served: MountEstimate) -> MountEstimate:
        """Return the estimate with its contradiction to the mount that a person stated, in
        words."""
        turned = None if self._turned is None else math.degrees(self._turned)
        words = dict.fromkeys(ANGLES, contradicted_words(turned))
        return replace(served, waiting_for=words, missing=dict.fromkeys(ANGLES, Missing.OTHER))

    def known_sensor(self) -> KnownSensor | None:
        """Return the knowledge about the sensor itself, from this drive or from the stored
        mount."""
        if self.is_held or self.phase in (Phase.RESTORED, Phase.DOUBTED):
            return self.stored.sensor
        return self.inner.known_sensor() if isinstance(self.inner, KnowsSensor) else None

    def _details(self) -> dict[str, object]:
        turned = None if self._turned is None else math.degrees(self._turned)
        return {
            "phase": str(self.phase),
            "turned_deg": turned,
            "chi_square": self.distance,
            "held": self.is_held,
            "given": self.stored.is_given,
            "doubt": self.stored.doubt,
            "contradicted": None
            if (found := self._contradicted) is None
            else {
                "t": found.t,
                "turned_deg": None if found.turned is None else math.degrees(found.turned),
            },
        }

    def _remember_contradiction(self) -> None:
        """Remember that the stored mount was wrong, even after this drive's own mount is used."""
        if self.phase is Phase.CONFIRMED:
            self._contradicted = None
        if not self._is_shown_wrong or self.phase not in (Phase.DOUBTED, Phase.HANDING_OVER):
            return
        if not self.inner.estimate().faults:
            since = self._contradicted or Contradicted(self._ticks * TICK_S, None)
            turned = since.turned if self._turned is None else self._turned
            self._contradicted = Contradicted(since.t, turned)

    @property
    def _is_contradicted_inside(self) -> bool:
        """True if the drive's own mount still uses the stored mount as a prior, although the stored
        mount is contradicted."""
        return self._contradictions >= DOUBTS and self._contradiction is not None

    def _compare(self) -> None:
        """Compare the new evidence with the stored mount, and decide which mount is used."""
        distance = self._distance()
        if distance is None:
            return
        self.distance = distance
        if distance > CONTRADICTION:
            self._contradictions += 1
        elif distance < AGREEMENT:
            self._contradictions = 0
        if self._contradictions == CONTRADICTIONS and isinstance(self.inner, KnowsSensor):
            self.inner.leave_mount()
        if self.phase is not Phase.NEW:
            self._judge()

    def _distance(self) -> float | None:
        """Return the chi-square between the new estimate and the stored mount, or None."""
        if self.phase is Phase.NEW:
            return self._contradiction
        new = self.inner.estimate()
        if new.R_vehicle_from_sensor is None or new.covariance is None:
            return None
        e = vector_from_rotation(new.R_vehicle_from_sensor @ self.stored.R_vehicle_from_sensor.T)
        distance = float(e @ np.linalg.solve(new.covariance + self._prior, e))
        distance = max(distance, self._contradiction or 0.0)
        e[np.diag(new.covariance) > CLEAR_STD**2] = 0.0
        self._turned = math.sqrt(float(e @ e)) if distance > CONTRADICTION else None
        return distance

    @property
    def _contradiction(self) -> float | None:
        """Chi-square (3 degrees of freedom) from an estimator that knows the sensor.

        The new and the stored rotation depend on the same knowledge of the sensor, so they seem
        closer to each other than they are. The inner estimator takes this common part into account.
        """
        return self.inner.contradiction if isinstance(self.inner, KnowsSensor) else None

    def _judge(self) -> None:
        """Decide which mount is used from now on."""
        usable = self.inner.state in GOOD
        if self._plumb_line.is_off and not usable:
            return
        if usable and self.distance < AGREEMENT and not self._plumb_line.is_off:
            self.phase = Phase.CONFIRMED
        if self.inner.state in BAD or self._contradictions >= DOUBTS:
            self.phase = Phase.DOUBTED
        if not usable or self.is_held:
            return
        covariance = self.inner.estimate().covariance
        certain = covariance is not None and np.trace(covariance) <= np.trace(self._prior)
        over = self._contradictions >= CONTRADICTIONS
        if over or (self.phase is Phase.CONFIRMED and certain):
            self.phase = Phase.HANDING_OVER

    def _follow(self) -> None:
        """Move the applied correction towards the new estimate until both are equal."""
        target = self.inner.correction
        if target is None:  # the new estimate is not reliable after all
            self.phase = Phase.DOUBTED
            return
        self._served.aim(target)
        self._served.move_on()
        if self._served.correction == target:
            self.phase, self._turned = Phase.NEW, None


def _waiting_for_release(served: MountEstimate, by_configuration: bool) -> MountEstimate:
    """Return the estimate with the condition that a held mount needs to become *fine*: the end of
    the hold."""
    if served.state is MountState.FINE:
        return served
    by = "in the configuration ('calibration: mount: hold: true')"
    words = f"the end of the hold {by if by_configuration else '(imucald release)'}"
    return replace(
        served,
        waiting_for=dict.fromkeys(ANGLES, words),
        missing=dict.fromkeys(ANGLES, Missing.LEARNING_FROZEN),
    )
