"""What is compared in the attitude benchmark: accelerometer, B, B + C, and open filters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.attitude_drives import Event, angles_of, feed
from imucald.attitude.compensated import CompensatedAttitude
from imucald.attitude.filter import AttitudeFilter
from imucald.config.attitude import AttitudeSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """Roll, pitch (N, 2) at times (N,) [rad]; std (N, 2), NaN where a method has none."""

    t: Array
    angles: Array
    std: Array

    def at(self, t: Array) -> tuple[Array, Array]:
        """The newest values at each time; NaN before the first."""
        index = np.searchsorted(self.t, t + 1e-9, side="right") - 1
        angles, std = self.angles[index].copy(), self.std[index].copy()
        angles[index < 0] = np.nan
        return angles, std


def track(found: Sequence[Sequence[float]]) -> Track:
    table = np.array(found)
    return Track(table[:, 0], table[:, 1:3], table[:, 3:5])


def accelerometer_only(events: Sequence[Event]) -> Track:
    """(a): pitch and roll of the specific force itself."""
    accel = [(t, *v) for t, channel, v in events if channel == "accel"]
    table = np.array(accel)
    angles = angles_of(table[:, 1:4])
    return Track(table[:, 0], angles, np.full_like(angles, np.nan))


def compensated(events: Sequence[Event], settings: AttitudeSettings) -> Track:
    """(b): method B alone."""
    return _run(CompensatedAttitude(settings), events)


def filtered(events: Sequence[Event], settings: AttitudeSettings) -> tuple[Track, AttitudeFilter]:
    """(c): methods B and C; also the filter as it stands at the end."""
    attitude = AttitudeFilter(settings)
    return _run(attitude, events), attitude


def _run(attitude: CompensatedAttitude | AttitudeFilter, events: Sequence[Event]) -> Track:
    found: list[tuple[float, ...]] = []

    def after(t: float, channel: str) -> None:
        if channel == "accel" and attitude.running:
            e = attitude.estimate()
            found.append((t, e.roll, e.pitch, e.std[0], e.std[1]))

    feed(attitude, events, after)
    return track(found)


def paired(events: Sequence[Event]) -> tuple[Array, Array, Array]:
    """Times, rates and forces of each accelerometer sample with the gyroscope's of its time."""
    gyro = np.array([(t, *v) for t, c, v in events if c == "gyro"])
    accel = np.array([(t, *v) for t, c, v in events if c == "accel"])
    rates = np.column_stack([np.interp(accel[:, 0], gyro[:, 0], gyro[:, i]) for i in (1, 2, 3)])
    return accel[:, 0], rates, accel[:, 1:4]


Peer = Callable[[Array, Array, Array], Track]


def madgwick(gain: float | None = None) -> Peer:
    """The `ahrs` package's Madgwick filter; gain None: its default."""

    def run(t: Array, rates: Array, forces: Array) -> Track:
        from ahrs.filters import Madgwick

        options = {} if gain is None else {"gain": gain}
        peer = Madgwick(frequency=1.0 / float(np.median(np.diff(t))), **options)
        return _ahrs(peer.updateIMU, t, rates, forces)

    return run


def mahony(gain: float | None = None) -> Peer:
    """The `ahrs` package's Mahony filter; gain None: its defaults (k_P 1, k_I 0.3)."""

    def run(t: Array, rates: Array, forces: Array) -> Track:
        from ahrs.filters import Mahony

        options = {} if gain is None else {"k_P": gain, "k_I": 0.1 * gain * gain}
        peer = Mahony(frequency=1.0 / float(np.median(np.diff(t))), **options)
        return _ahrs(peer.updateIMU, t, rates, forces)

    return run


def _ahrs(update: Callable[..., Array], t: Array, rates: Array, forces: Array) -> Track:
    """Their quaternion takes sensor axes to earth axes with z up, as the force at rest says."""
    x, y, z = forces[0] / np.linalg.norm(forces[0])
    q = np.array([1.0 + z, y, -x, 0.0])  # shortest turn that levels the first sample
    q /= np.linalg.norm(q)
    up = np.empty((len(t), 3))
    for i in range(len(t)):
        q = update(q, rates[i], forces[i])
        w, x, y, z = q
        up[i] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    angles = angles_of(up)
    return Track(t, angles, np.full_like(angles, np.nan))


def imufusion(t: Array, rates: Array, forces: Array) -> Track:
    """x-io's Fusion library (the successor of Madgwick's filter), rejecting accelerations."""
    import imufusion as fusion

    ahrs = fusion.Ahrs()
    ahrs.set_sample_period(float(np.median(np.diff(t))))
    up = np.empty((len(t), 3))
    degrees, in_g = np.degrees(rates), forces / 9.80665
    for i in range(len(t)):
        ahrs.update_no_magnetometer(degrees[i], in_g[i])
        w, x, y, z = np.asarray(ahrs.get_quaternion())
        up[i] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    angles = angles_of(up)
    return Track(t, angles, np.full_like(angles, np.nan))


PEERS: dict[str, Peer] = {
    "Madgwick (ahrs)": madgwick(),
    "Mahony (ahrs)": mahony(),
    "Fusion (imufusion)": imufusion,
}


def best_gain(make: Callable[[float], Peer], gains: Sequence[float], rms: Callable[[Track], float],
              samples: tuple[Array, Array, Array]) -> tuple[float, Track]:  # fmt: skip
    """A peer at the gain that is best in hindsight, by the truth: more than anybody could have."""
    tracks = {gain: make(gain)(*samples) for gain in gains}
    gain = min(gains, key=lambda g: rms(tracks[g]))
    return gain, tracks[gain]


def rms_degrees(error: Array) -> float:
    """rms of finite errors [rad], in degrees."""
    error = error[np.isfinite(error)]
    return math.degrees(float(np.sqrt(np.mean(error * error))))
