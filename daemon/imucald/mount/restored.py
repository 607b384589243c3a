"""Warm start: the mount of an earlier drive serves until this drive's own estimate takes over.

It wraps any estimator. The stored rotation is usable at once, as *restored*. The estimator inside
begins anew, so that what it says is new evidence: where that agrees, the stored one is confirmed
and goes on until the new one is as certain. Where it contradicts, the stored one is *suspect*
until the new one can be used, and then gives way to it, slowly.

The evidence that was stored with it joins the new only when the new agrees by itself; then it is
as certain as before at once. Both are held against one another for as long as this goes on: a
sensor moved by so little that the first agreement could not show it is found out when the new
evidence is certain enough, and the stored evidence is left again.

A mount that is *held* never gives way: the drive may confirm or doubt it, and changes nothing.
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
from imucald.mount.saved_information import SavedInformation, SavesInformation
from imucald.mount.slewing import SlewedCorrection

COMPARE_TICKS = 10
"""The two are compared so often: once a second."""
AGREEMENT = 11.3
"""Chi-square with 3 degrees of freedom, 99 %: less is agreement."""
CONTRADICTION = 16.3
"""The same for 99.9 %: more is contradiction."""
DOUBTS = 8
"""So many contradictions in a row, 8 s and thus of two fits, make the stored mount suspect ..."""
CONTRADICTIONS = 15
"""... and so many end it: one bad road is no remount."""
HAND_OVER_RATE = math.radians(1.0)
"""What is applied goes to the new estimate at this rate [rad/s]."""
CLEAR_STD = math.radians(20.0)
"""An angle that is known worse says nothing of how far a stated mount is off [rad]."""
HELD = "the end of the hold (imucald release)"
HELD_BY_CONFIGURATION = (
    "the end of the hold by the configuration ('calibration: mount: hold: true')"
)
"""What a held mount waits for."""

NONE_JUDGED: Mapping[str, bool] = {}


class StoredMount(Struct, frozen=True):
    """What an earlier drive found.

    R_vehicle_from_sensor: (3, 3). covariance: (3, 3) [rad^2], as in `MountEstimate`.
    state: the state it had, USABLE or FINE. doubted: it was suspect when it was stored.
    evidence: what it rests on, where the estimator keeps that. is_given: a person stated it.
    doubt: why it was suspect, in words, where that is known. applied: what was applied with it,
    where that is more than the rotation; sent: deviations of what that left in the samples.
    sensor: what is known of the sensor by itself, where the estimator finds that.
    """

    R_vehicle_from_sensor: Matrix3
    covariance: NDArray[np.float64]
    state: MountState = MountState.USABLE
    doubted: bool = False
    evidence: SavedInformation | None = None
    is_given: bool = False
    doubt: str = ""
    applied: Correction | None = None
    sent: SentDeviations | None = None
    sensor: KnownSensor | None = None

    @property
    def correction(self) -> Correction:
        """What is to be applied."""
        return self.applied or Correction.turning(self.R_vehicle_from_sensor)


@runtime_checkable
class TakesStatedMount(Protocol):
    """An estimator to which it matters what a person says of the mount."""

    def take_stated_mount(self, R: Matrix3) -> None:
        """A person states R_vehicle_from_sensor."""
        ...


@runtime_checkable
class KnowsSensor(Protocol):
    """An estimator that finds errors of the sensor's own."""

    def known_sensor(self) -> KnownSensor | None:
        """What is known of the sensor by itself."""
        ...

    def as_before(self) -> float | None:
        """Probability that sensor and mount are those that it took; None: it took none yet."""
        ...

    def take_known_sensor(self, known: KnownSensor, is_moved: bool) -> None:
        """Begin with what an earlier drive found of it; is_moved: it was moved since."""
        ...


class Contradicted(Struct, frozen=True):
    """When the drive first showed that the mount in front is wrong.

    t: ticks so far as seconds. turned: how far its own mount is turned against it [rad]; None: it
    has none yet, and gravity is far off the vertical.
    """

    t: float
    turned: float | None


class Phase(enum.StrEnum):
    """Who serves, and why."""

    RESTORED = "restored"  # the stored mount; nothing known against or for it
    CONFIRMED = "confirmed"  # the stored mount; new evidence agrees
    DOUBTED = "doubted"  # the stored mount; new evidence contradicts
    HANDING_OVER = "handing_over"  # on the way to the new estimate
    NEW = "new"  # the new estimate


class RestoredEstimator:
    """An estimator with the mount of an earlier drive in front; a `MountEstimator` itself.

    is_held: that mount stays, whatever the drive says. phase: how far the drive has confirmed it
    already, CONFIRMED or RESTORED; without it nothing has. held_until: what ends the hold, in
    words.
    """

    def __init__(
        self,
        inner: MountEstimator,
        stored: StoredMount,
        is_held: bool = False,
        phase: Phase = Phase.RESTORED,
        held_until: str = HELD,
    ) -> None:
        self.inner = inner
        self._judges = inner if isinstance(inner, JudgesSignals) else None
        self.stored = stored
        self.is_held = is_held
        self.held_until = held_until
        self.phase = Phase.DOUBTED if stored.doubted else phase
        self.distance = math.nan
        """Of the last comparison, as a chi-square with 3 degrees of freedom."""
        self._turned: float | None = None  # of the drive's own mount against it, contradicted [rad]
        self._contradicted: Contradicted | None = None
        self.joined = False
        """Whether the stored evidence goes along with the new."""
        self._has_left = False
        if stored.is_given and isinstance(inner, TakesStatedMount):
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
        """Whether the stored mount is served, and not this drive's own on its way or there."""
        return self.phase not in (Phase.HANDING_OVER, Phase.NEW)

    @property
    def correction(self) -> Correction | None:
        """What to apply now."""
        return self.inner.correction if self.phase is Phase.NEW else self._served.correction

    @property
    def state(self) -> MountState:
        """RESTORED until the new evidence decides, then the state that it gives."""
        if self.phase is Phase.NEW:
            return MountState.SUSPECT if self._doubtful() else self.inner.state
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
        """The vehicle's stuck signals by the inner estimator; none where it does not look."""
        return NONE_JUDGED if self._judges is None else self._judges.stuck_signals

    def step(self, tick: TickRow) -> None:
        """Take one tick."""
        self.inner.step(tick)
        if self.phase is Phase.HANDING_OVER:
            self._follow()
            return
        if self.phase is not Phase.NEW:
            self._plumb_line.step(tick, self._served.correction)
            if self._plumb_line.is_off:
                self.phase = Phase.DOUBTED
        self._ticks += 1
        if self._ticks % COMPARE_TICKS == 0 and (self.joined or self.phase is not Phase.NEW):
            self._compare()
            self._remember_contradiction()

    def gap(self) -> None:
        """Time jumped: nothing before this may be differenced with what follows."""
        self.inner.gap()

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge."""
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
            return _waiting_for_release(served, self.held_until)
        if self._is_statement_wrong and not new.faults:
            return self._against_statement(served)
        return served

    @property
    def _is_statement_wrong(self) -> bool:
        return self._is_shown_wrong and self.phase is Phase.DOUBTED and self.stored.is_given

    @property
    def _is_shown_wrong(self) -> bool:
        """Whether this drive shows it of the mount in front; that it doubts its own mount as well
        shows nothing."""
        return self._turned is not None or self._plumb_line.is_off

    def _against_statement(self, served: MountEstimate) -> MountEstimate:
        """What speaks against the mount that a person stated, in words."""
        turned = None if self._turned is None else math.degrees(self._turned)
        words = dict.fromkeys(ANGLES, contradicted_words(turned))
        return replace(served, waiting_for=words, missing=dict.fromkeys(ANGLES, Missing.OTHER))

    def saved_information(self) -> SavedInformation | None:
        """What the estimate that is served rests on."""
        if self.joined or not self.serves_stored:
            return (
                self.inner.saved_information() if isinstance(self.inner, SavesInformation) else None
            )
        return self.stored.evidence

    def known_sensor(self) -> KnownSensor | None:
        """What is known of the sensor by itself."""
        if self.is_held or self.phase in (Phase.RESTORED, Phase.DOUBTED):
            return self.stored.sensor
        return self.inner.known_sensor() if isinstance(self.inner, KnowsSensor) else None

    def _details(self) -> dict[str, object]:
        turned = None if self._turned is None else math.degrees(self._turned)
        return {
            "phase": str(self.phase),
            "turned_deg": turned,
            "chi_square": self.distance,
            "evidence_joined": self.joined,
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
        """Keep that the mount in front was wrong, also once this drive's own serves."""
        if self.phase is Phase.CONFIRMED:
            self._contradicted = None
        if not self._is_shown_wrong or self.phase not in (Phase.DOUBTED, Phase.HANDING_OVER):
            return
        if not self.inner.estimate().faults:
            since = self._contradicted or Contradicted(self._ticks * TICK_S, None)
            turned = since.turned if self._turned is None else self._turned
            self._contradicted = Contradicted(since.t, turned)

    def _doubtful(self) -> bool:
        return self.joined and self._contradictions >= DOUBTS

    def _compare(self) -> None:
        """Hold the new evidence against the stored."""
        distance = self._joined_distance() if self.joined else self._distance()
        if distance is None:
            return
        self.distance = distance
        if distance > CONTRADICTION:
            self._contradictions += 1
        elif distance < AGREEMENT:
            self._contradictions = 0
        if self.joined and self._contradictions >= CONTRADICTIONS:
            self._leave()
        if self.phase is not Phase.NEW:
            self._judge()

    def _distance(self) -> float | None:
        """Chi-square of the new estimate against the stored one."""
        new = self.inner.estimate()
        if new.R_vehicle_from_sensor is None or new.covariance is None:
            return None
        e = vector_from_rotation(new.R_vehicle_from_sensor @ self.stored.R_vehicle_from_sensor.T)
        distance = float(e @ np.linalg.solve(new.covariance + self._prior, e))
        distance = max(distance, self._distance_of_sensor())
        e[np.diag(new.covariance) > CLEAR_STD**2] = 0.0
        self._turned = math.sqrt(float(e @ e)) if distance > CONTRADICTION else None
        return distance

    def _distance_of_sensor(self) -> float:
        """What an estimator that knows the sensor makes of all that it took, as a chi-square.

        Both rotations rest on what is known of the sensor, so that they seem less apart than they
        are; it knows what they share.
        """
        before = self.inner.as_before() if isinstance(self.inner, KnowsSensor) else None
        if before is None:
            return 0.0
        decades = -math.log10(max(before, 1e-12)) - 2.0  # beyond 1 %, the level of AGREEMENT
        return max(AGREEMENT + decades * (CONTRADICTION - AGREEMENT), 0.0)

    def _joined_distance(self) -> float | None:
        """The same of the evidence on both sides, which the estimator keeps apart."""
        found = self.inner.contradiction if isinstance(self.inner, SavesInformation) else None
        if found is None:  # it has left the stored evidence by itself: the sensor was moved
            self.joined, self._has_left = False, True
        return found

    def _judge(self) -> None:
        """Who serves from now on."""
        usable = self.inner.state in GOOD
        if self._plumb_line.is_off and not usable:
            return
        if usable and self.distance < AGREEMENT and not self._plumb_line.is_off:
            self.phase = Phase.CONFIRMED
            self._join()
        if self.inner.state in BAD or self._contradictions >= DOUBTS:
            self.phase = Phase.DOUBTED
        if not usable or self.is_held:
            return
        covariance = self.inner.estimate().covariance
        certain = covariance is not None and np.trace(covariance) <= np.trace(self._prior)
        over = self._contradictions >= CONTRADICTIONS
        if over or (self.phase is Phase.CONFIRMED and certain):
            self.phase = Phase.HANDING_OVER

    def _join(self) -> None:
        """The new evidence agrees by itself: go on with both; never with what it has left."""
        kept = None if self._has_left or self.is_held else self.stored.evidence
        if kept is not None and not self.joined and isinstance(self.inner, SavesInformation):
            self.inner.join_information(kept)
            self.joined = self.inner.contradiction is not None

    def _leave(self) -> None:
        """They contradict one another after all: the new evidence stays."""
        if isinstance(self.inner, SavesInformation):
            self.inner.drop_information()
        self.joined, self._has_left = False, True

    def _follow(self) -> None:
        """Turn towards the new estimate until it is reached."""
        target = self.inner.correction
        if target is None:  # it was not to be relied upon after all
            self.phase = Phase.DOUBTED
            return
        self._served.aim(target)
        self._served.step()
        if self._served.correction == target:
            self.phase, self._turned = Phase.NEW, None


def _waiting_for_release(served: MountEstimate, held_until: str) -> MountEstimate:
    """What a held mount waits for to be *fine*: nothing but that learning goes on."""
    if served.state is MountState.FINE:
        return served
    return replace(
        served,
        waiting_for=dict.fromkeys(ANGLES, held_until),
        missing=dict.fromkeys(ANGLES, Missing.LEARNING_FROZEN),
    )
