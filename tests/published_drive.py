"""A small drive with known truth for the tests of the published solver.

It shares no code with what is tested beyond the tick contract: motion is written down as v(t) and
r(t), specific force follows from it in vehicle axes, and the mount rotates it into sensor axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples

G = 9.80665


@dataclass
class Drive:
    """What a drive is made of; arrays come from `samples`."""

    minutes: float = 10.0
    seed: int = 0
    mount: Rotation = field(default_factory=Rotation.identity)
    imu_rate: float = 100.0
    speed_rate: float = 10.0
    speed_step: float = 0.028
    speed_delay: float = 0.1
    slope_deg: float = 1.3
    bias: float = 0.04
    noise: float = 0.3
    stops: bool = True
    turns: bool = True
    circles: bool = False

    def motion(self) -> tuple[np.ndarray, ...]:
        """t, speed, yaw rate at the IMU's rate; speed follows a trapezoid plan, smoothed."""
        rng = np.random.default_rng(self.seed)
        n = int(self.minutes * 60 * self.imu_rate)
        dt = 1.0 / self.imu_rate
        a = np.zeros(n)
        r = np.zeros(n)
        v, i = 0.0, 0

        def put(seconds: float, accel: float, rate: float = 0.0) -> None:
            nonlocal i, v
            m = min(int(seconds / dt), n - i)
            a[i : i + m] = accel
            r[i : i + m] = rate
            v += accel * m * dt
            i += m

        put(4.0, 0.0)
        if self.circles:
            put(5.0, 0.6, 0.0)
            put(1e9, 0.0, 0.35)
        while i < n:
            top = rng.uniform(8.0, 20.0)
            up = rng.uniform(0.8, 2.2)
            put((top - v) / up if top > v else 0.0, up)
            put(rng.uniform(3, 15), 0.0)
            if self.turns:
                low = rng.uniform(4.0, 7.0)
                down = rng.uniform(1.0, 2.5)
                put(max(v - low, 0.0) / down, -down)
                side = rng.choice([-1.0, 1.0])
                rate = rng.uniform(0.15, 0.4)
                put(1.4 / rate, 0.0, side * rate)
            if self.stops and rng.random() < 0.5:
                down = rng.uniform(1.0, 3.0)
                put(v / down, -down)
                v = 0.0
                put(rng.uniform(4, 20), 0.0)
        kernel = np.hanning(int(0.8 / dt))
        kernel /= kernel.sum()
        a = np.convolve(a, kernel, "same")
        r = np.convolve(r, kernel, "same")
        speed = np.maximum(np.cumsum(a) * dt, 0.0)
        a = np.gradient(speed, dt)
        r = r * (speed > 0.2)
        return np.arange(n) * dt, speed, a, r

    def samples(self, *leave_out: str) -> dict[str, Series]:
        """All channels, without those named."""
        t, v, a, r = self.motion()
        rng = np.random.default_rng(self.seed + 1000)
        distance = np.cumsum(v) / self.imu_rate

        def road(scale: float) -> np.ndarray:
            knots = np.arange(0, distance[-1] + 400.0, 120.0)
            values = rng.normal(0.0, np.radians(scale), len(knots))
            return np.interp(distance, knots, values)

        grade, bank = road(self.slope_deg), road(0.7 * self.slope_deg)
        moving = np.minimum(v / 10.0, 1.0)
        f = np.column_stack([a + G * grade, v * r + G * bank, np.full(len(t), G)])
        f[:, 0] -= G * np.radians(0.6) * -a  # squat tilts gravity into x
        f[:, 1] += G * np.radians(0.7) * v * r / 2.0
        f += rng.normal(0.0, 1.0, f.shape) * (0.02 + self.noise * moving[:, None])
        w = np.column_stack([np.zeros(len(t)), np.zeros(len(t)), r])
        w += rng.normal(0.0, 0.002, w.shape) * (1.0 + 5.0 * moving[:, None])
        bias = rng.normal(0.0, self.bias, 3)
        every = round(self.imu_rate / self.speed_rate)
        ts, vs = t[::every] + self.speed_delay, v[::every]
        if self.speed_step:
            vs = np.round(vs / self.speed_step) * self.speed_step
        inside = ts < t[-1]
        out = {
            "accel": Series(t, self.mount.inv().apply(f) + bias),
            "gyro": Series(t, self.mount.inv().apply(w) + rng.normal(0.0, 0.005, 3)),
            "speed": Series(ts[inside], vs[inside]),
            "steering": Series(ts[inside], (15.5 * 2.7 * r / np.maximum(v, 1.0))[::every][inside]),
            "brake": Series(ts[inside], (a < -0.3).astype(float)[::every][inside]),
            "yaw_rate": Series(t[::every], r[::every] + 0.004),
        }
        return {name: s for name, s in out.items() if name not in leave_out}

    def ticks(self, *leave_out: str) -> list[list[float]]:
        """The drive as ticks."""
        rows = ticks_from_samples(self.samples(*leave_out), 0, int(self.minutes * 600))
        return rows.tolist()


def mount_error_deg(R_estimate: np.ndarray, mount: Rotation) -> np.ndarray:
    """Rotation-vector error about vehicle axes [deg]: R_true = exp(e) R_estimate; (3,)."""
    return np.degrees((mount * Rotation.from_matrix(R_estimate).inv()).as_rotvec())
