"""Samples of the inertial sensor, with vibration, bandwidth, mount, errors and sampling.

Processing chain of a three-axis sensor: motion in body axes and vibration -> low-pass filter ->
sampling (with delay) -> rotation into sensor axes -> scale and cross-axis error -> bias
(temperature, walk) and noise -> clipping -> quantisation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, rotation_from_angles
from imucald.core.samples import Series
from imucald.model.model import VehicleModel
from imucald.model.sensors import REFERENCE_DEGC, Temperature, TriaxialSensor
from imucald.model.vehicle import Mount
from imucald.simulation.body import BodyMotion
from imucald.simulation.driver import SHIFT_SPEEDS_MPS
from imucald.simulation.filters import butterworth, filtered, generator
from imucald.simulation.timing import Timing, at_times, frame_timing, quantised

REFERENCE_SPEED_MPS = 20.0
VIBRATION_CORNER_HZ = 2.0
"""Frequency above which the body vibration is white [Hz]. Below this frequency, the vibration
decreases."""
IDLE_HZ = 26.0
"""Frequency of the second engine order of a four-cylinder engine that idles at 780 1/min [Hz]."""
GEAR_HZ_PER_MPS = (9.0, 5.5, 3.9, 2.9, 2.1)

Mounts = Sequence[tuple[float, Matrix3]]
"""Pairs of a start time [s] and the R_vehicle_from_sensor that is valid from this time on. The
pairs are in order of time, and the first time is 0."""


def mounts(mount: Mount) -> list[tuple[float, Matrix3]]:
    """Return the mount at the start and after each shift. A shift is a rotation about the vehicle
    axes."""

    def rotation(part: object) -> Matrix3:
        angles = (float(getattr(part, f"{name}_deg")) for name in ("roll", "pitch", "yaw"))
        return rotation_from_angles(*(math.radians(angle) for angle in angles))

    R = rotation(mount)
    result = [(0.0, R)]
    for shift in mount.shifts:
        R = rotation(shift) @ R
        result.append((shift.t_s, R))
    return result


def temperature_at(temperature: Temperature, t: Array) -> Array:
    """Return the sensor temperature [degC] at times t [s]: a first-order warm-up."""
    rise = -np.expm1(-t / temperature.time_constant_s)
    result: Array = temperature.start_degc + temperature.rise_k * rise
    return result


def accel_series(
    model: VehicleModel, mount: Mounts, body: BodyMotion, speed: Array, seed: int
) -> Series:
    """Return accelerometer samples of a moving body. The body's motion and speed (N,) [m/s] are at
    the model's `grid_hz`."""
    accel, rate = model.accel, model.grid_hz
    shaken = list(body.force)
    if accel.vibration:
        rng = generator(seed, "vibration:accel")
        amount = np.sqrt(np.abs(speed) / REFERENCE_SPEED_MPS)
        engine = accel.engine_mps2 * _engine(speed, rate, float(rng.random()))
        for i, rms in enumerate(accel.vibration_mps2):
            shaken[i] = shaken[i] + rms * amount * _rumble(rng, len(speed), rate)
            shaken[i] += engine if i == 2 else 0.5 * engine
    timing = frame_timing(accel, "accel", seed, (len(speed) - 1) / rate)
    values = _sampled(accel, shaken, timing, rate)
    values = turned(mount, timing.sampled - accel.delay_s, values)
    return _finished(accel, "accel", model.temperature, timing, values, seed)


def gyro_series(
    model: VehicleModel, mount: Mounts, body: BodyMotion, speed: Array, seed: int
) -> Series:
    """Return gyroscope samples of a moving body, like `accel_series`. The force of the body is used
    for the g-sensitivity."""
    gyro, rate = model.gyro, model.grid_hz
    shaken = list(body.rate)
    if gyro.vibration and gyro.vibration_radps > 0.0:
        rng = generator(seed, "vibration:gyro")
        amount = gyro.vibration_radps * np.sqrt(np.abs(speed) / REFERENCE_SPEED_MPS)
        shaken = [x + amount * _rumble(rng, len(speed), rate) for x in shaken]
    timing = frame_timing(gyro, "gyro", seed, (len(speed) - 1) / rate)
    when = timing.sampled - gyro.delay_s
    values = turned(mount, when, _sampled(gyro, shaken, timing, rate))
    if any(gyro.g_sensitivity):
        felt = turned(mount, when, _sampled(gyro, list(body.force), timing, rate))
        values += np.array(gyro.g_sensitivity) * felt
    return _finished(gyro, "gyro", model.temperature, timing, values, seed)


def _sampled(
    triad: TriaxialSensor, axes: list[Array], timing: Timing, rate: float
) -> NDArray[np.float64]:
    if triad.lowpass_hz is not None and triad.lowpass_hz < 0.45 * rate:
        axes = [butterworth(x, rate, triad.lowpass_hz) for x in axes]
    when = timing.sampled - triad.delay_s
    return np.column_stack([at_times(x, rate, when) for x in axes])


def turned(mount: Mounts, t: Array, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (N, 3) in body axes rotated into the sensor's axes at each time."""
    result = np.empty_like(vectors)
    bounds = [0, *np.searchsorted(t, [start for start, _ in mount[1:]]).tolist(), len(t)]
    for (_, R_vehicle_from_sensor), first, stop in zip(mount, bounds, bounds[1:], strict=False):
        result[first:stop] = vectors[first:stop] @ R_vehicle_from_sensor
    return result


def gain_matrix(triad: TriaxialSensor) -> NDArray[np.float64]:
    """Return the gains and cross-axis terms of a sensor (3, 3), in sensor axes."""
    xy, xz, yx, yz, zx, zy = triad.cross_axis
    sx, sy, sz = triad.scale
    return np.array([[1 + sx, xy, xz], [yx, 1 + sy, yz], [zx, zy, 1 + sz]])


def _finished(
    triad: TriaxialSensor,
    name: str,
    temperature: Temperature,
    timing: Timing,
    true_values: NDArray[np.float64],
    seed: int,
) -> Series:
    values = true_values @ gain_matrix(triad).T + np.array(triad.bias)
    if any(triad.bias_temperature):
        above_reference = temperature_at(temperature, timing.sampled) - REFERENCE_DEGC
        values += above_reference[:, None] * np.array(triad.bias_temperature)
    if triad.bias_walk > 0.0:
        steps = generator(seed, f"walk:{name}").standard_normal(values.shape)
        values += np.cumsum(steps, axis=0) * (triad.bias_walk / math.sqrt(triad.rate_hz))
    if triad.noise_density > 0.0:
        noise = generator(seed, f"noise:{name}").standard_normal(values.shape)
        values += noise * (triad.noise_density * math.sqrt(0.5 * triad.rate_hz))
    if triad.full_scale is not None:
        np.clip(values, -triad.full_scale, triad.full_scale, out=values)
    return timing.series(quantised(values, triad.lsb))


def _rumble(rng: np.random.Generator, n: int, rate: float) -> Array:
    """Return noise with rms 1, high-pass filtered (first order) at the corner frequency of
    structure-borne vibration."""
    c = math.exp(-2.0 * math.pi * VIBRATION_CORNER_HZ / rate)
    # For unit white noise, a first difference with the same pole has the variance 2 / (1 + c).
    gain = math.sqrt(0.5 * (1.0 + c))
    return filtered([gain, -gain], [1.0, -c], rng.standard_normal(n), settled=False)


def _engine(speed: Array, rate: float, phase: float) -> Array:
    """Return a sine of the second engine order. The frequency is the idle frequency at rest, and
    depends on speed and gear in motion."""
    v = np.abs(speed)
    per_mps = np.array(GEAR_HZ_PER_MPS)[np.searchsorted(SHIFT_SPEEDS_MPS, v)]
    frequency = np.maximum(IDLE_HZ, per_mps * v)
    result: Array = np.sin(2.0 * np.pi * (phase + np.cumsum(frequency) / rate))
    return result
