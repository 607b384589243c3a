"""Method B (CN109506674B), claims 1 to 3, instant by instant, in plain numpy.

Axes: x right, y forward, z up. The claims name the axes x (pitch) and y (roll) and print no formula
for the deflections S; here they are measured on a body that is built for it: *reconstructed*.
"""

from __future__ import annotations

import math

import numpy as np

G = 9.80665


def pitched(angle):
    """Body to level, nose up by angle."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def deflection(angle, acceleration, subtracted):
    """S: by how much an angle is wrong that is found after subtracting along a deflected axis.

    A body nose up by `angle` is accelerated horizontally; its accelerometer feels gravity and
    that; `subtracted` is taken off its own axis, and the angle of the rest is read.
    """
    felt = pitched(angle).T @ np.array([0.0, acceleration, G])
    return math.remainder(math.atan2(felt[1] - subtracted, felt[2]) - angle, 2.0 * math.pi)


class AverageSpeed:
    """Speed now, and its mean over the last `seconds`."""

    def __init__(self, seconds, delay=0.0):
        self.seconds, self.delay = seconds, delay
        self.heard = []

    def add(self, t, speed):
        self.heard.append((t, speed))
        last = [one for one in self.heard if one[0] >= t - self.seconds]
        mean_t, mean_v = np.mean(last, axis=0)
        return float(mean_t) - self.delay, float(mean_v)


class Correction:
    """Claims 1 to 3.

    average, interval, timeout: as the package's settings; plane: rate times speed as one number;
    horizontal: the speed is that over the map, so the whole angle deflects.
    """

    def __init__(self, average=0.2, interval=1.0, timeout=3.0, delay=0.0, plane=False,
                 horizontal=False, road_time=3.0, zero_error=(0.0, 0.0, 0.0)):  # fmt: skip
        self.average = AverageSpeed(average, delay)
        self.interval, self.timeout = interval, timeout
        self.plane, self.horizontal, self.road_time = plane, horizontal, road_time
        self.zero_error = np.array(zero_error)
        self.averages = []
        self.now = None
        self.before = None  # (t, pitch, roll), corrected
        self.road = (0.0, 0.0)

    def speed(self, t, v):
        """Claim 1: current speed and average speed."""
        self.now = (t, v)
        one = self.average.add(t, v)
        if self.averages and one[0] <= self.averages[-1][0]:
            return
        if self.averages and one[0] - self.averages[-1][0] > self.timeout:
            self.averages = []
        self.averages.append(one)

    def forward(self):
        """Claim 1: acceleration of the motion from the average speed, over >= `interval`."""
        last = self.averages[-1]
        older = [one for one in self.averages[:-1] if last[0] - one[0] >= self.interval]
        first = older[-1] if older else self.averages[0]
        return (last[1] - first[1]) / (last[0] - first[0])

    def take(self, t, force, rate):
        """One instant: corrected force (3,), rate (3,), (phi, theta), (J, K)."""
        rate = np.asarray(rate) - self.zero_error  # claim 1: the rate less its zero error
        known = self.now is not None and t - self.now[0] <= self.timeout and len(self.averages) > 1
        a, v = (self.forward(), self.now[1]) if known else (0.0, 0.0)
        centripetal = np.cross(rate, [0.0, v, 0.0])  # from rates and the *current* speed
        if self.plane:
            centripetal[2] = 0.0
        rest = np.asarray(force) - [0.0, a, 0.0] - centripetal
        phi = math.atan2(rest[1], math.hypot(rest[0], rest[2]))
        theta = math.atan2(-rest[0], rest[2])
        J, K = self.less_deflection(t, phi, theta, a, centripetal[0])
        self.before = (t, J, K)
        return rest, rate, (phi, theta), (J, K)

    def less_deflection(self, t, phi, theta, a, right):
        """Claims 2 and 3: from the angle of the instant before."""
        if self.before is None:
            self.road = (phi, theta)
            return phi, theta
        t0, pitch, roll = self.before
        if not self.horizontal:
            part = 1.0 - math.exp(-max(t - t0, 0.0) / self.road_time)
            old = self.road
            self.road = old[0] + part * (pitch - old[0]), old[1] + part * (roll - old[1])
            pitch, roll = pitch - self.road[0], roll - self.road[1]
        J = phi - deflection(pitch, a, a)
        # a roll to the right points the right axis down: the deflection's mirror image
        K = theta + deflection(-roll, right / math.cos(roll), right) if self.plane else theta
        return J, K
