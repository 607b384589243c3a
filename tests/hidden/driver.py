"""The driver: a random sequence of manoeuvres in time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hidden.numerics import Array, running_mean, slow_noise

SHIFT_SPEEDS = (4.5, 9.0, 14.0, 19.5)
"""Speeds [m/s] at which a gear is changed; the vehicle then hardly gains for half a second."""
FOOT_WINDOW_S = 0.35
HANDS_WINDOW_S = 0.25
TIGHTEST = 0.19
"""[1/m] No passenger car turns tighter."""


@dataclass(frozen=True)
class Course:
    """What the driver wants, on regular times; (N,) each."""

    t: Array
    speed: Array
    """Signed [m/s]."""
    curvature: Array
    """Of the intended path [1/m], positive to the left."""
    braking: NDArray[np.bool_]


@dataclass
class Script:
    """Manoeuvres written down so far: nodes of speed in time, and pieces of curvature."""

    rng: np.random.Generator
    style: float
    t: float = 0.0
    v: float = 0.0
    nodes: list[tuple[float, float]] = field(default_factory=list)
    bends: list[tuple[float, float, float, float]] = field(default_factory=list)
    """start, stop, curvature, time to wind on or off."""

    def __post_init__(self) -> None:
        self.nodes.append((0.0, self.v))

    def hold(self, seconds: float) -> None:
        """Go on at the same speed."""
        self.t += seconds
        self.nodes.append((self.t, self.v))

    def to(self, v: float, rate: float) -> None:
        """Change speed to v at about `rate` [m/s^2], with gear changes on the way up."""
        if v > self.v >= 0.0:
            for shift in SHIFT_SPEEDS:
                if self.v < shift < v - 1.0:
                    self._ramp(shift, rate)
                    self._ramp(shift + 0.1, 0.2)
        self._ramp(v, rate)

    def _ramp(self, v: float, rate: float) -> None:
        # The engine's force fades with speed.
        rate /= 1.0 + max(self.v, 0.0) / 40.0 if v > self.v else 1.0
        self.hold_to(v, abs(v - self.v) / max(rate, 0.05))

    def hold_to(self, v: float, seconds: float) -> None:
        """Reach speed v after `seconds`."""
        self.t += seconds
        self.v = v
        self.nodes.append((self.t, v))

    def bend(self, radius: float, angle: float) -> None:
        """Turn by `angle` [rad] (positive to the left) on a radius, at the present speed."""
        v = max(abs(self.v), 0.5)
        wind = min(1.6, max(0.5, 0.3 * abs(angle) * radius / v))
        seconds = abs(angle) * radius / v
        self.bends.append((self.t, self.t + seconds + wind, np.sign(angle) / radius, wind))
        self.hold(seconds + wind)

    def uniform(self, low: float, high: float) -> float:
        """Draw evenly."""
        return float(self.rng.uniform(low, high))

    def side(self) -> float:
        """Left or right."""
        return 1.0 if self.rng.random() < 0.5 else -1.0

    def launch_rate(self) -> float:
        """How quickly this driver pulls away."""
        return self.style * self.uniform(0.8, 2.2)

    def brake_rate(self) -> float:
        """How hard this driver brakes."""
        return self.style * self.uniform(0.8, 2.5)

    def stop(self) -> None:
        """Brake to rest, the last metre gently, and wait."""
        if self.v > 3.0:
            self.to(2.2, self.brake_rate())
        self.to(0.0, self.uniform(0.7, 1.4))
        self.hold(float(np.clip(self.rng.lognormal(2.6, 0.6), 2.5, 70.0)))


def _corner(s: Script, cruise: float) -> None:
    radius = s.uniform(8.0, 17.0)
    s.to(min(np.sqrt(s.style * s.uniform(1.6, 3.2) * radius), cruise), s.brake_rate())
    s.bend(radius, s.side() * s.uniform(1.2, 1.75))
    s.to(cruise, s.launch_rate())


def _roundabout(s: Script, cruise: float) -> None:
    radius = s.uniform(12.0, 20.0)
    s.to(np.sqrt(s.style * s.uniform(1.8, 3.2) * radius), s.brake_rate())
    s.bend(1.3 * radius, -s.uniform(0.5, 0.9))
    s.bend(radius, s.uniform(1.2, 4.6))
    s.bend(1.3 * radius, -s.uniform(0.5, 0.9))
    s.to(cruise, s.launch_rate())


def _lane_change(s: Script) -> None:
    seconds, side = s.uniform(1.6, 3.2), s.side()
    width = s.uniform(2.8, 3.8)
    curvature = width / (max(s.v, 6.0) * seconds) ** 2 * 2.0
    for way in (side, -side):
        s.bends.append((s.t, s.t + seconds, way * curvature, 0.45 * seconds))
        s.hold(seconds)


def _reverse(s: Script) -> None:
    s.stop()
    back = -s.uniform(1.0, 2.2)
    s.to(back, s.uniform(0.5, 1.0))
    s.bend(s.uniform(6.0, 10.0), s.side() * s.uniform(0.5, 1.4))
    s.hold(s.uniform(0.5, 2.0))
    s.to(0.0, s.uniform(0.6, 1.2))
    s.hold(s.uniform(2.0, 5.0))


def _city(s: Script, until: float) -> None:
    while s.t < until:
        cruise = s.uniform(8.0, 14.5)
        s.to(cruise, s.launch_rate() if cruise > s.v else s.brake_rate())
        s.hold(s.uniform(5.0, 26.0))
        kind = s.rng.choice(6, p=[0.27, 0.30, 0.13, 0.12, 0.14, 0.04])
        if kind == 0:
            s.stop()
        elif kind == 1:
            _corner(s, cruise)
        elif kind == 2:
            _roundabout(s, cruise)
        elif kind == 3:
            _lane_change(s)
        elif kind == 4:
            s.to(s.uniform(3.0, 7.0), s.brake_rate())
            s.hold(s.uniform(2.0, 9.0))
        else:
            _reverse(s)


def _country(s: Script, until: float) -> None:
    while s.t < until:
        cruise = s.uniform(16.0, 25.0)
        s.to(cruise, s.launch_rate() if cruise > s.v else 0.7 * s.brake_rate())
        s.hold(s.uniform(6.0, 30.0))
        for _ in range(int(s.rng.integers(1, 4))):
            speed = s.v * s.uniform(0.65, 1.0)
            s.to(max(speed, 9.0), s.uniform(0.5, 1.6))
            radius = s.v**2 / (s.style * s.uniform(0.8, 3.4))
            s.bend(radius, s.side() * s.uniform(0.25, 1.2))
            s.hold(s.uniform(1.0, 9.0))
            s.to(min(s.v / s.uniform(0.75, 1.0), 27.0), s.uniform(0.4, 1.2))
        if s.rng.random() < 0.25:
            s.stop()
        elif s.rng.random() < 0.3:
            _roundabout(s, cruise)


def _motorway(s: Script, until: float) -> None:
    s.to(s.uniform(11.0, 14.0), s.launch_rate() if s.v < 11.0 else s.brake_rate())
    s.bend(s.v**2 / (s.style * s.uniform(1.8, 3.3)), s.side() * s.uniform(1.5, 4.2))
    while s.t < until:
        s.to(s.uniform(24.0, 34.0), s.style * s.uniform(0.5, 1.4))
        s.hold(s.uniform(10.0, 45.0))
        if s.rng.random() < 0.5:
            _lane_change(s)
        else:
            s.bend(s.v**2 / s.uniform(0.5, 1.6), s.side() * s.uniform(0.1, 0.5))
        if s.rng.random() < 0.25:
            s.to(s.v * s.uniform(0.55, 0.85), s.brake_rate())
    s.to(s.uniform(12.0, 15.0), 0.6 * s.brake_rate())
    s.bend(s.v**2 / (s.style * s.uniform(1.8, 3.3)), s.side() * s.uniform(1.0, 3.0))


def drive_course(rng: np.random.Generator, seconds: float, rate: float) -> Course:
    """Draw a drive of `seconds` and return it on a grid of `rate` [Hz]."""
    script = Script(rng, style=float(rng.uniform(0.6, 1.0)))
    script.hold(script.uniform(4.0, 25.0))
    parts = [(_city, 330.0), (_country, 240.0), (_motorway, 260.0)]
    order = [0, 1, 2] if rng.random() < 0.7 else [0, 2, 1]
    while script.t < seconds - 40.0:
        for part in order:
            drive, usual = parts[part]
            left = seconds - 40.0 - script.t
            if left > 0.0:
                drive(script, script.t + min(left, script.uniform(0.7, 1.3) * usual))
    script.stop()
    script.hold(max(0.0, seconds - script.t) + 10.0)
    return _course(script, seconds, rate)


def _course(script: Script, seconds: float, rate: float) -> Course:
    rng = script.rng
    t = np.arange(round(seconds * rate) + 1) / rate
    node_t, node_v = np.array(script.nodes).T
    wanted = np.interp(t, node_t, node_v)
    # Nobody holds a speed exactly; the wander goes to zero where the vehicle is slow.
    wander = 0.025 * slow_noise(rng, t, 0.25, 0.02) * np.clip((wanted - 3.0) / 6.0, 0.0, 1.0)
    speed = running_mean(wanted * (1.0 + wander), round(FOOT_WINDOW_S * rate))
    speed[np.abs(speed) < 1e-6] = 0.0
    curvature = np.zeros(len(t))
    for start, stop, value, wind in script.bends:
        first, last = np.searchsorted(t, [start, stop])
        inside = t[first:last]
        ramp = np.minimum((inside - start) / wind, (stop - inside) / wind)
        curvature[first:last] += value * np.clip(ramp, 0.0, 1.0)
    curvature = running_mean(curvature, round(HANDS_WINDOW_S * rate))
    small = slow_noise(rng, t, 0.6, 0.03) * 0.09 / np.maximum(speed**2, 49.0)
    curvature += small * np.clip(np.abs(speed) / 2.0, 0.0, 1.0)
    braking = np.gradient(np.abs(speed)) * rate < -0.35
    braking |= (speed == 0.0) & (t > 1.0)
    return Course(t, speed, np.clip(curvature, -TIGHTEST, TIGHTEST), braking)
