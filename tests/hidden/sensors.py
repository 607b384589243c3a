"""What the sensors and the vehicle's bus say of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden.driver import Course
from hidden.motion import Motion
from hidden.numerics import Array, coloured_noise, lowpassed, stream
from hidden.vehicle import Handling
from hidden.world import Channel, Triad, World
from imucald.core.samples import Series

REFERENCE_DEGC = 25.0
VIBRATION_HZ = np.array([0.0, 3.0, 6.0, 12.0, 18.0, 27.0, 40.0, 60.0, 100.0])
VIBRATION_SHAPE = np.array([0.0, 0.05, 0.5, 1.0, 0.7, 1.2, 0.8, 0.5, 0.1])
"""Body and trim: hardly anything below the suspension's modes, peaks above."""
LONGEST_FREEZE_S, SHORTEST_FREEZE_S = 20.0, 3.0
LONGEST_BURST_S, SHORTEST_BURST_S = 2.0, 0.1
SPEED_DEAD_BAND = 0.3
WHEEL_DEAD_BAND = 0.4
SPEED_LSB = 0.01 / 3.6


@dataclass(frozen=True)
class Frames:
    """When a signal was sampled and stamped; index of the sample that each kept frame carries."""

    sampled: Array
    stamp: Array
    carried: np.ndarray[tuple[int], np.dtype[np.int64]]
    lost_share: float
    frozen_share: float


class Recorder:
    """Records every signal of one drive."""

    def __init__(
        self, world: World, course: Course, handling: Handling, motion: Motion, rate: float
    ) -> None:
        self.world, self.rate = world, rate
        self.course, self.handling, self.motion = course, handling, motion
        self.seconds = float(course.t[-1])
        self.realised: dict[str, float] = {}
        self.vibration = self._vibration()

    def record(self) -> dict[str, Series]:
        """Return every signal."""
        w, course, handling, motion = self.world, self.course, self.handling, self.motion
        yaw = (1.0 + w.yaw_scale) * motion.rate[:, 2] + w.yaw_offset
        side = (1.0 + w.lateral_scale) * motion.reference_force[:, 1] + w.lateral_offset
        front, rear = self._wheels()
        wheels = np.column_stack([*front, *rear])
        speed = 0.5 * (rear[0] + rear[1])
        return {
            "accel": self._triad("accel", w.accel, motion.force),
            "gyro": self._triad("gyro", w.gyro, motion.rate),
            "speed": self._rolling("speed", speed, w.speed_scale, 0.01, SPEED_DEAD_BAND),
            "wheel_speeds": self._rolling(
                "wheel_speeds", wheels, w.wheel_scale, 0.02, WHEEL_DEAD_BAND
            ),
            "steering": self._scalar(
                "steering", handling.hands + w.steering_offset, 0.0004, 1.745e-3
            ),
            "yaw_rate": self._scalar("yaw_rate", yaw, 0.001, 1.745e-4),
            "lateral_accel": self._scalar("lateral_accel", side, 0.03, 0.01),
            "longitudinal_accel": self._scalar(
                "longitudinal_accel", motion.reference_force[:, 0], 0.03, 0.01
            ),
            "reverse": self._flag("reverse", course.speed < 0.0),
            "brake": self._flag("brake", course.braking),
            "temperature": self._temperature(),
        }

    # motion -> signals -------------------------------------------------------------------

    def _wheels(self) -> tuple[list[Array], list[Array]]:
        """Ground speed along each wheel's own heading, with slip: front pair, rear pair."""
        w, v, r = self.world, self.course.speed, self.handling.yaw_rate
        force = self.motion.reference_force[:, 0] * np.sign(v)
        half = 0.5 * w.track
        ahead = self.handling.lateral_velocity + w.to_front * r
        cos, sin = np.cos(self.handling.steer), np.sin(self.handling.steer)
        driven = 1.0 + w.slip_per_mps2 * 2.0 * force
        braked = 1.0 + w.slip_per_mps2 * np.minimum(force, 0.0)
        front = [np.abs((v + s * half * r) * cos + ahead * sin) * driven for s in (-1.0, 1.0)]
        rear = [np.abs(v + s * half * r) * braked for s in (-1.0, 1.0)]
        return front, rear

    def _vibration(self) -> dict[str, Array]:
        """Vibration at the sensor, vehicle axes, by sensor; rough stretches shake more."""
        n, w = len(self.course.t), self.world
        speed = np.abs(self.course.speed)
        amount = np.sqrt(speed / 20.0)
        made = {}
        for name, triad in (("accel", w.accel), ("gyro", w.gyro)):
            rng = stream(w.seed, f"vibration:{name}")
            patches = np.exp(0.4 * np.interp(np.cumsum(speed) / self.rate, *_patches(w.seed)))
            columns = [
                rms * amount * patches
                * coloured_noise(rng, n, self.rate, VIBRATION_SHAPE, VIBRATION_HZ)
                for rms in triad.vibration
            ]  # fmt: skip
            made[name] = np.column_stack(columns)
        rpm_hz = np.where(speed < 1.0, 26.0, 25.0 + 22.0 * np.mod(speed, 7.0) / 7.0 + 0.3 * speed)
        phase = 2.0 * np.pi * (np.cumsum(rpm_hz) / self.rate + stream(w.seed, "engine").random())
        made["accel"] += w.engine * np.sin(phase)[:, None] * np.array([0.4, 0.5, 1.0])
        return made

    # sensors -----------------------------------------------------------------------------

    def _triad(self, name: str, triad: Triad, true: Array) -> Series:
        w, channel = self.world, self.world.channels[name]
        shaken = true + self.vibration[name]
        if channel.lowpass_hz is not None:
            shaken = lowpassed(shaken, self.rate, channel.lowpass_hz)
        frames = self._frames(name, channel, "imu")
        when = frames.sampled - channel.delay_s
        axes = self._mounted(_at(shaken, self.rate, when), when)
        xy, xz, yx, yz, zx, zy = triad.cross_axis
        x, y, z = ((1.0 + triad.scale) * axes).T
        mixed = [
            x + xy * axes[:, 1] + xz * axes[:, 2],
            y + yx * axes[:, 0] + yz * axes[:, 2],
            z + zx * axes[:, 0] + zy * axes[:, 1],
        ]
        values = np.column_stack(mixed) + triad.bias
        values += (self._degrees(when) - REFERENCE_DEGC)[:, None] * triad.bias_temperature
        if np.any(triad.g_sensitivity):
            force = lowpassed(self.motion.force, self.rate, channel.lowpass_hz or 40.0)
            values += triad.g_sensitivity * self._mounted(_at(force, self.rate, when), when)
        if np.any(triad.rectification):
            power = lowpassed(np.sum(self.vibration["accel"] ** 2, axis=1), self.rate, 2.0)
            values += triad.rectification * _at(power, self.rate, when)[:, None]
        rng = stream(w.seed, f"noise:{name}")
        walk = np.cumsum(rng.standard_normal(values.shape), axis=0)
        values += triad.walk / np.sqrt(channel.rate_hz) * walk
        values += (
            triad.noise_density * np.sqrt(0.5 * channel.rate_hz) * rng.standard_normal(values.shape)
        )
        return self._sent(name, channel, frames, values, triad.lsb)

    def _mounted(self, vectors: Array, t: Array) -> Array:
        """Vehicle axes (N, 3) to the axes that the sensor has at each time."""
        w = self.world
        result = vectors @ w.R_vehicle_from_sensor
        if w.shift_share is not None:
            after = t >= w.shift_share * self.seconds
            result[after] = vectors[after] @ (w.shift @ w.R_vehicle_from_sensor)
        return np.asarray(result)

    def _degrees(self, t: Array) -> Array:
        """Warm-up: the part soon, the cabin around it slowly."""
        w, warm = self.world, np.maximum(t, 0.0)
        rise = 0.4 * -np.expm1(-warm / 150.0) + 0.6 * -np.expm1(-warm / 900.0)
        result: Array = w.start_degc + w.rise_k * rise
        return result

    def _temperature(self) -> Series:
        channel = self.world.channels["temperature"]
        frames = self._frames("temperature", channel, "temperature")
        return self._sent("temperature", channel, frames, self._degrees(frames.sampled), 0.5)

    def _rolling(
        self, name: str, true: Array, scale: float | Array, noise: float, dead: float
    ) -> Series:
        channel = self.world.channels[name]
        frames = self._frames(name, channel, "speed")
        values = _at(true, self.rate, frames.sampled - channel.delay_s) * (1.0 + scale)
        rough = stream(self.world.seed, f"noise:{name}").standard_normal(values.shape)
        rolling = values >= dead
        values = np.where(rolling, np.maximum(values + noise * rough, 0.0), 0.0)
        return self._sent(name, channel, frames, values, SPEED_LSB)

    def _scalar(self, name: str, true: Array, noise: float, lsb: float) -> Series:
        channel = self.world.channels[name]
        if channel.lowpass_hz is not None:
            true = lowpassed(true, self.rate, channel.lowpass_hz)
        unit = "dynamics" if name != "steering" else name
        frames = self._frames(name, channel, unit)
        values = _at(true, self.rate, frames.sampled - channel.delay_s)
        values += noise * stream(self.world.seed, f"noise:{name}").standard_normal(len(values))
        return self._sent(name, channel, frames, values, lsb)

    def _flag(self, name: str, on: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Series:
        channel = self.world.channels[name]
        frames = self._frames(name, channel, name)
        values = _at(on.astype(float), self.rate, frames.sampled - channel.delay_s)
        return self._sent(name, channel, frames, values, 1.0)

    # the bus -----------------------------------------------------------------------------

    def _frames(self, name: str, channel: Channel, unit: str) -> Frames:
        """When frames come, which are lost, and which repeat an old value."""
        seed = self.world.seed
        period = (1.0 + 1e-6 * channel.cycle_ppm) / channel.rate_hz
        sampled = np.arange(stream(seed, f"phase:{unit}").random() * period, self.seconds, period)
        rng = stream(seed, f"bus:{unit}")
        late = channel.jitter_s * rng.exponential(1.0, len(sampled))
        stamp = np.maximum.accumulate(sampled + late)
        stamp *= 1.0 + 1e-6 * channel.stamps_ppm
        kept = stream(seed, f"loss:{name}").random(len(sampled)) >= channel.loss
        faults = stream(seed, f"faults:{name}")
        bursts = _stretches(faults, channel.lost_share * self.seconds, self.seconds,
                            SHORTEST_BURST_S, LONGEST_BURST_S)  # fmt: skip
        for start, stop in bursts:
            kept &= (sampled < start) | (sampled >= stop)
        carried = np.arange(len(sampled))
        frozen = _stretches(faults, channel.frozen_share * self.seconds, self.seconds,
                            SHORTEST_FREEZE_S, LONGEST_FREEZE_S)  # fmt: skip
        for start, stop in frozen:
            first, last = np.searchsorted(sampled, [start, stop])
            carried[first:last] = first
        stuck = float(np.mean(carried != np.arange(len(sampled))))
        return Frames(sampled, stamp[kept], carried[kept], 1.0 - float(np.mean(kept)), stuck)

    def _sent(
        self, name: str, channel: Channel, frames: Frames, values: Array, lsb: float
    ) -> Series:
        """Clip, quantise, lose and freeze."""
        rail = channel.full_scale
        if channel.clipped_share > 0.0:
            size = np.abs(values) if values.ndim == 1 else np.abs(values).max(axis=1)
            moving = _at(np.abs(self.course.speed), self.rate, frames.sampled) > 1.0
            rail = float(np.quantile(size[moving], 1.0 - channel.clipped_share))
            self.realised[f"{name}.full_scale"] = rail
        if rail is not None:
            values = np.clip(values, -rail, rail)
        values = np.rint(values / lsb) * lsb
        self.realised[f"{name}.loss"] = frames.lost_share
        self.realised[f"{name}.stuck_share"] = frames.frozen_share
        return Series(frames.stamp, values[frames.carried])


def _at(x: Array, rate: float, t: Array) -> Array:
    """Grid signal x (N,) or (N, k) at times t, linear between."""
    place = np.clip(t * rate, 0.0, len(x) - 1.001)
    i = place.astype(np.int64)
    u = place - i
    if x.ndim > 1:
        u = u[:, None]
    result: Array = x[i] + u * (x[i + 1] - x[i])
    return result


def _patches(seed: int) -> tuple[Array, Array]:
    """Distance nodes and log-roughness of the surface: asphalt changes every few hundred metres."""
    rng = stream(seed, "patches")
    at = np.cumsum(rng.exponential(300.0, 400))
    return at, rng.normal(0.0, 1.0, 400)


def _stretches(
    rng: np.random.Generator, total: float, seconds: float, shortest: float, longest: float
) -> list[tuple[float, float]]:
    """Draw stretches that do not meet, of `total` seconds together."""
    chosen: list[tuple[float, float]] = []
    left = total
    for _ in range(20_000):
        if left < 0.5 * shortest:
            break
        length = min(float(rng.uniform(shortest, longest)), max(left, shortest))
        start = float(rng.uniform(5.0, seconds - length - 5.0))
        if all(start > stop + 0.5 or start + length < begin - 0.5 for begin, stop in chosen):
            chosen.append((start, start + length))
            left -= length
    return sorted(chosen)
