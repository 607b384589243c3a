"""Small numerical tools: random streams, lengths, spectra, rotations."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""


def stream(seed: int, name: str) -> np.random.Generator:
    """Random numbers of one purpose: another purpose's draws do not move them."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def fast_length(n: int) -> int:
    """Smallest number >= n with no prime factor above 5, for which a Fourier transform is quick."""
    best = 1 << (n - 1).bit_length()
    five = 1
    while five < best:
        three = five
        while three < best:
            two = three
            while two < n:
                two *= 2
            best = min(best, two)
            three *= 3
        five *= 5
    return best


def lowpassed(x: Array, rate: float, cutoff_hz: float) -> Array:
    """Second-order Butterworth low-pass, as its analogue transfer function; x (N, ...)."""
    n = len(x)
    lead = int(4.0 * rate / cutoff_hz) + 1
    size = fast_length(n + 2 * lead)
    shape = (size, *x.shape[1:])
    padded = np.empty(shape)
    padded[:lead], padded[lead : lead + n] = x[0], x
    # The way back to the start is a ramp: a step would ring into the first samples.
    back = np.linspace(1.0, 0.0, size - lead - n).reshape(-1, *([1] * (x.ndim - 1)))
    padded[lead + n :] = back * x[-1] + (1.0 - back) * x[0]
    s = 1j * np.fft.rfftfreq(size, 1.0 / rate) / cutoff_hz
    response = 1.0 / (1.0 + np.sqrt(2.0) * s + s * s)
    spectrum = np.fft.rfft(padded, axis=0) * response.reshape(-1, *([1] * (x.ndim - 1)))
    return np.asarray(np.fft.irfft(spectrum, size, axis=0)[lead : lead + n])


def running_mean(x: Array, window: int) -> Array:
    """Mean over `window` samples, twice, zero phase."""
    window |= 1
    for _ in range(2):
        half = window // 2
        total = np.cumsum(np.concatenate([np.full(half + 1, x[0]), x, np.full(half, x[-1])]))
        x = (total[window:] - total[:-window]) / window
    return x


def slow_noise(rng: np.random.Generator, t: Array, fastest_hz: float, slowest_hz: float) -> Array:
    """Unit-rms noise: sinusoids with frequencies spread evenly on a log scale."""
    total = np.zeros(len(t))
    edges = np.geomspace(slowest_hz, fastest_hz, 25)
    for f in rng.uniform(edges[:-1], edges[1:]):
        total += np.sin(2.0 * np.pi * (f * t + rng.random()))
    return np.asarray(total * np.sqrt(2.0 / (len(edges) - 1)))


def coloured_noise(rng: np.random.Generator, n: int, rate: float, shape: Array, f: Array) -> Array:
    """Unit-rms noise (n,) whose amplitude spectrum is `shape` at frequencies `f` [Hz]."""
    size = fast_length(n)
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    amplitude = np.interp(frequency, f, shape)
    phase = np.exp(2j * np.pi * rng.random(len(frequency)))
    x = np.fft.irfft(amplitude * phase, size)[:n]
    return np.asarray(x / np.sqrt(np.mean(x * x)))


def rotation_z(a: Array) -> Array:
    """Rotations (N, 3, 3) about z by angles (N,)."""
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    return np.stack([c, -s, o, s, c, o, o, o, i], -1).reshape(*a.shape, 3, 3)


def rotation_y(a: Array) -> Array:
    """Rotations (N, 3, 3) about y by angles (N,)."""
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    return np.stack([c, o, s, o, i, o, -s, o, c], -1).reshape(*a.shape, 3, 3)


def rotation_x(a: Array) -> Array:
    """Rotations (N, 3, 3) about x by angles (N,)."""
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    return np.stack([i, o, o, o, c, -s, o, s, c], -1).reshape(*a.shape, 3, 3)


def turn(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) by `angle` about a unit axis (3,), by a quaternion."""
    w, (x, y, z) = np.cos(angle / 2.0), np.sin(angle / 2.0) * axis
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def mount_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """R_vehicle_from_sensor (3, 3) of intrinsic z-y-x angles [rad]."""
    z, y, x = (np.array([a]) for a in (yaw, pitch, roll))
    return np.asarray((rotation_z(z) @ rotation_y(y) @ rotation_x(x))[0])


def mount_angles(R_vehicle_from_sensor: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of R_vehicle_from_sensor (3, 3)."""
    R = R_vehicle_from_sensor
    return (
        float(np.arctan2(R[2, 1], R[2, 2])),
        float(np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))),
        float(np.arctan2(R[1, 0], R[0, 0])),
    )


def cumulative(x: Array, step: float) -> Array:
    """Integral by the trapezium rule, from 0; x (N, ...)."""
    total = np.zeros_like(x)
    np.cumsum(0.5 * step * (x[1:] + x[:-1]), axis=0, out=total[1:])
    return total
