"""The forward model's working state: a drive's motion and what its signals should show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from imucald.core.rotations import Matrix3
from imucald.diagnosis.grid import GRID_HZ, Array, Track

if TYPE_CHECKING:
    from imucald.model.model import VehicleModel

Response = NDArray[np.inexact[Any]]
"""Frequency response along `Spectrum.frequency`; real where it has no phase."""
REFERENCE_DEGC = 25.0


class State:
    """What the hooks of causes change, stage by stage; arrays (N,) or (3, N), SI, vehicle axes."""

    def __init__(self, track: Track, model: VehicleModel, spectrum: Spectrum) -> None:
        self.track, self.model, self.spectrum = track, model, spectrum
        n = len(track.t)
        self.n = n
        self.speed = track.scalars["speed"]
        self.steer: Array | None = track.scalars.get("steering")
        """Steering-wheel angle; divided by the ratio it is the road wheel's."""
        self.gyro_in: Array | None = track.gyro
        """Measured angular rate, sensor axes, to be corrected for the gyroscope's errors."""
        self.yaw_in: Array | None = track.scalars.get("yaw_rate")
        """Measured yaw rate, to be corrected."""
        self.advance: dict[str, float] = {}
        """Seconds by which an input is to be shifted forward."""
        warm = track.scalars.get("temperature")
        self.warmth: Array | None = None if warm is None else warm - REFERENCE_DEGC
        # motion, set by the forward model
        self.rate_in = np.zeros((3, n))
        self.yaw_rate = np.zeros(n)
        self.ax = np.zeros(n)
        self.ay = np.zeros(n)
        self.yaw_from_steering: Array | None = None
        # road and body
        self.road_pitch = np.zeros(n)
        self.road_roll = np.zeros(n)
        self.lean_pitch = np.zeros(n)
        self.lean_roll = np.zeros(n)
        self.force = np.zeros((3, n))
        self.rate = np.zeros((3, n))
        self.at_reference = self.force
        # sensor
        self.turns: list[tuple[float, Matrix3]] = []
        """From a time [s] on, a rotation in vehicle axes put before the model's mount."""
        self.accel = self.force
        self.gyro = self.rate
        self.signals: dict[str, Array] = {}
        """Scalar signals as predicted."""
        self.filters: dict[str, Response] = {}
        """Frequency response by which a signal's prediction is multiplied."""

    def filtered(self, name: str, response: Response) -> None:
        """Put a frequency response into a signal's chain."""
        before = self.filters.get(name)
        self.filters[name] = response if before is None else before * response


class Spectrum:
    """Filters of whole records (N,) through the frequency domain.

    The record is continued by its end values, so what wraps around falls outside of it.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.pad = min(n - 1, 300)
        self.size = next_fast_len(n + 2 * self.pad, real=True)
        self.frequency = np.fft.rfftfreq(self.size, 1.0 / GRID_HZ)
        self.s = 2j * np.pi * self.frequency
        """Laplace variable along the frequencies."""

    def apply(self, x: Array, response: Response) -> Array:
        """Return x (..., N) filtered."""
        ends = [(0, 0)] * (x.ndim - 1)
        padded = np.pad(x, [*ends, (self.pad, self.size - self.n - self.pad)], mode="edge")
        result: Array = irfft(rfft(padded) * response, self.size)
        return result[..., self.pad : self.pad + self.n]

    def apply_all(self, x: Array, responses: Sequence[Response]) -> Array:
        """Return x (N,) through each of K filters: (K, N)."""
        padded = np.pad(x, (self.pad, self.size - self.n - self.pad), mode="edge")
        spectrum = rfft(padded)
        result: Array = irfft(np.array([spectrum * h for h in responses]), self.size)
        return result[:, self.pad : self.pad + self.n]

    def derivative(self, x: Array) -> Array:
        """Time derivative, central differences (what they lack near 4 Hz is common to all)."""
        return self.apply(x, self.s * self.gentle())

    def smooth(self, corner_hz: float) -> NDArray[np.float64]:
        """A low-pass without phase, for inputs whose noise would drown what is derived of them."""
        return np.asarray(1.0 / (1.0 + (self.frequency / corner_hz) ** 6))

    def gentle(self) -> NDArray[np.float64]:
        """A roll-off above the compared band, so that derivatives do not raise its edge."""
        f = self.frequency
        return np.asarray(
            np.where(f < 3.6, 1.0, np.cos(np.clip((f - 3.6) / 1.4, 0.0, 1.0) * np.pi / 2) ** 2)
        )

    def delay(self, seconds: float) -> Response:
        """Response of a pure delay."""
        return np.asarray(np.exp(-self.s * seconds))

    def butterworth(self, cutoff_hz: float) -> Response:
        """Response of a second-order Butterworth low-pass."""
        u = self.s / (2.0 * np.pi * cutoff_hz)
        return np.asarray(1.0 / (1.0 + np.sqrt(2.0) * u + u * u))

    def second_order(self, frequency_hz: float, damping: float) -> Response:
        """Response w^2 / (s^2 + 2 z w s + w^2)."""
        u = self.s / (2.0 * np.pi * frequency_hz)
        return np.asarray(1.0 / (1.0 + 2.0 * damping * u + u * u))
