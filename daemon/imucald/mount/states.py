"""States of the joint estimator with their hysteresis, and the missing evidence of each angle.

`Manoeuvres` counts the manoeuvres so far: launches, brakings, left turns and right turns.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.mount.alternatives import NO_TURNS
from imucald.mount.estimate import Missing, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.hysteresis import BAD, GOOD, SLACK, Level, best_level
from imucald.mount.mount_words import SD_95, UNKNOWN_STD_DEG, VEHICLE_AXES

HARD_ACCEL = 1.0
"""Acceleration or braking [m/s^2] above which a manoeuvre counts."""
HARD_TURN = 0.8
"""Lateral acceleration [m/s^2] above which a turn counts."""
HARD_TICKS = 5
"""Shortest duration of a manoeuvre in ticks."""


_COUNT, _RUN = 0, 1


class Manoeuvres:
    """Counts of launches, brakings, left turns and right turns.

    A manoeuvre is an interval above a level that lasts long enough. Between two manoeuvres, the
    acceleration must fall below half of the level.
    """

    def __init__(self) -> None:
        self._state = np.zeros((4, 3), np.int64)
        """Rows for launches, brakings, left turns, right turns. Columns: number of manoeuvres,
        ticks of the present interval, 1 if the present interval was counted.
        """

    def add_accelerations(self, accel: Array, turn: Array) -> None:
        """Process a block of dv/dt and v r (speed times yaw rate). dv/dt and v r are zero in ticks
        that are not trusted.
        """
        for k, values in enumerate((accel, -accel, turn, -turn)):
            self._feed(self._state[k], values, HARD_ACCEL if k < 2 else HARD_TURN)

    @staticmethod
    def _feed(state: NDArray[np.int64], values: Array, level: float) -> None:
        count, run, over = state.tolist()
        if not over and not np.count_nonzero(values > level):
            state[_RUN] = 0
            return
        for value in values.tolist():
            if value > level:
                run += 1
                if run == HARD_TICKS and not over:
                    count, over = count + 1, 1
            elif value < 0.5 * level:
                run = over = 0
        state[:] = count, run, over

    @property
    def straight(self) -> int:
        """Number of launches and brakings."""
        return int(self._state[0, _COUNT] + self._state[1, _COUNT])

    @property
    def lefts(self) -> int:
        """Number of left turns."""
        return int(self._state[2, _COUNT])

    @property
    def rights(self) -> int:
        """Number of right turns."""
        return int(self._state[3, _COUNT])


WIDE_SLACK = 2.0
"""Factor `SLACK` of *usable* for a vehicle without a gyroscope or a speed, where few pieces of
evidence determine the state.

The deviation from six pieces has an error of 29 % (1 / sqrt(2 n)). Twice the limit is 3.5 of these
errors above the limit.
"""
NEEDED = 3
"""Number of launches or brakings that a first solution usually needs."""
NO_SAMPLES = "valid accelerometer samples: none in the last minute (missing, faulty or too slow)"


class MountKnowledge(Struct, frozen=True):
    """Knowledge by which the states are judged.

    std: deviations of the level zero y and x as tilts, and deviation of the larger cross-talk, xy
    or yx, as a yaw [rad]; infinite before a solution. cross_talk: deviations of xy and yx [rad].
    std_without_drift: `std` for an accelerometer whose zero error does not drift; None: equal to
    `std`. std_of_sound: `std` for such an accelerometer in a mount that does not move; None: equal
    to `std`. turning: any signal shows turns. has_gyro: the sensor's own gyroscope shows turns.
    speed_hz: ticks per second with a speed in the last minute. without_speed: no speed was ever
    received, so the speed is an unknown of the solution.
    """

    gravity: bool = False
    std: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    cross_talk: tuple[float, float] = (math.inf, math.inf)
    std_without_drift: tuple[float, float, float] | None = None
    std_of_sound: tuple[float, float, float] | None = None
    straight: int = 0
    lefts: int = 0
    rights: int = 0
    stops: int = 0
    begun: bool = True
    accelerometer: bool = True
    speed: bool = True
    speed_hz: float = 0.0
    frozen: bool = False
    turning: bool = True
    has_gyro: bool = True
    without_speed: bool = False


def judged(known: MountKnowledge, before: MountState, s: EstimatorSettings) -> MountState:
    """Return the state for this knowledge, with hysteresis against the previous state."""
    if not known.gravity:
        return MountState.WAITING
    roll, pitch, yaw = known.std
    is_sparse = known.without_speed or not known.has_gyro
    limits, slack = s.limits, WIDE_SLACK if is_sparse else SLACK
    levels = (
        Level(MountState.FINE, limits.fine_yaw, limits.fine_tilt, True, SLACK),
        Level(MountState.USABLE, limits.usable_yaw, limits.usable_tilt, True, slack),
    )
    return best_level(levels, before, yaw, max(roll, pitch)) or MountState.LEVELLED


def is_mount_uncertain(known: MountKnowledge, s: EstimatorSettings) -> bool:
    """True if most of the variance is that of a sensor without a fault in a mount that does not
    move.

    The variance is that of the angle which is furthest from being *usable*.
    """
    limits = s.limits.usable_tilt, s.limits.usable_tilt, s.limits.usable_yaw
    worst = max(range(3), key=lambda i: known.std[i] / limits[i])
    of_sound = known.std if known.std_of_sound is None else known.std_of_sound
    return 2.0 * of_sound[worst] ** 2 >= known.std[worst] ** 2


def reported(
    found: MountState,
    before: MountState,
    has_faults: bool,
    was_good: bool,
    has_moved: bool,
    is_uncertain: bool,
) -> MountState:
    """Return the state to report for the state `found` that follows from the evidence.

    After a move of the sensor, the state is *suspect* first. before: previous state. has_faults:
    there is a contradiction to the estimate. was_good: there was a good correction before.
    has_moved: the mount moved and no good rotation was found since. is_uncertain: see
    `is_mount_uncertain`. An uncertain mount is not *suspect*.
    """
    is_good = found in GOOD
    if has_faults and (is_good or was_good):
        return MountState.SUSPECT
    if has_moved and found is MountState.LEVELLED and before in BAD:
        return MountState.RECALIBRATING
    is_doubted = before in BAD or (before in GOOD and not is_uncertain)
    is_suspect = not is_good and (has_moved or (was_good and is_doubted))
    return MountState.SUSPECT if is_suspect else found


def waiting_for(
    known: MountKnowledge, s: EstimatorSettings, before: MountState = MountState.USABLE
) -> dict[str, tuple[str, Missing]]:
    """Return one reason per angle, in words and as a code. An angle without missing evidence has no
    entry.

    before: reported state. The reasons are the missing evidence for the next state.
    """
    if not known.accelerometer:
        text = (
            (NO_SAMPLES if known.begun else "the first 6 s of samples"),
            Missing.ACCELEROMETER,
        )
        return {"roll": text, "pitch": text, "yaw": text}
    if known.frozen:
        text = "valid signals: learning is paused while they are faulty", Missing.LEARNING_FROZEN
        return {"roll": text, "pitch": text, "yaw": text}
    goal = _goal(known, before, s)
    out: dict[str, tuple[str, Missing]] = {}
    if not known.gravity:
        text = "a standstill, or driving", Missing.STANDSTILL
        out = {"roll": text, "pitch": text}
    if known.std[2] > goal.yaw:
        out["yaw"] = _yaw_reason(known, goal)
    if "roll" in out:
        return out
    if known.std[0] > goal.tilt:
        out["roll"] = _level_reason(0, known, goal)
    if known.std[1] > goal.tilt:
        out["pitch"] = _level_reason(1, known, goal)
    return out


class _Goal(Struct, frozen=True):
    """The next state, and the largest deviations [rad] that are allowed in this state."""

    state: MountState
    tilt: float
    yaw: float

    def far(self, axis: int, std: float) -> str:
        """Return in words the deviation of a rotation about a vehicle axis and its limit, both as
        95 % values."""
        if not math.degrees(std) < UNKNOWN_STD_DEG:
            return ""
        limit = self.yaw if axis == 2 else self.tilt
        now, least = (f"±{math.degrees(SD_95 * x):.3g} deg" for x in (std, limit))
        return f" ({VEHICLE_AXES[axis]} {now}, {self.state.name.lower()} below {least})"


def _goal(known: MountKnowledge, before: MountState, s: EstimatorSettings) -> _Goal:
    limits = s.limits
    if before in GOOD:
        return _Goal(MountState.FINE, limits.fine_tilt, limits.fine_yaw)
    return _Goal(MountState.USABLE, limits.usable_tilt, limits.usable_yaw)


def _hard() -> str:
    return f"acceleration or braking above {HARD_ACCEL:g} m/s2"


def _first_reason(known: MountKnowledge) -> tuple[str, Missing]:
    """Return the evidence that a first solution needs."""
    if not known.speed and not (known.without_speed and known.turning):
        return "a speed", Missing.SPEED
    seen = f"{known.straight} and {known.lefts + known.rights} seen"
    code = Missing.ACCELERATION if known.straight < NEEDED else Missing.TURNS
    sooner = "; a speed would show it sooner" if known.without_speed else ""
    return f"{_hard()}, and bends ({seen}){sooner}", code


def _yaw_reason(known: MountKnowledge, goal: _Goal) -> tuple[str, Missing]:
    """Return the evidence that reduces the larger cross-talk: bends reduce xy, changes of speed
    reduce yx."""
    xy, yx = known.cross_talk
    if math.isinf(xy):
        return _first_reason(known)
    if not known.speed and not (known.without_speed and goal.state is MountState.USABLE):
        used = "" if known.without_speed else f" ({known.speed_hz:.2g}/s used in the last minute)"
        return f"a speed{used}", Missing.SPEED
    far = goal.far(2, known.std[2])
    if xy < yx:
        return _hard() + far, Missing.ACCELERATION
    return f"bends{far}" if known.turning else NO_TURNS, Missing.TURNS


def _level_reason(axis: int, known: MountKnowledge, goal: _Goal) -> tuple[str, Missing]:
    """Return the evidence that reduces the level zero along the vehicle (axis 1) or across it (axis
    0)."""
    if axis == 0 and not known.turning:
        return NO_TURNS, Missing.TURNS
    if math.isinf(known.cross_talk[0]):
        return _first_reason(known)
    far, still = goal.far(axis, known.std[axis]), known.std_without_drift
    if still is not None and still[axis] < goal.tilt:
        text = f"bends, to decide whether the accelerometer's zero drifts{far}"
        return text, Missing.TURNS
    return f"more driving: slopes average out{far}", Missing.MORE_DRIVING
