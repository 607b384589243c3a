"""Explanation of an estimate: missing evidence of each angle, progress, and details.

The reported reason of an angle is a problem that driving does not solve. If there is no such
problem, the reason is too little driving. If the deviation of the angle is small enough, the reason
is an open test. The information about an angle, 1 / variance, grows at a nearly constant rate with
driving. A limit on the deviation is also a limit on the information. The ratio (limit /
deviation)^2 is therefore the collected share of the needed information, and it grows at a nearly
constant rate. The recent growth of this share predicts the remaining time. The log ratios of the
sign tests also grow at a nearly constant rate.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.drive import windows as wd
from imucald.motion.ticks import TICK_S
from imucald.mount.carried_force import CarriedForce
from imucald.mount.contradictions import WORDS, StandingFault
from imucald.mount.creep import BELIEVED, Creep
from imucald.mount.estimate import ANGLES, Gate, Missing, MountState, Progress
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.joint.response import SEGMENTS
from imucald.mount.mount_changes import GoodMount, MountChanges, TakenChange
from imucald.mount.mount_words import SD_95, VEHICLE_AXES
from imucald.mount.signal_blocks import BLOCK_S, SignalBlockMaker
from imucald.mount.signal_checks import Acceptance, SignalChecks
from imucald.mount.states import NEEDED, MountKnowledge, waiting_for


def waiting_reasons(
    known: MountKnowledge,
    state: MountState,
    settings: EstimatorSettings,
    acceptance: Acceptance,
    troubles: Mapping[str, str],
) -> tuple[dict[str, str], dict[str, Missing]]:
    """Return one reason per angle in words, and one as a code. An angle without missing evidence
    has no entry.

    known: knowledge from the evidence. state: reported state. troubles: problems that more driving
    does not solve, see `mount_troubles`. A problem in `troubles` has priority over any other
    reason.
    """
    if state is MountState.FINE:
        return {}, {}
    reasons = waiting_for(known, settings, state)
    words = {name: text for name, (text, _) in reasons.items()}
    codes = {name: code for name, (_, code) in reasons.items()}
    for angle, text in troubles.items():
        words[angle], codes[angle] = text, Missing.OTHER
    is_withheld = state is MountState.LEVELLED or state in BAD
    if is_withheld and (held := acceptance.missing_to_be_good()) is not None:
        words = {angle: words.get(angle, held) for angle in ANGLES}
        codes = {angle: codes.get(angle, Missing.AGREEMENT) for angle in ANGLES}
    if state is MountState.USABLE and (acceptance.has_no_sides or not words):
        code = Missing.AGREEMENT if acceptance.has_no_sides else Missing.NOTHING
        words = dict.fromkeys(ANGLES, acceptance.missing_to_be_fine()) | words
        codes = dict.fromkeys(ANGLES, code) | codes
    return words, codes


class LevelChange(Struct, frozen=True):
    """Upward force [m/s^2] before and after a change of the accelerometer's zero error or gain."""

    before: float
    after: float


def mount_troubles(
    state: MountState,
    faults: Sequence[StandingFault],
    creeping: Mapping[str, Mapping[str, float]],
    shifted: Sequence[float],
    level: LevelChange | None = None,
) -> dict[str, str]:
    """Return, per angle, the problems that more driving does not solve: contradictions, and a mount
    that moves.

    creeping: see `creep_details`. shifted: change of roll, pitch, yaw [rad] after repeated shifts,
    else 0. level: change in the magnitude of gravity, if the change is a fault.
    """
    if state is MountState.FINE:
        return {}
    if faults:
        texts = {fault: WORDS[fault] for fault in faults}
        if level is not None and StandingFault.ACCEL_LEVEL in texts:
            sizes = f" ({level.before:.2f} to {level.after:.2f} m/s^2)"
            texts[StandingFault.ACCEL_LEVEL] += sizes
        return dict.fromkeys(ANGLES, "; ".join(texts.values()))
    if state in GOOD:
        return {
            angle: f"the mount moves slowly: about {abs(found['deg_per_h']):.0f} deg/h"
            for angle, found in creeping.items()
        }
    moved = {angle: found["moved_deg"] for angle, found in creeping.items()}
    for angle, size in zip(ANGLES, shifted, strict=True):
        if size:
            moved[angle] = math.degrees(size)
    return {
        angle: f"the mount has moved by {abs(degrees):.1f} deg in this drive"
        for angle, degrees in moved.items()
    }


SEGMENTS_PER_H = 3600.0 / (SEGMENTS[0] * BLOCK_S)
"""Number of road segments in an hour of driving."""


def estimate_details(
    carried: CarriedForce,
    signals: SignalBlockMaker,
    known: MountKnowledge,
    changes: MountChanges,
    checks: SignalChecks,
    steering: tuple[float, float] | None,
    good: GoodMount | None,
    creep: Creep | None,
) -> dict[str, object]:
    """Return the details of an estimate.

    steering: zero offset of the steering-wheel angle and its deviation [rad], if known. good:
    present good mount, or None.
    """
    counts = signals.health.counts
    return {
        "evidence_share": _shares_of(carried.variances),
        "evidence_std_deg": {
            name: math.degrees(math.sqrt(variance)) for name, variance in carried.variances.items()
        },
        "accel_bias": carried.bias.tolist(),
        "gyro_bias": signals.offsets.gyro_bias.tolist(),
        "yaw_rate_offset": signals.offsets.yaw_rate,
        "steering_offset": None if steering is None else steering[0],
        "steering_offset_std": None if steering is None else steering[1],
        "speed_delay": carried.delay.value,
        "speed_delay_std": carried.delay.std,
        "gain_dvdt": carried.gains[0],
        "gain_turn": carried.gains[1],
        "launches_and_brakings": known.straight,
        "left_turns": known.lefts,
        "right_turns": known.rights,
        "stops": known.stops,
        "distance": carried.gravity.metres,
        "shifts": [
            change_details(one, turn)
            for one, turn in zip(changes.history, changes.turns(good), strict=True)
        ],
        "creep": creep_details(creep),
        "faults": [{"t": block * BLOCK_S, "fault": fault.value} for block, fault in checks.history],
        "not_checked": list(checks.alternatives.not_checked),
        "frozen_ticks": {
            signal: {fault.value: n for (of, fault), n in counts.items() if of == signal}
            for signal in dict.fromkeys(of for of, _ in counts)
        },
    }


def _shares_of(variances: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the share of each kind of evidence in the information about its angle."""
    found: dict[str, dict[str, float]] = {}
    for name, variance in variances.items():
        found.setdefault(name.partition("_")[0], {})[name] = 1.0 / variance
    return {
        angle: {name: known / math.fsum(of.values()) for name, known in of.items()}
        for angle, of in found.items()
    }


def left_out_details(signals: SignalBlockMaker) -> list[dict[str, object]]:
    """Return the data that were not used for learning: signal, cause and duration, the longest
    duration first."""
    return [
        {"signal": signal, "cause": cause, "seconds": ticks * TICK_S}
        for (signal, cause), ticks in signals.left_out.most_common()
    ]


def change_details(one: TakenChange, turn: tuple[Array, Array] | None) -> dict[str, object]:
    """Return the details of a change of the mount. turn: present estimate of the change and its
    deviation (`TakenChange.turn`).

    within_deg: half of the 95 % interval [deg] of the change, if the interval contains zero; None
    if the sensor was moved. If within_deg is not None, the mount stays in use and its interval
    covers the change.
    """
    half, is_within = max(SD_95 * one.std, abs(one.change.size)), one.is_borne
    if turn is not None:
        halves = SD_95 * turn[1]
        largest = int(np.argmax(np.abs(turn[0]) / halves))
        half = float(halves[largest])
        is_within = bool(abs(turn[0][largest]) <= half)
    return {
        "t": one.block * BLOCK_S,
        "angle": ANGLES[one.change.axis],
        "size_deg": math.degrees(one.change.size),
        "deviations": one.change.deviations,
        "turn_deg": None if turn is None else np.degrees(turn[0]).tolist(),
        "within_deg": math.degrees(half) if is_within else None,
    }


def level_details(change: LevelChange | None) -> dict[str, float] | None:
    """Return the magnitude of gravity [m/s^2] before and after a change of the accelerometer's zero
    error or gain.
    """
    return None if change is None else {"before": change.before, "after": change.after}


def creep_details(creep: Creep | None) -> dict[str, dict[str, float]]:
    """Return the angles that creep, each with its rate per hour of driving, its change so far, and
    the probability of creep."""
    if creep is None:
        return {}
    return {
        angle: {
            "deg_per_h": math.degrees(float(creep.rate[i])) * SEGMENTS_PER_H,
            "moved_deg": math.degrees(float(creep.moved[i])),
            "probability": float(creep.probability[i]),
        }
        for i, angle in enumerate(ANGLES)
        if creep.probability[i] > BELIEVED
    }


Shares = Mapping[str, float]

REMEMBERED = 29
"""Number of blocks (3 min) whose growth predicts the remaining time. This time includes roads and
stops of all kinds."""
LONGEST_S = 3600.0
"""Longest remaining time that is reported [s]. With a longer time, the evidence has almost stopped
growing."""
FIRST_S = (wd.WINDOW + wd.BLOCK) * TICK_S
"""Duration of signals that a first solution needs [s]: two windows."""
FIRST = "first solution (acceleration, braking, bends)"
"""Name of the only condition before a first solution. Before this solution, no angle has a share of
evidence."""
FIRST_SHARE_MAX = 0.99
"""Largest share of the condition `FIRST` while there is no solution."""


class ProgressWatch:
    """Stores the shares of the last minutes. The times are counted in blocks, so only driving time
    counts."""

    def __init__(self) -> None:
        self._lately: deque[tuple[float, dict[MountState, Shares]]] = deque(maxlen=REMEMBERED)

    def note_knowledge(
        self,
        t: float,
        known: MountKnowledge,
        settings: EstimatorSettings,
        acceptance: Acceptance,
    ) -> None:
        """Store the knowledge after a block that ended at t [s]."""
        shares: dict[MountState, Shares] = {
            goal: {
                **_of_angles(known, settings, goal),
                **acceptance.shares(goal is MountState.FINE),
            }
            for goal in (MountState.USABLE, MountState.FINE)
        }
        self._lately.append((t, shares))

    def after(self, state: MountState, known: MountKnowledge, can_be_fine: bool) -> Progress | None:
        """Return the conditions of the next state and their progress; None if driving does not lead
        to another state."""
        goal = MountState.FINE if state is MountState.USABLE else MountState.USABLE
        if not self._lately or state is MountState.FINE:
            return None
        if goal is MountState.FINE and not can_be_fine:
            return None
        is_learning = known.accelerometer and not known.frozen
        now, shares = self._lately[-1]
        if not any(shares[goal][axis] for axis in VEHICLE_AXES):
            return Progress(goal, (Gate(FIRST, _of_first_solution(now, known), None),))
        gates = [
            Gate(name, share, self._left(goal, name, now, share) if is_learning else None)
            for name, share in shares[goal].items()
        ]
        return Progress(goal, tuple(gates))

    def _left(self, goal: MountState, name: str, now: float, share: float) -> float | None:
        """Return the driving time until a condition is met [s]; None if the time cannot be
        predicted.
        """
        if share >= 1.0:
            return 0.0
        began, before = next(
            ((t, of[goal][name]) for t, of in self._lately if of[goal].get(name)), (now, share)
        )
        grown = share - before
        if grown <= 0.0:
            return None
        left = (1.0 - share) * (now - began) / grown
        return left if left <= LONGEST_S else None


def _of_first_solution(now: float, known: MountKnowledge) -> float:
    """Return the collected share of the evidence for a first solution. One half is for the time,
    the other half for changes of speed.
    """
    met = min(now / FIRST_S, 1.0) + min(known.straight / NEEDED, 1.0)
    return min(met / 2.0, FIRST_SHARE_MAX)


def _of_angles(
    known: MountKnowledge, settings: EstimatorSettings, goal: MountState
) -> dict[str, float]:
    limits = settings.limits
    if goal is MountState.FINE:
        tilt, yaw = limits.fine_tilt, limits.fine_yaw
    else:
        tilt, yaw = limits.usable_tilt, limits.usable_yaw
    shares = {
        axis: min((limit / std) ** 2, 1.0) if std else 1.0
        for axis, limit, std in zip(VEHICLE_AXES, (tilt, tilt, yaw), known.std, strict=True)
    }
    if math.isinf(known.cross_talk[0]) and known.straight < NEEDED:
        shares["launches and brakings"] = known.straight / NEEDED
    return shares
