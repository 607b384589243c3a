"""How the delay between the inertial unit and the vehicle's own signals grows over a drive.

In stretches of a minute the delay is read off the cross-spectrum's phase: of the gyroscope's
vertical rate against the vehicle's yaw rate, and of the forward acceleration against the change of
speed. A line through the delays, weighted and robust, is the run-off; a delay that stays the same
has none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples, Series
from imucald.diagnosis.faults.fault import Array, Mask
from imucald.diagnosis.forward_mount import mount_of
from imucald.model.model import VehicleModel

Complex = NDArray[np.complex128]

RATE_HZ = 10.0
STRETCH_S = 64.0
LOWEST_HZ, HIGHEST_HZ = 0.04, 1.5
"""Below: slope of the road and drift of the sensors. Above: little motion."""
LONGEST_S = 3.0
"""Largest delay that is looked for."""
FEWEST_STRETCHES = 7
ALIKE = 0.4
"""Correlation that a stretch must have to tell a delay."""
GOOD_PPM = 8.0
"""With a run-off known so well the second pair of signals is not asked."""
CREEP, SCALE_SHARE = 1.3, 0.003
"""Delays of neighbouring stretches err alike; a run-off is not the same over a whole drive."""
ROBUST = 2.5
"""Residuals beyond this many spreads count less."""


@dataclass(frozen=True)
class RunOff:
    """Growth of the delay of the unit's stamps."""

    ppm: float
    std_ppm: float
    first_s: float
    """Delay at the drive's start and end, by the line."""
    last_s: float
    against: str


def run_off(samples: Samples, model: VehicleModel) -> RunOff | None:
    """Measure the run-off; None where the drive or its signals do not tell it."""
    R_vehicle_from_sensor = mount_of(model)
    best: RunOff | None = None
    if "gyro" in samples and "yaw_rate" in samples:
        up = _pair(samples["gyro"], R_vehicle_from_sensor[2], samples["yaw_rate"], False)
        best = None if up is None else _line(*up, "the yaw rate")
        if best is not None and best.std_ppm < GOOD_PPM:
            return best
    if "accel" in samples and "speed" in samples:
        ahead = _pair(samples["accel"], R_vehicle_from_sensor[0], samples["speed"], True)
        other = None if ahead is None else _line(*ahead, "the speed")
        if other is not None and (best is None or other.std_ppm < best.std_ppm):
            best = other
    return best


def _pair(
    unit: Series, axis: Array, vehicle: Series, differentiate: bool
) -> tuple[Array, Array, Array] | None:
    """Delays of the unit against the vehicle: middle [s], delay [s] and its std, per stretch."""
    start = max(unit.t[0], vehicle.t[0])
    n = int((min(unit.t[-1], vehicle.t[-1]) - start) * RATE_HZ)
    if n < FEWEST_STRETCHES * STRETCH_S * RATE_HZ:
        return None
    edges = start + np.arange(n + 1) / RATE_HZ
    y = _averages(unit.t, unit.values @ axis, edges)
    x = np.diff(np.interp(edges, vehicle.t, vehicle.values)) * RATE_HZ if differentiate else (
        _averages(vehicle.t, vehicle.values, edges)
    )  # fmt: skip
    return _delays(edges, y, x)


def _averages(t: Array, x: Array, edges: Array) -> Array:
    """Mean between edges: differences of the integral, so that true stamps count."""
    integral = np.concatenate(([0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))))
    result: Array = np.diff(np.interp(edges, t, integral)) / np.diff(edges)
    return result


def _delays(edges: Array, y: Array, x: Array) -> tuple[Array, Array, Array] | None:
    size = round(STRETCH_S * RATE_HZ)
    reach = round(LONGEST_S * RATE_HZ)
    window = np.hanning(size)
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(2 * size, 1.0 / RATE_HZ), dtype=np.float64)
    band = (omega >= 2.0 * np.pi * LOWEST_HZ) & (omega <= 2.0 * np.pi * HIGHEST_HZ)

    def spectrum(part: Array) -> Complex:
        spectra = np.fft.rfft(window * (part - part.mean()), 2 * size)
        return np.asarray(np.where(band, spectra, 0.0))

    found: list[tuple[float, float, float]] = []
    for i in range(reach, len(x) - size - reach, size):
        X = spectrum(x[i : i + size])
        lag = _coarse(spectrum(y[i : i + size]), X, reach)
        Y = spectrum(y[i + lag : i + lag + size])
        told = _fine(Y[band], X[band], omega[band])
        if told is not None:
            middle = edges[i] + 0.5 * STRETCH_S
            found.append((middle, lag / RATE_HZ + told[0], told[1]))
    if len(found) < FEWEST_STRETCHES:
        return None
    t, delay, std = np.array(found).T
    return t, delay, std


def _coarse(Y: Complex, X: Complex, reach: int) -> int:
    """Lag in rows by which the unit is late: the highest correlation within reach."""
    correlation = np.fft.irfft(Y * np.conj(X))
    near = np.concatenate((correlation[-reach:], correlation[: reach + 1]))
    return int(np.argmax(near)) - reach


def _fine(Y: Complex, X: Complex, omega: Array) -> tuple[float, float] | None:
    """What is left of the delay, from the phase, and its standard deviation."""
    cross = Y * np.conj(X)
    power_x, power_y = float(np.sum(np.abs(X) ** 2)), float(np.sum(np.abs(Y) ** 2))
    if power_x <= 0.0 or power_y <= 0.0:
        return None
    delay = 0.0
    for _ in range(3):
        turned = cross * np.exp(1j * omega * delay)
        curve = float(np.sum(omega**2 * turned.real))
        if curve <= 0.0:
            return None
        delay -= float(np.sum(omega * turned.imag)) / curve
    turned = cross * np.exp(1j * omega * delay)
    alike = float(np.sum(turned.real)) / math.sqrt(power_x * power_y)
    if alike < ALIKE or abs(delay) > 1.0 / RATE_HZ:
        return None
    gain = float(np.sum(turned.real)) / power_x
    noise = (power_y - gain**2 * power_x) / len(omega)
    # Neighbouring bins of the padded, windowed transform are not independent: factor 3.
    return delay, math.sqrt(3.0 * max(noise, 0.0) / (2.0 * gain * curve))


def _line(t: Array, delay: Array, std: Array, against: str) -> RunOff | None:
    """Weighted robust line; its std from the scatter of the delays about it."""
    middle = float(np.median(t))
    base = np.column_stack([np.ones(len(t)), t - middle])
    line, keep = _start(t - middle, delay), np.ones(len(t))
    weight, spread = keep, 1e-4
    for _ in range(8):
        residual = delay - base @ line
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        own = np.hypot(std, 0.7 * spread)
        keep = np.minimum(1.0, ROBUST / np.maximum(np.abs(residual) / own, 1e-9)) ** 2
        weight = keep / own**2
        line = np.linalg.solve(base.T @ (weight[:, None] * base), base.T @ (weight * delay))
    residual = delay - base @ line
    good: Mask = keep > 0.5
    if np.count_nonzero(good) < FEWEST_STRETCHES:
        return None
    chi2 = float(np.sum(weight * residual**2)) / max(float(np.sum(keep)) - 2.0, 1.0)
    covariance = np.linalg.inv(base.T @ (weight[:, None] * base)) * max(chi2, 1.0)
    first, last = (float(line[0] + line[1] * (when - middle)) for when in (t[0], t[-1]))
    slope, scatter = 1e6 * float(line[1]), 1e6 * math.sqrt(float(covariance[1, 1]))
    return RunOff(slope, math.hypot(CREEP * scatter, SCALE_SHARE * slope), first, last, against)


def _start(t: Array, delay: Array) -> Array:
    """Median of the slopes through all pairs of stretches (Theil and Sen)."""
    i, j = np.triu_indices(len(t), 1)
    slope = float(np.median((delay[j] - delay[i]) / (t[j] - t[i])))
    return np.array([float(np.median(delay - slope * t)), slope])
