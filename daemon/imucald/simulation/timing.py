"""Times of frames: cycle time, clock drift, latency, losses, drop-outs, stuck values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.samples import LATERAL_ACCEL, LONGITUDINAL_ACCEL, YAW_RATE, Series
from imucald.model.sensors import Transmission
from imucald.simulation.filters import generator

SHARED_PHASE = {"accel": "imu", "gyro": "imu"}
"""Unit of each channel that shares its sampling times. One unit samples accelerometer and gyroscope
at the same times."""
SHARED_FRAME = dict.fromkeys(
    (row.channel for row in (YAW_RATE, LATERAL_ACCEL, LONGITUDINAL_ACCEL)), "dynamics"
)
"""Frame of each channel that shares a frame. The stability control sends all its sensors in one
frame, so they have the same times, latency and losses."""
GYRO_AFTER_ACCEL_S = 0.00025
"""Time by which the gyroscope's frame follows the accelerometer's frame [s]: one frame at 500
kbit/s."""


@dataclass(frozen=True)
class Timing:
    """Times of one message, (N,) each.

    sampled: time at which the unit makes the frame [s]. stamp: time at which the frame is on the
    bus [s]. kept: True for frames that are not lost. source: index of the sample whose value is in
    the frame; it is an earlier sample while the signal is stuck.
    """

    sampled: Array
    stamp: Array
    kept: NDArray[np.bool_]
    source: NDArray[np.int64]

    def series(self, values: NDArray[np.float64]) -> Series:
        """Return the samples that are received. values: (N,) or (N, width), of all frames."""
        return Series(self.stamp[self.kept], values[self.source[self.kept]])


def frame_timing(message: Transmission, name: str, seed: int, duration_s: float) -> Timing:
    """Draw the times of a message over a drive."""
    frame = SHARED_FRAME.get(name, name)
    unit = SHARED_PHASE.get(name, frame)
    period = (1.0 + message.clock_drift_ppm * 1e-6) / message.rate_hz
    phase = float(generator(seed, f"phase:{unit}").random()) * period
    n = max(0, int((duration_s - phase) / period) + 1)
    sampled: Array = phase + np.arange(n, dtype=np.float64) * period
    rng = generator(seed, f"timing:{frame}")
    late = message.jitter_s * rng.standard_exponential(n)
    if name == "gyro":
        late += GYRO_AFTER_ACCEL_S
    # Frames of one unit never overtake each other.
    stamp = np.maximum.accumulate(sampled + late)
    kept = rng.random(n) >= message.loss if message.loss > 0.0 else np.ones(n, dtype=bool)
    kept &= stamp <= duration_s
    for gap in message.dropouts:
        kept &= (sampled < gap.start_s) | (sampled >= gap.start_s + gap.duration_s)
    source = np.arange(n)
    for gap in message.stuck:
        inside = np.flatnonzero((sampled >= gap.start_s) & (sampled < gap.start_s + gap.duration_s))
        if len(inside):
            source[inside] = inside[0]
    return Timing(sampled, stamp, kept, source)


def at_times(x: Array, rate: float, t: Array) -> Array:
    """Return the value of a grid signal x (N,) at times t [s]: linear between grid points, constant
    outside the grid."""
    place = np.clip(t * rate, 0.0, len(x) - 1.0)
    i = np.minimum(place.astype(np.int64), max(len(x) - 2, 0))
    u = place - i
    result: Array = x[i] * (1.0 - u) + x[np.minimum(i + 1, len(x) - 1)] * u
    return result


def quantised(x: Array, lsb: float) -> Array:
    """Round to whole steps. With an lsb of 0, x is unchanged."""
    return x if lsb == 0.0 else np.rint(x / lsb) * lsb
