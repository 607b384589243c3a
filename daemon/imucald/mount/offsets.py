"""Zero offsets of the gyroscope and of the vehicle's yaw rate, measured at rest, where both rates
are zero."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from imucald.core.arrays import Array, median, solved
from imucald.motion.standstill import IDLE_RATE, MAX_GYRO_BIAS, is_idle

MIN_TICKS = 8
"""Smallest number of ticks at rest in a usable block."""
REST_MEMORY = 250.0
"""Largest weight of an offset, in ticks at rest. Older data are forgotten, because the offset
changes with temperature."""
MAX_STEP = 0.02
"""Largest change of an offset that is already known [rad/s]."""
GUESS_TICKS = 250
"""Number of driving ticks from which a gyroscope bias can be guessed without a rest."""
MAX_TURNS = 250
"""Largest number of blocks for the guess of a gyroscope bias: half an hour."""
ROLLING, BIAS_STD, UP_STD = 0.02, 0.02, 0.1
"""Standard deviations for the guess of a gyroscope bias: roll and pitch rate of a vehicle [rad/s],
bias [rad/s] (MPU-6050, 6.1: 20 deg/s at most), and direction of the mean force relative to the
vertical [rad]. A bend of 1 m/s^2 tilts the mean force by 0.1 rad.
"""
TURN_ZERO, STRAIGHT = 0.02, 8.0
"""Deviation of the zero error of the vehicle's own turn rate [rad/s], and the odds of a straight
road against a bend if this turn rate is zero during `GUESS_TICKS` ticks.

A bend ends, so the odds grow in proportion to the driven time. Both values were chosen on the
simulated drives 1740010 to 1740015 (mixed roads), and 1740040 to 1740044 and 1740060 to 1740069
(motorways).
"""


class Offsets:
    """Gyroscope bias (3,) and offset of the vehicle's yaw rate [rad/s], each with its number of
    ticks at rest."""

    def __init__(self) -> None:
        self.gyro_bias: Array = np.zeros(3)
        self.gyro_ticks = 0.0
        self.yaw_rate = 0.0
        self._yaw_ticks = 0.0
        self._is_old = False  # the gyro bias is of before
        self._begin_to_guess()

    def _begin_to_guess(self) -> None:
        self._moving = 0
        self._moving_rate = np.zeros(3)
        self._moving_force = np.zeros(3)
        self._turn_sums = np.diag([ROLLING / BIAS_STD, ROLLING / UP_STD]) ** 2
        self._turned_rate = np.zeros(3)  # sum of the vehicle's turn rate times the rate
        self._turns: deque[tuple[float, float]] = deque(maxlen=MAX_TURNS)
        self._turn_zero_std = 0.0

    @property
    def turn_zero_std(self) -> float:
        """Deviation of the bias about the vertical [rad/s]. It is zero after the first rest."""
        return self._turn_zero_std if self.gyro_ticks == 0.0 else 0.0

    def doubt_gyro(self) -> None:
        """Determine the bias again, because the sensor was moved or exchanged.

        The old bias is used until a new bias is known. A wrong bias of 0.4 deg/s would tilt the
        vertical by 6 deg.
        """
        self._is_old = self._is_old or self.gyro_ticks > 0.0 or self._moving >= GUESS_TICKS
        self.gyro_ticks = 0.0
        self._begin_to_guess()

    def learn_gyro(self, rate: Array, force: Array) -> None:
        """Process raw rates (n, 3) and forces (n, 3) at rest."""
        n = len(rate)
        if n < MIN_TICKS:
            return
        mean = rate.mean(axis=0)
        if not is_idle(rate, force) or np.abs(mean).max() > MAX_GYRO_BIAS:
            return
        if self.gyro_ticks > 50.0 and np.abs(mean - self.gyro_bias).max() > MAX_STEP:
            return
        self.gyro_ticks = min(self.gyro_ticks + n, REST_MEMORY)
        self.gyro_bias = self.gyro_bias + (mean - self.gyro_bias) * (n / self.gyro_ticks)

    def learn_yaw_rate(self, yaw_rate: Array) -> None:
        """Process raw yaw rates of the vehicle (n,) at rest."""
        n = len(yaw_rate)
        if n < MIN_TICKS:
            return
        mean = float(yaw_rate.mean())
        if abs(mean) > MAX_GYRO_BIAS or float(np.abs(yaw_rate - mean).max()) > IDLE_RATE:
            return
        self._yaw_ticks = min(self._yaw_ticks + n, REST_MEMORY)
        self.yaw_rate += (mean - self.yaw_rate) * (n / self._yaw_ticks)

    def guess_gyro(self, rate: Array, force: Array, turn: Array) -> bool:
        """Guess the bias before the first rest.

        The rate is the bias plus the turn rate of the vehicle about the vertical. Both are fitted,
        with the direction of the mean force as the prior of the vertical. About the vertical, the
        guess is a median, because a road vehicle drives straight most of the time. If the vehicle's
        own signal turns, either the vehicle is in a bend or this signal has a zero error. The guess
        is the mean of both cases, weighted by their probabilities, and its deviation is the
        deviation between them (`turn_zero_std`). rate, force: raw values (n, 3). turn: (n,) turn
        rate of the vehicle from its own signals, zeros if there are none. Returns True if the
        vehicle has driven enough to use the guess.
        """
        if len(rate):
            self._moving += len(rate)
            self._moving_rate += rate.sum(axis=0)
            self._moving_force += force.sum(axis=0)
            up = self._moving_force / np.sqrt(self._moving_force @ self._moving_force)
            total = float(turn.sum())
            self._turn_sums += [[len(rate), total], [total, float(turn @ turn)]]
            self._turned_rate += turn @ rate
            self._turns.append((median(rate @ up), median(turn)))
            vertical = self._turned_rate + (ROLLING / UP_STD) ** 2 * up
            mean, _ = solved(self._turn_sums, np.array([self._moving_rate, vertical]))
            about, turned = (median(x) for x in np.array(self._turns).T)
            ratio = STRAIGHT * max(self._moving / GUESS_TICKS, 1.0)
            size = turned / TURN_ZERO
            bend = 1.0 / (1.0 + ratio * math.exp(-0.5 * size * size))
            about -= bend * turned
            if self._moving >= GUESS_TICKS or not self._is_old:
                self._turn_zero_std = math.sqrt(bend * (1.0 - bend)) * abs(turned)
                self.gyro_bias = mean + up * (about - mean @ up)
        return self._is_old or self._moving >= GUESS_TICKS
