"""The attitude matrix from the gyroscope, and running integrals in the frame P.

The frame P is the body's frame at the start, tracked with the gyroscope alone. The filter's
corrections are a separate rotation, so the history has no jumps. Integrals of the specific force
are stored for some seconds. With these integrals, an interval between two speed samples can be
evaluated when a late speed is received.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from typing import NamedTuple

from imucald.core.rotations import (
    IDENTITY,
    Quaternion,
    Rows,
    Vector,
    cross,
    quaternion_product,
    quaternion_turned,
    rows_from_quaternion,
    times,
)

HISTORY_S = 8.0
"""Length of the history [s]: an interval, its delay, and a slow speed."""
MAX_HISTORY = 16_384
MAX_PENDING = 64
"""Largest number of accelerometer samples that wait for a later gyroscope sample."""


class IntegralSnapshot(NamedTuple):
    """Running integrals up to time t [s], and the body's direction at this time, in the frame P.

    force: integral of the specific force [m/s]. forward, right: unit axes of the body. arm:
    velocity of the sensor from its lever arm [m/s]. up_rate: rate about the body's up axis [rad/s].
    n, body, square: count, sum and sum of squares of the specific force in body axes. turns, rate,
    rate_square: count, sum and sum of squares of the raw gyroscope, with squares for each axis.
    angle: total turn [rad].
    """

    t: float
    force: Vector
    forward: Vector
    right: Vector
    arm: Vector
    up_rate: float
    n: float
    body: Vector
    square: float
    turns: float
    rate: Vector
    rate_square: Vector
    angle: float


class Propagator:
    """Integrates the attitude with gyroscope samples, and stores the history with accelerometer
    samples. All axes are right-forward-up.

    longest_step: time between two samples above which a new segment begins [s]. lever: vector from
    the point whose velocity is the speed to the sensor [m].
    """

    def __init__(self, longest_step: float, lever: Vector) -> None:
        self._longest_step = longest_step
        self._lever = lever
        self.q: Quaternion = IDENTITY
        """Rotation from the body to P."""
        self.restart()

    def restart(self) -> None:
        """Forget everything except the attitude, because time has jumped."""
        self.segment_start = math.inf
        """Time of the first snapshot of continuous history [s]."""
        self.t = -math.inf
        """Time of the newest gyroscope sample [s]."""
        self.C: Rows = rows_from_quaternion(self.q)
        self._C_before = self.C
        self._t_before = -math.inf
        self.rate: Vector = (0.0, 0.0, 0.0)
        """Newest angular rate, without bias [rad/s]."""
        self._pending: deque[tuple[float, Vector]] = deque(maxlen=MAX_PENDING)
        self._history: deque[IntegralSnapshot] = deque(maxlen=MAX_HISTORY)
        self._force: Vector = (0.0, 0.0, 0.0)  # newest, in P
        self._turns, self._angle = 0.0, 0.0
        self._rate_sum: Vector = (0.0, 0.0, 0.0)
        self._rate_square: Vector = (0.0, 0.0, 0.0)

    @property
    def newest(self) -> IntegralSnapshot | None:
        """The newest snapshot of the history."""
        return self._history[-1] if self._history else None

    def turn_body(self, q_old_from_new: Quaternion) -> None:
        """Apply a new definition of the body's axes. The sensor has not moved."""
        self.q = quaternion_product(self.q, q_old_from_new)
        self.C = rows_from_quaternion(self.q)

    def gyro(self, t: float, raw: Vector, bias: Vector) -> None:
        """Process an angular rate [rad/s] and its bias.

        Add the waiting accelerometer samples up to t to the history.
        """
        rate = (raw[0] - bias[0], raw[1] - bias[1], raw[2] - bias[2])
        dt = t - self.t
        if dt > self._longest_step:
            self.restart()
        elif dt > 0.0:
            k = 0.5 * dt
            x, y, z = self.rate
            rx, ry, rz = k * (x + rate[0]), k * (y + rate[1]), k * (z + rate[2])
            self._t_before, self._C_before = self.t, self.C
            self.q = quaternion_turned(self.q, rx, ry, rz)
            self.C = rows_from_quaternion(self.q)
            self._angle += math.sqrt(rx * rx + ry * ry + rz * rz)
        self.t = t
        self.rate = rate
        self._turns += 1.0
        p, q, r = raw
        x, y, z = self._rate_sum
        self._rate_sum = (x + p, y + q, z + r)
        x, y, z = self._rate_square
        self._rate_square = (x + p * p, y + q * q, z + r * r)
        while self._pending and self._pending[0][0] <= t:
            self._place(*self._pending.popleft())

    def accel(self, t: float, force: Vector) -> None:
        """Process a specific force [m/s^2]."""
        if t > self.t:
            self._pending.append((t, force))
        else:
            self._place(t, force)

    def _place(self, t: float, force: Vector) -> None:
        """Rotate an accelerometer sample into P with the attitude at its time, and add it to the
        history. C is interpolated linearly."""
        span = self.t - self._t_before
        part = (t - self._t_before) / span if 0.0 < span < math.inf else 1.0
        if part < 0.0:  # older than the last two gyroscope samples: too late to be placed
            return
        after, before = times(self.C, force), times(self._C_before, force)
        now = _between(before, after, part)
        C, D = self.C, self._C_before
        forward = _between((D[1], D[4], D[7]), (C[1], C[4], C[7]), part)
        right = _between((D[0], D[3], D[6]), (C[0], C[3], C[6]), part)
        arm = (0.0, 0.0, 0.0)
        if any(self._lever):
            arm = times(self.C, cross(self.rate, self._lever))
        x, y, z = force
        square = x * x + y * y + z * z
        history = self._history
        last = history[-1] if history else None
        dt = t - last.t if last is not None else math.inf
        if last is None or dt > self._longest_step:
            history.clear()
            self.segment_start = t
            total, n, body = (0.0, 0.0, 0.0), 1.0, force
        elif dt <= 0.0:
            return
        else:
            k = 0.5 * dt
            a, b, f = last.force, self._force, now
            total = (a[0] + k * (b[0] + f[0]), a[1] + k * (b[1] + f[1]), a[2] + k * (b[2] + f[2]))
            n, square = last.n + 1.0, last.square + square
            body = (last.body[0] + x, last.body[1] + y, last.body[2] + z)
        self._force = now
        history.append(
            IntegralSnapshot(
                t, total, forward, right, arm, self.rate[2], n, body, square,
                self._turns, self._rate_sum, self._rate_square, self._angle,
            )
        )  # fmt: skip
        while history[0].t < t - HISTORY_S:
            history.popleft()

    def at(self, t: float) -> IntegralSnapshot | None:
        """Return the interpolated integrals at time t [s]; None outside the history."""
        history = self._history
        if not history or t < history[0].t or t > history[-1].t:
            return None
        i = bisect.bisect_left(history, t, key=lambda snapshot: snapshot.t)
        b = history[i]
        if i == 0 or b.t == t:
            return b
        a = history[i - 1]
        part = (t - a.t) / (b.t - a.t)
        return b._replace(
            t=t,
            force=_between(a.force, b.force, part),
            forward=_between(a.forward, b.forward, part),
            right=_between(a.right, b.right, part),
            arm=_between(a.arm, b.arm, part),
            up_rate=a.up_rate + part * (b.up_rate - a.up_rate),
        )


def _between(a: Vector, b: Vector, part: float) -> Vector:
    return (
        a[0] + part * (b[0] - a[0]),
        a[1] + part * (b[1] - a[1]),
        a[2] + part * (b[2] - a[2]),
    )
