"""Signals that contradict one another: signs, exchanged axes, handedness, units.

The estimator finds the rotation under which the sensor's signals fit the vehicle's signals best.
With a wrong sign or unit, the best rotation is still wrong. Pairs of signals that must show the
same motion are therefore compared all the time. The first pair is the gyroscope's turn rate and the
turn rate from the vehicle's own signals. The second pair is v r (speed times yaw rate) and the
force to the left, the third pair is dv/dt and the force ahead.

The drive is divided into pieces. Each piece has a bend or a braking manoeuvre. For each piece and
each pair of signals, the correlation and the gain are computed. Correct pairs have a correlation of
0.8 to 1 in a piece. The correlation of two unrelated signals is below `UNLIKE` in nine of ten
pieces. The correlation of a correct pair is below `UNLIKE` in fewer than one of a hundred pieces. A
false fault needs `TO_ACCUSE` such pieces among the last `REMEMBERED` pieces.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from imucald.core.arrays import Array, Flags, median
from imucald.motion.straight import yaw_rate_with_understeer
from imucald.motion.ticks import TICK_S
from imucald.mount.alternatives import MAX_REVERSE, RATE_FLOOR
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.log_ratios import PairSums, pair_sums
from imucald.mount.signal_blocks import SignalBlock

UNLIKE = 0.3
"""Correlation in a piece below which two signals count as showing different motions."""
OPPOSITE = -0.3
"""Correlation limit for signals that contain slope or come from a speed with few samples. With this
limit, only a wrong sign is detected.
"""
LIKE = 0.6
"""Correlation from which two signals count as showing the same motion. The command `check` uses the
same limit.
"""
TO_ACCUSE, TO_ACQUIT = 2, 2
"""Number of unlike pieces, among the stored pieces, that makes a fault; number of like pieces in a
row that ends the fault.
"""
REMEMBERED = 5
WRONG_UNIT = 1.9
"""Gain above which the unit of a signal counts as wrong. A gain below the inverse counts as wrong
too. Noise of neither signal can then explain the gain (`Piece`).

The limit is the geometric mean of 1 and 3.6, the smallest factor between units that are often
confused. Body roll, superelevation and squat cause gains of 0.7 to 1.3.
"""
MIN_TURNING = 0.25
"""Smallest energy of turning in a piece [(rad/s)^2 ticks]: a right-angled bend has ten times this
energy.
"""
MIN_FORCE = 30.0
"""Smallest energy of v r (speed times yaw rate) or dv/dt in a piece [(m/s^2)^2 ticks]: 3 s at 1
m/s^2.
"""
MAX_BLOCKS = 40
"""Number of blocks (4 min) after which a piece that is still incomplete starts again, because the
noise is known only roughly.
"""
TURNS, HARD_TURNS = 1.2, 2.0
"""Sizes of v r (speed times yaw rate) [m/s^2] above which the force in turns is checked: the first
limit for its sign, the second for its gain.

A bend with a superelevation of 8 % reduces the lateral force by 0.8 m/s^2 (AASHTO).
"""
LONG_REVERSE = 20
"""Ticks in reverse within a block (2 s) that cannot come from a short slip of the gear lever."""
NOISE = 3.0
"""Largest ratio at which a block is still used: `TURNS` or `HARD_TURNS` divided by the noise of v
r.

In a block with more noise, values above `TURNS` or `HARD_TURNS` are noise and not a bend. If the
gyroscope sends seldom, the interpolation between two samples hides the noise. The noise is then
computed from the random walk of the integrated angle.
"""
MOVING = 2.0
"""Speed [m/s] below which steering angle and turn rate are hardly related."""


class StandingFault(enum.StrEnum):
    """A contradiction between signals.

    The values are machine-readable names. `WORDS` has the texts for people.
    """

    TURN_YAW_RATE = "gyroscope_against_yaw_rate"
    TURN_STEERING = "turning_against_steering"
    FORCE_TURNS = "accelerometer_against_turns"
    FORCE_SPEED = "accelerometer_against_speed"
    GYRO_GAIN = "gyroscope_unit"
    SPEED_GAIN = "speed_unit"
    GYRO_AXES = "gyroscope_axes"
    ORIENTATION = "accelerometer_against_orientation"
    FORWARD = "forward_against_orientation"
    ACCEL_LEVEL = "accelerometer_zero_or_gain"
    ACCEL_ZERO = "accelerometer_zero"
    ACCEL_DRIFT = "accelerometer_zero_drifts"
    REVERSE = "fast_in_reverse"
    NUMERICS = "numbers_out_of_range"


WORDS = {
    StandingFault.TURN_YAW_RATE: "the gyroscope contradicts the vehicle's yaw rate: one of "
    "them has a wrong sign, or axes of the gyroscope or accelerometer are exchanged",
    StandingFault.TURN_STEERING: (
        "the vehicle turns against the steering angle: the steering angle or the sensor has a "
        "wrong sign, or the vehicle reverses without a reverse signal"
    ),
    StandingFault.FORCE_TURNS: "the lateral force does not match speed times turn rate: the "
    "accelerometer or gyroscope has a wrong sign or exchanged axes, or the sensor moves",
    StandingFault.FORCE_SPEED: "the forward force does not follow the change of speed",
    StandingFault.GYRO_GAIN: "the gyroscope's unit is wrong",
    StandingFault.SPEED_GAIN: "the speed's unit is wrong",
    StandingFault.GYRO_AXES: "the gyroscope's axes do not fit the accelerometer's: one of them "
    "has a wrong sign or two exchanged axes, or the sensor moves in its "
    "holder",
    StandingFault.ORIENTATION: "the axis that 'orientation: {up: ...}' names points down: that "
    "line is wrong, or all signs of the accelerometer are wrong "
    "('sign: -1')",
    StandingFault.FORWARD: "the axis that 'orientation: {forward: ...}' names points backward: "
    "that line or the reverse signal is wrong",
    StandingFault.ACCEL_LEVEL: "the accelerometer's zero or gain has changed during the drive: "
    "gravity is larger or smaller than before",
    StandingFault.ACCEL_ZERO: "the accelerometer's zero has changed during the drive: the "
    "direction of gravity in the sensor has changed, but the axis "
    "about which the gyroscope turns has not",
    StandingFault.ACCEL_DRIFT: "the accelerometer's zero drifts: its error does not depend on "
    "bends, and grows",
    StandingFault.REVERSE: "the vehicle is in reverse at more than 40 km/h: 'reverse' "
    "('equals:', 'above:') or the sign of the speed is wrong",
    StandingFault.NUMERICS: "some numbers are out of range: a unit is wrong",
}


class Piece(NamedTuple):
    """Two signals x and y in a piece of the drive: their correlation and two slopes.

    The slopes of y on x are those of two regressions: of y on x, and of x on y. Noise of x makes
    the first slope too small, and noise of y makes the second slope too large. The true gain lies
    between them (Frisch, Statistical Confluence Analysis, 1934).
    """

    correlation: float
    slope: float
    other_slope: float

    @classmethod
    def of(cls, sums: PairSums) -> Piece:
        """Return the piece with these sums."""
        xx, xy, yy = sums.xx, sums.xy, sums.yy
        correlation = xy / math.sqrt(max(xx * yy, 1e-30))
        return cls(correlation, xy / xx, yy / xy if xy else math.inf)

    @property
    def has_odd_gain(self) -> bool:
        """True if the two signals show the same motion in different units."""
        is_odd = self.slope > WRONG_UNIT or self.other_slope < 1.0 / WRONG_UNIT
        return self.correlation > LIKE and is_odd


class PairWatch:
    """Correlations and gains of two signals that must show the same motion, piece by piece.

    noise: rms noise of the first signal, whose energy shows no motion. has_zero: the first signal
    has an unknown zero error, so the means of a piece are subtracted.
    """

    def __init__(
        self,
        least: float,
        unlike: float = UNLIKE,
        unit_known: bool = True,
        noise: float = 0.0,
        has_zero: bool = False,
    ) -> None:
        self._least, self._unlike, self._unit_known = least, unlike, unit_known
        self._noise, self._has_zero = noise, has_zero
        self._pieces: deque[Piece] = deque(maxlen=REMEMBERED)
        self._begin_piece()
        self.accused = False
        self.odd_gain = False

    def _begin_piece(self) -> None:
        self._sums, self._blocks = PairSums(), 0

    def forget(self) -> None:
        """Forget all pieces. A present fault remains until new pieces of the pair agree."""
        self._begin_piece()
        self._pieces.clear()

    @property
    def pieces(self) -> int:
        """Number of stored pieces."""
        return len(self._pieces)

    @property
    def gain(self) -> float:
        """Median of the gains of the stored pieces."""
        return median([piece.slope for piece in self._pieces]) if self._pieces else 1.0

    def add_signals(self, x: Array, y: Array, use: Flags) -> None:
        """Process a block. x: (N,) the reliable signal. y: (N,) the signal that must follow x."""
        sums = pair_sums(x, y, use)
        if not sums.ticks:
            return
        self._sums = PairSums(*(a + b for a, b in zip(self._sums, sums, strict=True)))
        self._blocks += 1
        held = self._sums.centred() if self._has_zero else self._sums
        if not math.isfinite(held.xx + held.yy):
            self._sums = PairSums()
            return
        is_complete = held.xx - held.ticks * self._noise**2 >= self._least
        if is_complete:
            self._pieces.append(Piece.of(held))
            self._judge()
        if is_complete or self._blocks >= MAX_BLOCKS:
            self._begin_piece()

    def _is_odd(self, piece: Piece) -> bool:
        return self._unit_known and piece.has_odd_gain

    def _is_wrong(self, piece: Piece) -> bool:
        return piece.correlation < self._unlike or self._is_odd(piece)

    def _judge(self) -> None:
        unlike = sum(piece.correlation < self._unlike for piece in self._pieces)
        odd = sum(self._is_odd(piece) for piece in self._pieces)
        last = list(self._pieces)[-TO_ACQUIT:]
        acquitted = len(last) == TO_ACQUIT and not any(self._is_wrong(piece) for piece in last)
        self.accused = not acquitted and (self.accused or unlike >= TO_ACCUSE)
        self.odd_gain = not acquitted and (self.odd_gain or odd >= TO_ACCUSE)


class ReverseWatch:
    """Watches for a reverse speed that no vehicle reaches."""

    def __init__(self) -> None:
        self.accused = False
        self._sound_blocks = 0

    def add_speed(self, speed: Array, ok: Flags) -> None:
        """Process a block. speed: (N,) [m/s]. ok: (N,) True where the speed is known."""
        back = np.count_nonzero(ok & (speed < -MAX_REVERSE))
        if back >= LONG_REVERSE:
            self.accused, self._sound_blocks = True, 0
        elif not back and np.count_nonzero(ok & (speed > MAX_REVERSE)) >= LONG_REVERSE:
            self._sound_blocks += 1
            self.accused &= self._sound_blocks < TO_ACQUIT


class Contradictions:
    """Watches all pairs of signals that are available."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self.yaw_rate = PairWatch(MIN_TURNING, noise=RATE_FLOOR, has_zero=True)
        self.steering = PairWatch(MIN_TURNING, unit_known=False, noise=RATE_FLOOR, has_zero=True)
        self.turns = PairWatch(MIN_FORCE, unit_known=False)
        self.hard_turns = PairWatch(MIN_FORCE)
        self.speed = PairWatch(MIN_FORCE, OPPOSITE)
        self.reverse = ReverseWatch()

    def forget_forces(self) -> None:
        """Start again for a new rotation.

        Faults that were found with the old rotation remain until the signals agree.
        """
        for pair in (self.turns, self.hard_turns, self.speed):
            pair.forget()

    def take_block(
        self,
        p: SignalBlock,
        turn_rate: Array,
        own_gyro: bool,
        R: Array | None,
        steering_offset: float,
        measured_yaw_rate: bool,
        late: float | None = 0.0,
    ) -> None:
        """Process a block. turn_rate: (N,) the yaw rate that the estimator uses [rad/s].

        late: delay of the speed against the force [s]. If the delay is None (unknown), the force is
        not checked.
        """
        self.reverse.add_speed(p.speed, p.ok_speed)
        moving = p.ok_speed & (np.abs(p.speed) > MOVING)
        if own_gyro and measured_yaw_rate:
            self.yaw_rate.add_signals(p.yaw_rate, turn_rate, p.ok_yaw & p.ok_rate & moving)
        if own_gyro or measured_yaw_rate:
            s, v = self._settings, self._settings.vehicle
            vehicle = v.steering_ratio, v.wheelbase, s.understeer
            steered = yaw_rate_with_understeer(p.speed, p.steering - steering_offset, *vehicle)
            use = p.ok_steering & moving & (p.ok_rate | p.ok_yaw)
            self.steering.add_signals(steered, turn_rate, use)
        if R is None or late is None:
            return
        ticks, n = round(late / TICK_S), len(turn_rate)
        now = slice(max(-ticks, 0), n - max(ticks, 0))
        then = slice(max(ticks, 0), n - max(-ticks, 0))
        ahead, across = R[:2] @ p.force[now].T
        use = moving[then] & (p.ok_force & p.learn)[now]
        change = p.accel[then]
        self.speed.add_signals(change - change.mean(), ahead - ahead.mean(), use)
        turn, use = p.speed[then] * turn_rate[now], use & (p.ok_rate | p.ok_yaw)[now]
        walk = math.sqrt(float(R[2] @ p.rate_walk @ R[2]) / TICK_S) if own_gyro else 0.0
        noise = NOISE * max(_own_noise(turn_rate), walk) * float(np.abs(p.speed).max())
        for pair, least in ((self.turns, TURNS), (self.hard_turns, HARD_TURNS)):
            if noise < least:
                pair.add_signals(turn, across, use & (np.abs(turn) > least))

    @property
    def faults(self) -> tuple[StandingFault, ...]:
        """Present faults."""
        if self.reverse.accused:  # other contradictions follow from it
            return (StandingFault.REVERSE,)
        found = []
        if self.yaw_rate.accused:
            found.append(StandingFault.TURN_YAW_RATE)
        if self.steering.accused:
            found.append(StandingFault.TURN_STEERING)
        if self.turns.accused:
            found.append(StandingFault.FORCE_TURNS)
        if self.speed.accused:
            found.append(StandingFault.FORCE_SPEED)
        if self.yaw_rate.odd_gain:
            found.append(StandingFault.GYRO_GAIN)
        elif self.hard_turns.odd_gain:
            gyro_unknown = not self.yaw_rate.pieces
            is_speed = self.speed.odd_gain or not gyro_unknown
            found.append(StandingFault.SPEED_GAIN if is_speed else StandingFault.GYRO_GAIN)
        elif self.speed.odd_gain and self.speed.gain > 1.0:
            found.append(StandingFault.SPEED_GAIN)
        return tuple(found)


def _own_noise(signal: Array) -> float:
    """Return the standard deviation of the white part of an even signal (N,).

    The difference between a value and the mean of its two neighbours has 1 + 1/4 + 1/4 times the
    variance of the white part. Turns of a vehicle last for seconds, so they hardly change the
    result.
    """
    left = signal[1:-1] - 0.5 * (signal[:-2] + signal[2:])
    return math.sqrt(float((left * left).sum()) / (1.5 * len(left)))
