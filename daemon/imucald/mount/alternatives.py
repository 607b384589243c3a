"""Check the signals for wrong signs and exchanged axes.

The check comes before any mount is called good. With a wrong sign the estimator finds a wrong
mount, which fits the data of the first minutes. A mount is therefore not good until the data have
ruled out every wrong sign and every exchange of axes. Each of these alternatives is compared with
the configuration in blocks of 6.4 s (`log_ratios`). The first kind of alternative concerns pairs of
signals that show the same motion. The second kind concerns the axes of the gyroscope against the
axes of the accelerometer (`gyro_energies`).

The second kind cannot detect two cases. In case 1, all signs of the accelerometer are inverted:
force and rate then show the mirror image of the drive, which obeys the same physics. In case 2, the
vehicle always drives backwards. Both cases are detected with a signal that distinguishes left from
right: the yaw rate of the vehicle, the steering angle, or the lateral acceleration. A heading also
detects case 1. A person can also state which axis of the sensor points up or forward. The speed
also detects case 2: no road vehicle drives backwards as fast as `MAX_REVERSE`, or for most of its
distance. The estimate becomes *fine* only after evidence has ruled out the mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.straight import yaw_rate_with_understeer
from imucald.motion.ticks import TICK_S
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.log_ratios import (
    LEAST_TICKS,
    TO_BE_FINE,
    TO_BE_GOOD,
    TRIED,
    LogRatios,
    Mirrored,
    gyro_energies,
    ratios_of,
)
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.stated_orientation import Stated, StatedOrientation

RATE_FLOOR, FORCE_FLOOR = 0.01, 0.3
"""Smallest assumed noise of a rate [rad/s] and of a force [m/s^2]."""
YOUNG = 24
"""For this number of blocks (150 s), all stored blocks are evaluated again with each new block,
because the rotation still changes much.
"""
MAX_REVERSE = 11.0
"""Speed [m/s] that no vehicle reaches in reverse.

The reverse gear has about the ratio of the first gear, 13 in total with the axle. This ratio gives
11 m/s at 4,400 engine revolutions per minute with a wheel circumference of 2 m.
"""
WAY_AHEAD = 100.0
"""Distance [m] after which a reverse signal shows which direction is forward.

The distance is longer than a drive out of a yard in reverse gear.
"""
MOSTLY_AHEAD = 2.0
"""Required ratio of the distance driven forward to the distance driven in reverse.

With a wrong sign of the reverse signal, the forward drive appears as a reverse drive.
"""
SLOW = 3.0
"""Speed [m/s] below which a course is mostly noise and a lateral acceleration is small."""
HEADING_FLOOR = 0.05
"""Smallest assumed noise of a heading [rad]: the noise of a course at 5 m/s from a receiver with a
speed error of 0.25 m/s.
"""
TURNS_IN_A_BLOCK = 1.0
"""Number of independent heading values per block: a block contains one turn at most."""
NOT_CHECKED = (
    "inverted signs of the whole accelerometer: this check needs a yaw rate, steering angle, "
    "lateral acceleration or heading, or 'calibration: {orientation: {up: ...}}'"
)
NOT_CONFIRMED = (
    "inverted signs of the whole accelerometer: a yaw rate, steering angle or lateral "
    "acceleration with 'sign: -1' cannot show them. State the axis that reads +1 g at rest: "
    "'calibration: {orientation: {up: ...}}'"
)

NO_TURNS = "a gyroscope, a yaw rate or a steering angle: no other signal shows turns"
"""Text for a vehicle whose signals show no turns: a right-handed and a left-handed sensor then look
the same."""


class Alternatives:
    """Evidence of the data against each wrong sign and each exchange of axes."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._gyro = LogRatios(len(TRIED) - 1)
        self._blocks = self._taken = 0
        self._turns = Mirrored(FORCE_FLOOR)
        self._yaw_rate = Mirrored(RATE_FLOOR)
        self._steering = Mirrored(RATE_FLOOR)
        self._lateral = Mirrored(FORCE_FLOOR)
        self._heading = Mirrored(HEADING_FLOOR, TURNS_IN_A_BLOCK)
        self._stated = StatedOrientation(settings.calibration.orientation)
        self._is_up_stated = self._is_forward_stated = False
        self._forget_ways()
        self._signals: frozenset[str] = frozenset()

    def _forget_ways(self) -> None:
        self._fastest = self._ahead = self._back = 0.0  # ahead [m/s]; ways [m]

    def restart(self) -> None:
        """Begin to search the mount again. The knowledge about the sensors' own axes is kept."""
        self._turns.forget()
        self._taken = 0
        self._is_up_stated = self._is_forward_stated = False
        self._forget_ways()

    def forget_rotation(self) -> None:
        """Forget the evidence about the gyroscope's axes: it was computed with a wrong rotation."""
        self._gyro.forget()

    def take_mount(self, R: Matrix3) -> None:
        """Use the mount that a person states."""
        self._stated.take_mount(R)

    def contradicted_orientation(self, R: Matrix3, yaw_known: bool) -> Stated | None:
        """Return the stated axis that points in the opposite direction, or None."""
        return self._stated.contradicted(R, yaw_known)

    def take_block(
        self,
        kept: Sequence[SignalBlock],
        R: Matrix3 | None,
        bias: Array,
        gains: tuple[float, float],
        seen: set[str],
        steering_offset: float,
    ) -> None:
        """Process the last of the stored blocks.

        R, bias, gains: present estimates. seen: names of the signals received so far.
        """
        p = kept[-1]
        speed = p.speed[p.ok_speed]
        self._fastest = max(self._fastest, float(speed.max(initial=0.0)))
        self._ahead += TICK_S * float(speed[speed > 0.0].sum())
        self._back -= TICK_S * float(speed[speed < 0.0].sum())
        self._signals = frozenset(seen)
        self._blocks += 1
        if R is None:
            return
        self._is_up_stated = self._stated.confirms_up(R)
        self._is_forward_stated = self._stated.confirms_forward(R)
        blocks: Sequence[SignalBlock] = (p,)
        if self._blocks <= YOUNG and not (self.are_seen(TO_BE_FINE) and self.is_mirror_excluded):
            blocks = kept
            self._gyro.forget()
            self._taken = 0
            for pair in self._pairs:
                pair.forget()
        for one in blocks:
            self._take(one, R, bias, gains, steering_offset)

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
        self._turns.add_signals(gains[1] * p.speed * rate, force[:, 1], use)
        if has_gyro and "yaw_rate" in self._signals:
            self._yaw_rate.add_signals(p.yaw_rate, rate, use & p.ok_yaw)
        if "steering" in self._signals and (has_gyro or "yaw_rate" in self._signals):
            s, v = self._settings, self._settings.vehicle
            vehicle = (v.steering_ratio, v.wheelbase, s.understeer)
            steered = yaw_rate_with_understeer(p.speed, p.steering - steering_offset, *vehicle)
            self._steering.add_signals(steered, rate, use & p.ok_steering)
        fast = use & (np.abs(p.speed) > SLOW)
        if "lateral_accel" in p.sided:
            lateral, known = p.sided["lateral_accel"]
            self._lateral.add_signals(p.speed * rate, lateral, fast & known)
        if "heading" in p.sided:  # clockwise
            heading, known = p.sided["heading"]
            self._heading.add_signals(TICK_S * np.cumsum(rate), -heading, fast & known)
        if has_gyro:
            ahead, across = force[:, 0] - gains[0] * p.accel, force[:, 1]
            level = ahead / GRAVITY, across / GRAVITY
            energies = gyro_energies(*level, p.rate, p.speed, R, gains[1])
            self._gyro.add_ratios(ratios_of(energies))

    def are_seen(self, least: float) -> bool:
        """True if every alternative that the signals can show is ruled out by a log ratio of at
        least `least`.
        """
        return not self.missing(least)

    def missing(self, least: float) -> str | None:
        """Return in words the driving that is still needed until all signals were seen to agree;
        None: no more is needed."""
        if self._taken > YOUNG and not (self._turns.blocks or self._gyro.blocks):
            return NO_TURNS
        is_opposite = min(self._lateral.sum, self._heading.sum) < -TO_BE_GOOD
        if is_opposite or not all(pair.is_seen(least) for pair in self._asked):
            return "some bends, to check that no sign is wrong"
        if self._gyro.blocks and not self._gyro.is_seen(least):
            return (
                "some slopes, to check the axes of the gyroscope against those of the accelerometer"
            )
        if not self._knows_forward:
            if "reverse" in self._signals:
                return (
                    "driving forward ('reverse' off): at least 100 m and two thirds of "
                    "the way, or faster than 40 km/h"
                )
            return "a speed above 40 km/h: below it, forwards and backwards look the same"
        return None

    def share(self, least: float) -> float:
        """Share (0 to 1) of the driving that `missing` asks for and that has been done."""
        shares = [pair.share(least) for pair in self._asked]
        shares += [self._gyro.share(least)] if self._gyro.blocks else []
        shares += [] if self._knows_forward else [self._fastest / MAX_REVERSE]
        return min(shares)

    @property
    def _asked(self) -> list[Mirrored]:
        """Pairs of signals that must be seen to agree before the mount can be good."""
        pairs = [self._turns]
        if self._gyro.blocks and "yaw_rate" in self._signals:
            pairs.append(self._yaw_rate)
        if "steering" in self._signals and (self._gyro.blocks or "yaw_rate" in self._signals):
            pairs.append(self._steering)
        return pairs

    @property
    def _knows_forward(self) -> bool:
        if self._fastest > MAX_REVERSE or self._is_forward_stated:
            return True
        if "steering" in self._signals or self._lateral.sum > TO_BE_GOOD:
            return True
        is_ahead = self._ahead > max(WAY_AHEAD, MOSTLY_AHEAD * self._back)
        return "reverse" in self._signals and is_ahead

    @property
    def _pairs(self) -> tuple[Mirrored, ...]:
        return self._turns, self._yaw_rate, self._steering, self._lateral, self._heading

    @property
    def is_mirror_excluded(self) -> bool:
        """True if the mirror image of this drive is ruled out, by a signal or by a person's
        statement."""
        return self.mirror_share >= 1.0

    @property
    def mirror_share(self) -> float:
        """Collected share (0 to 1) of the evidence that is needed against the mirror image."""
        if self._is_up_stated or self._is_forward_stated:
            return 1.0
        sided = [self._heading]
        if not self._settings.are_sides_turned:
            sided += [self._yaw_rate, self._steering, self._lateral]
            if not self._gyro.blocks:  # in this case turning is the vehicle's own yaw rate
                sided.append(self._turns)
        return min(max(0.0, *(pair.sum / TO_BE_FINE for pair in sided)), 1.0)

    @property
    def not_checked(self) -> tuple[str, ...]:
        """Return, in words, the properties that no signal of this vehicle shows and that no person
        has stated."""
        if self._settings.are_sides_turned:
            has_heading = "heading" in self._signals
            return () if has_heading or self.is_mirror_excluded else (NOT_CONFIRMED,)
        shown = {"yaw_rate", "steering", "lateral_accel", "heading"} & self._signals
        return () if shown or self.is_mirror_excluded else (NOT_CHECKED,)

    @property
    def gyro_accused(self) -> bool:
        """True if an alternative for gyroscope and accelerometer fits much better than the
        configuration.
        """
        return self._gyro.is_accused
