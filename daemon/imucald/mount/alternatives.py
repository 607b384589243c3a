"""As configured, or with a sign turned or axes exchanged? Asked before anything is good.

A wrong sign leaves a mount that fits well enough to be believed for a while. So nothing is good
until the data have spoken against every such alternative. Each is held against "as configured" in
blocks of 6.4 s. Of a block it counts how much energy both leave over, E_k and E_0:

    log L_0 - log L_k = (n / 2) log(E_k / E_0),

the likelihood ratio of normal variables whose spread is not known (profile likelihood; Davison,
Statistical Models, 2003, ch. 4.5), n being how many of the block's values are independent. No block
counts for more than `MOST`, so that one odd block decides nothing.

The gyroscope against the accelerometer: with R known the vertical's level parts t = f / g, motion
taken off, follow from the rates, dt_x = -q + r t_y and dt_y = p - r t_x; the motion holds r too.
If a sign or two axes of either sensor are wrong the rates that fit are S w, with S a signed
permutation: so the slopes of any road show it within a minute or two.

What this cannot see is a turn of all the accelerometer's signs: force and rate then are those of
the mirror image of the drive, and physics are the same there. Nor can it see a vehicle that goes
backwards all the time. Only a signal that separates left from right shows these: the vehicle's yaw
rate, steering, lateral acceleration, for the first a heading; or a person who says which axis of
the sensor points up, or forward. So does speed for the second: no road vehicle goes backwards as
fast as `MAX_REVERSE`. While nothing has ruled the mirror image out, nothing is *fine*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.straight import yaw_rate_with_understeer
from imucald.motion.ticks import TICK_S
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock
from imucald.mount.stated_orientation import StatedOrientation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

TO_BE_GOOD = -math.log(1e-2)
"""One installation in a hundred may have some sign wrong, and there are 16 ways: after a ratio of a
hundred against each the odds of any are below one in ten thousand."""
TO_BE_FINE = -math.log(1e-4)
TO_ACCUSE = -2.0 * math.log(1e-4)
"""An accusation needs more evidence, as neighbouring blocks are not quite independent."""
MOST, HELD = 3.0, 40.0
"""Limits of one block and of a sum: later blocks can still change what earlier ones showed."""
INDEPENDENT = 5.0
"""Independent values of a signal in a block: slopes and motion hang together for a second."""
LEAST_TICKS = 60
YOUNG = 24
"""Up to so many blocks (150 s) all are weighed afresh, as the rotation still moves much."""
RARELY = 4
"""Once all is seen every fourth block is looked at."""
ENOUGH = 60
"""After so many blocks (6 min of driving) that spoke neither way they are not waited for."""
TILT_FLOOR, RATE_FLOOR, FORCE_FLOOR = 0.003, 0.01, 0.3
"""Least noise of a signal [rad], [rad/s], [m/s^2]: smaller values count as noise."""
SMOOTH = np.ones(11) / 11.0
MAX_REVERSE = 11.0
"""Speed [m/s] that is not driven in reverse: its ratio is about first gear's, 13 overall with the
axle's, which makes 11 m/s at 4,400 revolutions a minute with wheels of 2 m around."""
SLOW = 3.0
"""Below this speed [m/s] a course is noise and a lateral acceleration small."""
HEADING_FLOOR = 0.05
"""Least noise of a heading [rad]: a course at 5 m/s from a receiver's speed to 0.25 m/s."""
TURNS_IN_A_BLOCK = 1.0
"""Independent values of a heading in a block: it holds one turn at most."""
NOT_CHECKED = (
    "all signs of the accelerometer at once: it needs a yaw rate, the steering angle, a lateral "
    "acceleration, a heading, or 'calibration: {orientation: {up: ...}}'"
)

NO_TURNS = "a gyroscope, a yaw rate or a steering angle: no other signal shows turns"
"""Without turns nothing separates a right-handed sensor from a left-handed one."""


def _signed_permutations() -> Array:
    """The identity, then all ways to exchange two axes, to turn one sign, or all (14, 3, 3)."""
    eye = np.eye(3)
    some = [eye[[1, 0, 2]], eye[[0, 2, 1]], eye[[2, 1, 0]]]
    some += [eye - 2.0 * np.outer(axis, axis) for axis in eye]
    return np.array([eye, *some, *(-S for S in some), -eye])


TRIED = _signed_permutations()


class Mirrored:
    """Two signals that show the same motion, against the same with opposite signs."""

    def __init__(self, floor: float, independent: float = INDEPENDENT) -> None:
        self._floor = BLOCK_TICKS * floor * floor
        self._independent = independent
        self.sum = 0.0
        self.blocks = 0

    def forget(self) -> None:
        """Begin again."""
        self.sum, self.blocks = 0.0, 0

    def add(self, x: Array, y: Array, use: Flags) -> None:
        """Take a block's signals (N,)."""
        if np.count_nonzero(use) < LEAST_TICKS:
            return
        x, y = x[use], y[use]
        x, y = x - x.mean(), y - y.mean()
        both, cross = float(x @ x + y @ y) + self._floor, 2.0 * float(x @ y)
        ratio = 0.5 * self._independent * math.log((both + cross) / (both - cross))
        self.sum = min(max(self.sum + min(max(ratio, -MOST), MOST), -HELD), HELD)
        self.blocks += 1

    def is_seen(self, least: float) -> bool:
        """Whether the opposite is ruled out so far, or was looked for long enough in vain."""
        return self.sum > least or (self.blocks > ENOUGH and self.sum > -TO_BE_GOOD)

    @property
    def is_opposite(self) -> bool:
        """Whether the opposite is much the better one."""
        return self.sum < -TO_BE_GOOD


class Alternatives:
    """Whether the data have spoken against every wrong sign and exchange of axes."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._gyro = np.zeros(len(TRIED) - 1)
        self._gyro_blocks = 0
        self._blocks = self._taken = 0
        self._turns = Mirrored(FORCE_FLOOR)
        self._yaw_rate = Mirrored(RATE_FLOOR)
        self._steering = Mirrored(RATE_FLOOR)
        self._lateral = Mirrored(FORCE_FLOOR)
        self._heading = Mirrored(HEADING_FLOOR, TURNS_IN_A_BLOCK)
        self._stated = StatedOrientation(settings.calibration.orientation)
        self._is_up_stated = self._is_forward_stated = False
        self._fastest = 0.0
        self._signals: frozenset[str] = frozenset()

    def restart(self) -> None:
        """The mount is sought again; all that is known of the sensors' own axes is kept."""
        self._turns.forget()
        self._taken = 0
        self._is_up_stated = self._is_forward_stated = False
        self._fastest = 0.0

    def take_mount(self, R: Matrix3) -> None:
        """A person states the mount."""
        self._stated.take_mount(R)

    def contradicts_orientation(self, R: Matrix3, yaw_known: bool) -> bool:
        """Whether a person said that the sensor sits the other way round."""
        return self._stated.contradicts(R, yaw_known)

    def add(
        self,
        kept: Sequence[SignalBlock],
        R: Matrix3 | None,
        bias: Array | None,
        gains: tuple[float, float],
        seen: set[str],
        steering_offset: float,
    ) -> None:
        """Take the last of the blocks kept; R, bias, gains: as known now. seen: signals so far."""
        p = kept[-1]
        fast = np.abs(p.speed[p.ok_speed])
        self._fastest = max(self._fastest, float(fast.max(initial=0.0)))
        self._signals = frozenset(seen)
        self._blocks += 1
        if R is None:
            return
        self._ask_the_person(R)
        is_seen = self.are_seen(TO_BE_FINE) and self.is_mirror_excluded
        if is_seen and self._blocks % RARELY:
            return
        blocks: Sequence[SignalBlock] = (p,)
        if self._blocks <= YOUNG and not is_seen:
            blocks = kept
            self._gyro[:], self._gyro_blocks, self._taken = 0.0, 0, 0
            for pair in self._pairs:
                pair.forget()
        for one in blocks:
            self._take(one, R, np.zeros(3) if bias is None else bias, gains, steering_offset)

    def add_without_speed(self, p: SignalBlock, R: Matrix3 | None, seen: set[str]) -> None:
        """The same of a vehicle whose speed nobody knows: which way it turns, and no more."""
        self._signals = frozenset(seen)
        if R is None:
            return
        self._ask_the_person(R)
        use = p.learn & p.ok_rate & ~p.rest
        rate = p.rate @ R[2]
        if "yaw_rate" in self._signals:
            self._yaw_rate.add(p.yaw_rate, rate, use & p.ok_yaw)
        self._add_heading(p, rate, use)

    def _ask_the_person(self, R: Matrix3) -> None:
        self._is_up_stated = self._stated.confirms_up(R)
        self._is_forward_stated = self._stated.confirms_forward(R)

    def _add_heading(self, p: SignalBlock, rate: Array, use: Flags) -> None:
        if "heading" in p.sided:  # clockwise
            heading, known = p.sided["heading"]
            self._heading.add(TICK_S * np.cumsum(rate), -heading, use & known)

    def _take(
        self,
        p: SignalBlock,
        R: Matrix3,
        bias: Array,
        gains: tuple[float, float],
        steering_offset: float,
    ) -> None:
        self._taken += 1
        use = p.learn & p.ok_speed
        force = (p.force - bias) @ R.T
        has_gyro = np.count_nonzero(use & p.ok_rate) >= LEAST_TICKS
        rate = p.rate @ R[2] if has_gyro else p.yaw_rate
        use &= p.ok_rate if has_gyro else p.ok_yaw
        self._turns.add(gains[1] * p.speed * rate, force[:, 1], use)
        if has_gyro and "yaw_rate" in self._signals:
            self._yaw_rate.add(p.yaw_rate, rate, use & p.ok_yaw)
        if "steering" in self._signals and (has_gyro or "yaw_rate" in self._signals):
            s, v = self._settings, self._settings.vehicle
            vehicle = (v.steering_ratio, v.wheelbase, s.understeer)
            steered = yaw_rate_with_understeer(p.speed, p.steering - steering_offset, *vehicle)
            self._steering.add(steered, rate, use & p.ok_steering)
        fast = use & (np.abs(p.speed) > SLOW)
        if "lateral_accel" in p.sided:
            lateral, known = p.sided["lateral_accel"]
            self._lateral.add(p.speed * rate, lateral, fast & known)
        self._add_heading(p, rate, fast)
        if has_gyro:
            ahead = (force[:, 0] - gains[0] * p.accel) / GRAVITY
            across = force[:, 1] / GRAVITY
            ratios = gyro_ratios(ahead, across, p.rate, p.speed, R, gains[1])
            self._gyro = np.clip(self._gyro + ratios, -HELD, HELD)
            self._gyro_blocks += 1

    def are_seen(self, least: float) -> bool:
        """Whether every alternative that can be seen is ruled out by a log ratio of `least`."""
        return not self.missing(least)

    def missing(self, least: float) -> str | None:
        """What is still to be driven, in words, before all is seen to agree; None: nothing."""
        pairs = [self._turns]
        if self._gyro_blocks and "yaw_rate" in self._signals:
            pairs.append(self._yaw_rate)
        if "steering" in self._signals and (self._gyro_blocks or "yaw_rate" in self._signals):
            pairs.append(self._steering)
        beside = (self._lateral, self._heading)
        if self._taken > YOUNG and not (self._turns.blocks or self._gyro_blocks):
            return NO_TURNS
        if not all(pair.is_seen(least) for pair in pairs) or any(p.is_opposite for p in beside):
            return "bends, until signs of sensor and vehicle are seen to agree"
        closest = float(self._gyro.min())
        is_open = self._gyro_blocks <= ENOUGH or closest <= -TO_BE_GOOD
        if self._gyro_blocks and closest <= least and is_open:
            return "slopes, until the gyroscope's axes are seen to fit the accelerometer's"
        if not self._knows_forward:
            return "more than 40 km/h: slower, forwards and backwards look the same"
        return None

    @property
    def _knows_forward(self) -> bool:
        shown = {"reverse", "steering"} & self._signals
        is_told = self._is_forward_stated or self._lateral.sum > TO_BE_GOOD
        return bool(shown) or is_told or self._fastest > MAX_REVERSE

    @property
    def _pairs(self) -> tuple[Mirrored, ...]:
        return self._turns, self._yaw_rate, self._steering, self._lateral, self._heading

    @property
    def is_mirror_excluded(self) -> bool:
        """Whether anything has shown that this is the drive and not its mirror image."""
        if self._is_up_stated or self._is_forward_stated:
            return True
        sided = [self._yaw_rate, self._steering, self._lateral, self._heading]
        if not self._gyro_blocks:  # turning is the vehicle's own yaw rate
            sided.append(self._turns)
        return any(pair.sum > TO_BE_FINE for pair in sided)

    @property
    def not_checked(self) -> tuple[str, ...]:
        """What no signal of this vehicle can show, and nobody has said, in words."""
        shown = {"yaw_rate", "steering", "lateral_accel", "heading"} & self._signals
        return () if shown or self.is_mirror_excluded else (NOT_CHECKED,)

    @property
    def gyro_accused(self) -> bool:
        """Whether an alternative for gyroscope and accelerometer is much the better one."""
        return float(self._gyro.min()) < -TO_ACCUSE


def gyro_ratios(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float = 1.0
) -> Array:
    """Log likelihood ratios (13,) of a block against each alternative, at most `MOST` each.

    ahead, across: level parts of the force over g (N,), dv/dt taken off, v r still in it; rate:
    (N, 3) [rad/s] sensor axes; speed: (N,) [m/s]; gain: of v r.
    """
    left = _left_over(ahead, across, rate, speed, R, gain)
    ratios: Array = (0.5 * INDEPENDENT * np.log(left[1:] / left[0])).sum(axis=1)
    return np.clip(ratios, -MOST, MOST)


def _left_over(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float
) -> Array:
    """Energies (14, 2) that each alternative leaves of the level parts of the vertical [rad^2]."""
    rates = np.matmul(rate, np.matmul(R, TRIED).transpose(0, 2, 1))  # (14, N, 3)
    turning = rates[:, :, 2]
    sides = across - (gain / GRAVITY) * speed * turning
    smooth = [np.convolve(np.pad(x, 5, mode="edge"), SMOOTH, "valid") for x in (ahead, sides[0])]
    change = np.stack(
        [
            turning * smooth[1] - rates[:, :, 1],
            rates[:, :, 0] - turning * smooth[0],
        ],
        axis=1,
    )
    left = -TICK_S * np.cumsum(change, axis=2)
    left[:, 0] += ahead
    left[:, 1] += sides
    left -= left.mean(axis=2, keepdims=True)
    out: Array = (left * left).sum(axis=2) + BLOCK_TICKS * TILT_FLOOR**2
    return out
