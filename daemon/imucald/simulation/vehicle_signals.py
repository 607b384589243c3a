"""Signals of the vehicle's own bus: speed, wheels, steering, stability control, switches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.samples import (
    BRAKE,
    HEADING,
    LATERAL_ACCEL,
    LONGITUDINAL_ACCEL,
    REVERSE,
    SPEED,
    STEERING,
    TEMPERATURE,
    WHEEL_SPEEDS,
    YAW_RATE,
    Quantity,
    Series,
)
from imucald.model.model import VehicleModel
from imucald.model.sensors import Scalar, Speed, Transmission
from imucald.model.vehicle import STEERING_GEAR_S
from imucald.simulation.body import BodyAttitude, BodyMotion
from imucald.simulation.driver import Driving
from imucald.simulation.filters import butterworth, first_order, generator
from imucald.simulation.imu import Mounts, temperature_at, turned
from imucald.simulation.road import RoadAttitude
from imucald.simulation.single_track import VehicleResponse
from imucald.simulation.timing import at_times, frame_timing, quantised

SLIP_CYCLES_HZ = (5.0, 6.1, 4.3, 7.2)
"""Frequencies of the brake control cycles, one for each wheel [Hz]."""


class VehicleSignals:
    """Makes each signal of the vehicle from the vehicle's motion."""

    def __init__(
        self,
        model: VehicleModel,
        seed: int,
        driving: Driving,
        handling: VehicleResponse,
        body: BodyMotion,
    ) -> None:
        self._model, self._seed = model, seed
        self._driving, self._handling, self._body = driving, handling, body
        self._rate = model.grid_hz
        self._duration = float(driving.t[-1])

    def all(self) -> dict[str, Series]:
        """Return every signal of the model except heading and magnetometer."""
        t, driving, force = self._driving.t, self._driving, self._body.reference_force
        # The steering wheel is ahead of the road wheels by the lag of the steering gear.
        ahead = np.interp(t + STEERING_GEAR_S, t, self._handling.steer)
        makers: Mapping[Quantity, Callable[[], Series]] = {
            SPEED: self._speed,
            WHEEL_SPEEDS: self._wheel_speeds,
            STEERING: lambda: self._scalar(STEERING, ahead * self._model.chassis.steering_ratio),
            YAW_RATE: lambda: self._scalar(YAW_RATE, self._body.rate[2]),
            LATERAL_ACCEL: lambda: self._scalar(LATERAL_ACCEL, force[1]),
            LONGITUDINAL_ACCEL: lambda: self._scalar(LONGITUDINAL_ACCEL, force[0]),
            REVERSE: lambda: self._flag(REVERSE, driving.speed < 0.0),
            BRAKE: lambda: self._flag(BRAKE, driving.braking > 0.5),
            TEMPERATURE: self._temperature,
        }
        return {
            row.channel: make()
            for row, make in makers.items()
            if getattr(self._model, row.channel).enabled
        }

    def heading(self, heading: Array) -> Series:
        """Return the heading signal from the true heading, which is clockwise from north [rad] and
        not wrapped."""
        series = self._scalar(HEADING, heading)
        return Series(series.t, np.mod(series.values, 2.0 * np.pi))

    def magnetometer(
        self, heading: Array, road: RoadAttitude, body_attitude: BodyAttitude, mount: Mounts
    ) -> Series:
        """Return the magnetometer samples in sensor axes."""
        mag = self._model.mag
        x = mag.field_horizontal_t * np.cos(heading)
        y = mag.field_horizontal_t * np.sin(heading)
        z = np.full(len(heading), -mag.field_down_t)
        for pitch, roll in ((road.pitch, road.roll), (body_attitude.pitch, body_attitude.roll)):
            sp, cp, sr, cr = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
            x, z = cp * x - sp * z, sp * x + cp * z
            y, z = cr * y + sr * z, cr * z - sr * y
        timing = frame_timing(mag, "mag", self._seed, self._duration)
        when = timing.sampled - mag.delay_s
        body_axes = np.column_stack([at_times(c, self._rate, when) for c in (x, y, z)])
        values = turned(mount, when, body_axes) + np.array(mag.hard_iron_t)
        noise = generator(self._seed, "noise:mag").standard_normal(values.shape)
        return timing.series(quantised(values + mag.noise_t * noise, mag.lsb))

    def _sample(self, name: str, message: Transmission, *columns: Array) -> tuple[Any, ...]:
        """Return the time stamps, the rows whose values are in the frames, and the sampled columns.
        Lost frames are left out. The same row repeats while the signal is stuck."""
        timing = frame_timing(message, name, self._seed, self._duration)
        when = timing.sampled - message.delay_s
        if isinstance(message, Speed):
            when -= message.delay_rate * timing.sampled
        index = timing.source[timing.kept]
        _, first, which = np.unique(index, return_index=True, return_inverse=True)
        sampled = (at_times(column, self._rate, when)[index] for column in columns)
        return timing.stamp[timing.kept], first[which], *sampled

    def _noise(self, name: str, shape: tuple[int, ...], rms: float) -> NDArray[np.float64]:
        return rms * generator(self._seed, f"noise:{name}").standard_normal(shape)

    def _speed(self) -> Series:
        speed = self._model.speed
        grip = self._grip()
        true = np.abs(self._driving.speed) * 0.5 * (grip[2] + grip[3])
        if speed.time_constant_s > 0.0:
            true = first_order(true, self._rate, speed.time_constant_s)
        t, sent, v = self._sample("speed", speed, true)
        noise = self._noise("speed", v.shape, speed.noise_mps)
        values = _rolling(v, speed.scale, speed.dead_band_mps, speed.lsb, noise)
        return Series(t, values[sent])

    def _wheel_speeds(self) -> Series:
        wheels, chassis = self._model.wheel_speeds, self._model.chassis
        v, r, steer = self._driving.speed, self._handling.yaw_rate, self._handling.steer
        cross = self._handling.lateral_velocity + chassis.cg_to_front_m * r
        half = 0.5 * chassis.track_m * r
        force = self._body.reference_force[0] * np.where(v < 0.0, -1.0, 1.0)
        slip = wheels.slip_per_mps2
        braked, driven = 1.0 + slip * np.minimum(force, 0.0), 1.0 + slip * force
        cos, sin = np.cos(steer), np.sin(steer)
        true = [
            np.abs((v - half) * cos + cross * sin) * driven,
            np.abs((v + half) * cos + cross * sin) * driven,
            np.abs(v - half) * braked,
            np.abs(v + half) * braked,
        ]
        true = [x * grip for x, grip in zip(true, self._grip(), strict=True)]
        t, sent, *sampled = self._sample("wheel_speeds", wheels, *true)
        values = np.column_stack(sampled)
        noise = self._noise("wheel_speeds", values.shape, wheels.noise_mps)
        values = _rolling(values, np.array(wheels.scale), wheels.dead_band_mps, wheels.lsb, noise)
        return Series(t, values[sent])

    def _grip(self) -> list[Array | float]:
        """Return the factor on each wheel's speed: 1, and less than 1 in segments with wheel
        slip."""
        wheels, t = self._model.wheel_speeds, self._driving.t
        if not wheels.slip_events:
            return [1.0] * 4
        slipping = np.zeros(len(t))
        for event in wheels.slip_events:
            slipping[(t >= event.start_s) & (t < event.start_s + event.duration_s)] = 0.5
        waves = [1.0 + np.sin(2.0 * np.pi * hz * t) for hz in SLIP_CYCLES_HZ]
        return [1.0 - wheels.slip_event_size * slipping * wave for wave in waves]

    def _scalar(self, row: Quantity, signal: Array) -> Series:
        name = row.channel
        scalar: Scalar = getattr(self._model, name)
        if scalar.lowpass_hz is not None and scalar.lowpass_hz < 0.45 * self._rate:
            signal = butterworth(signal, self._rate, scalar.lowpass_hz)
        timing = frame_timing(scalar, name, self._seed, self._duration)
        values = at_times(signal, self._rate, timing.sampled - scalar.delay_s)
        values = (1.0 + scalar.scale) * values + scalar.offset
        values += self._noise(name, values.shape, scalar.noise)
        return timing.series(quantised(values, scalar.lsb))

    def _flag(self, row: Quantity, on: NDArray[np.bool_]) -> Series:
        message: Transmission = getattr(self._model, row.channel)
        t, _, values = self._sample(row.channel, message, on.astype(float))
        return Series(t, np.rint(values))

    def _temperature(self) -> Series:
        temperature = self._model.temperature
        timing = frame_timing(temperature, TEMPERATURE.channel, self._seed, self._duration)
        values = temperature_at(temperature, np.maximum(timing.sampled, 0.0))
        return timing.series(quantised(values, temperature.lsb))


def _rolling(
    v: Array, scale: float | Array, dead_band: float, lsb: float, noise: Array
) -> NDArray[np.float64]:
    """Make a speed signal: apply scale error, noise while rolling, dead band and rounding. The
    result is never negative."""
    shown = np.maximum(v * (1.0 + scale) + noise, 0.0)
    return quantised(np.where(v * (1.0 + scale) < max(dead_band, 1e-3), 0.0, shown), lsb)
