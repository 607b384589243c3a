"""Effects put into the samples of a measured drive, sample by sample.

Shares nothing with the forward model: vectors are turned, samples are moved, dropped or repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples, Series

Array = NDArray[np.float64]
Drive = dict[str, Series]
DEG = float(np.pi / 180.0)
Put = Callable[[Drive, float, np.random.Generator, Array], float]
"""(samples, size, generator, R_vehicle_from_sensor) -> the signed number that was put in."""


@dataclass(frozen=True)
class Effect:
    """One effect: which names are right, how it is put in, four sizes."""

    right: tuple[str, ...]
    put: Put
    sizes: tuple[float, float, float, float]
    unit: str
    per: float = 1.0
    """Size of the unit in SI."""
    key: str = ""
    """Parameter whose interval should hold the number; empty: none is compared."""
    needs: tuple[str, ...] = ()


def _direction(rng: np.random.Generator) -> Array:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _rotated(values: Array, axis: Array, angle: float) -> Array:
    """Vectors (N, 3) turned about a unit axis."""
    along = (values @ axis)[:, None] * axis
    return np.asarray(
        along + np.cos(angle) * (values - along) + np.sin(angle) * np.cross(axis, values)
    )


def _set(s: Drive, name: str, values: Array) -> None:
    s[name] = Series(s[name].t, values)


def _bias(name: str, row: int | None) -> Put:
    """Along a vehicle axis (row), or along any direction."""

    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        x = _sign(rng) * size
        way = _direction(rng) if row is None else R[row]
        _set(s, name, s[name].values + x * way)
        return x

    return put


def _bias_drift(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Grows evenly from 0 to twice the size over the drive."""
    t = s["accel"].t
    share = (t - t[0]) / (t[-1] - t[0])
    _set(s, "accel", s["accel"].values + 2.0 * size * share[:, None] * _direction(rng))
    return size


def _scale(name: str) -> Put:
    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        x = _sign(rng) * size
        _set(s, name, s[name].values * (1.0 + x))
        return x

    return put


def _offset(name: str) -> Put:
    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        x = _sign(rng) * size
        _set(s, name, s[name].values + x)
        return x

    return put


def _cross_axis(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    i, j = rng.choice(3, 2, replace=False)
    values = s["accel"].values.copy()
    x = _sign(rng) * size
    values[:, i] += x * s["accel"].values[:, j]
    _set(s, "accel", values)
    return x


def _late(*names: str) -> Put:
    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        for name in names:
            s[name] = Series(s[name].t + size, s[name].values)
        return size

    return put


def _lowpass(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Speed through a first-order low-pass with this time constant."""
    t, x = s["speed"].t, s["speed"].values
    out = np.empty_like(x)
    out[0] = x[0]
    for k in range(1, len(x)):
        keep = np.exp(-(t[k] - t[k - 1]) / size)
        out[k] = keep * out[k - 1] + (1.0 - keep) * 0.5 * (x[k] + x[k - 1])
    _set(s, "speed", out)
    return size


def _clip(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """One axis of the accelerometer, both ends, so that this share of samples is on the rail."""
    values = s["accel"].values.copy()
    axis = int(rng.integers(3))
    x = values[:, axis] - np.median(values[:, axis])
    rail = float(np.quantile(np.abs(x), 1.0 - size))
    values[:, axis] = np.clip(x, -rail, rail) + np.median(values[:, axis])
    _set(s, "accel", values)
    return size


def _stuck(name: str) -> Put:
    """One stretch of driving, of `size` seconds."""

    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        t, v = s["speed"].t, s["speed"].values
        fast = t[(v > 5.0) & (t < t[-1] - size)]
        start = float(rng.choice(fast))
        own = s[name]
        inside = (own.t >= start) & (own.t < start + size)
        values = own.values.copy()
        values[inside] = values[np.flatnonzero(inside)[0]]
        _set(s, name, values)
        return size

    return put


def _lost(name: str) -> Put:
    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        kept = rng.random(len(s[name].t)) >= size
        s[name] = Series(s[name].t[kept], s[name].values[kept])
        return size

    return put


def _doubled(name: str) -> Put:
    """Sent again a tenth of the cycle later."""

    def put(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
        t, values = s[name].t, s[name].values
        again = rng.random(len(t)) < size
        later = t[again] + 0.1 * float(np.median(np.diff(t)))
        order = np.argsort(np.concatenate([t, later]), kind="stable")
        s[name] = Series(np.concatenate([t, later])[order],
                         np.concatenate([values, values[again]])[order])  # fmt: skip
        return size

    return put


def _turn(s: Drive, size: float, rng: np.random.Generator, R: Array, axis: Array) -> None:
    for name in ("accel", "gyro"):
        if name in s:
            _set(s, name, _rotated(s[name].values, axis, size))


def _rotation(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """About the vehicle's upward axis, all along."""
    x = _sign(rng) * size
    _turn(s, x, rng, R, R[2])
    return x


def _remount(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """About any axis, somewhere in the middle 40 % of the drive."""
    axis, share = _direction(rng), rng.uniform(0.3, 0.7)
    for name in ("accel", "gyro"):
        if name not in s:
            continue
        t, values = s[name].t, s[name].values.copy()
        after = t > t[0] + share * (t[-1] - t[0])
        values[after] = _rotated(values[after], axis, size)
        _set(s, name, values)
    return size


def _creep(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Turns evenly about one axis, by `size` from the first to the last sample."""
    axis = _direction(rng)
    for name in ("accel", "gyro"):
        if name not in s:
            continue
        t, values = s[name].t, s[name].values
        angle = size * (t - t[0]) / (t[-1] - t[0])
        along = (values @ axis)[:, None] * axis
        c, n = np.cos(angle)[:, None], np.sin(angle)[:, None]
        _set(s, name, along + c * (values - along) + n * np.cross(axis, values))
    return size


def _stamps(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed's stamps run off those of the sensor."""
    t = s["speed"].t
    x = _sign(rng) * size
    s["speed"] = Series(t[0] + (t - t[0]) * (1.0 + x), s["speed"].values)
    return x


GAINS = ("wheel_speed_scale", "accel_scale", "gyro_scale")
EFFECTS: Mapping[str, Effect] = {
    "accel_bias": Effect(("accel_bias",), _bias("accel", None), (0.1, 0.2, 0.3, 0.5), "m/s²"),
    "accel_bias_x": Effect(("accel_bias",), _bias("accel", 0), (0.1, 0.2, 0.3, 0.5), "m/s²",
                           key="accel.bias.x"),
    "accel_bias_drift": Effect(
        ("accel_bias_drift", "accel_bias", "accel_bias_temperature", "mount_creep"), _bias_drift,
        (0.1, 0.2, 0.3, 0.5), "m/s²"),
    "accel_scale": Effect(("accel_scale",), _scale("accel"), (0.02, 0.04, 0.06, 0.1), "%", 0.01),
    "accel_cross_axis": Effect(("accel_cross_axis",), _cross_axis, (0.02, 0.04, 0.06, 0.1), "%",
                               0.01),
    "gyro_bias": Effect(("gyro_bias",), _bias("gyro", 2),
                        (0.1 * DEG, 0.2 * DEG, 0.3 * DEG, 0.6 * DEG), "deg/s", DEG, "gyro.bias.z",
                        ("gyro",)),
    "gyro_scale": Effect(("gyro_scale",), _scale("gyro"), (0.03, 0.06, 0.09, 0.12), "%", 0.01,
                         needs=("gyro",)),
    "speed_scale": Effect(("wheel_speed_scale",), _scale("speed"), (0.03, 0.06, 0.09, 0.12), "%",
                          0.01, "speed.scale"),
    "speed_late": Effect(("signal_delay",), _late("speed"), (0.1, 0.2, 0.3, 0.5), "s",
                         key="speed.delay_s"),
    "accel_late": Effect(("signal_delay",), _late("accel"), (0.05, 0.1, 0.2, 0.4), "s",
                         key="accel.delay_s"),
    "speed_lowpass": Effect(("signal_delay", "sensor_lowpass"), _lowpass, (0.2, 0.4, 0.8, 1.6),
                            "s"),
    "stamps": Effect(("delay_rate", "clock_drift"), _stamps, (1e-4, 2e-4, 4e-4, 8e-4), "ppm", 1e-6,
                     "speed.delay_rate"),
    "remount": Effect(("mount_shift",), _remount, (2 * DEG, 4 * DEG, 6 * DEG, 10 * DEG), "deg",
                      DEG, needs=("gyro",)),
    "creep": Effect(("mount_creep", "mount_shift"), _creep,
                    (2 * DEG, 4 * DEG, 6 * DEG, 10 * DEG), "deg", DEG, needs=("gyro",)),
    "turned": Effect(("mount_rotation",), _rotation, (1 * DEG, 2 * DEG, 4 * DEG, 8 * DEG), "deg",
                     DEG, needs=("gyro",)),
    "clipped": Effect(("saturation",), _clip, (0.005, 0.01, 0.02, 0.05), "%", 0.01),
    "gyro_stuck": Effect(("stuck_signal",), _stuck("gyro"), (5.0, 15.0, 30.0, 60.0), "s",
                         needs=("gyro",)),
    "speed_stuck": Effect(("stuck_signal",), _stuck("speed"), (15.0, 30.0, 45.0, 60.0), "s"),
    "lost": Effect(("dropouts",), _lost("accel"), (0.005, 0.01, 0.02, 0.05), "%", 0.01),
    "doubled": Effect(("duplicated_frames",), _doubled("accel"), (0.005, 0.01, 0.02, 0.05), "%",
                      0.01),
    "steering_offset": Effect(("steering_offset",), _offset("steering"),
                              (1 * DEG, 3 * DEG, 5 * DEG, 8 * DEG), "deg", DEG, "steering.offset",
                              ("steering",)),
    "steering_ratio": Effect(("steering_ratio",), _scale("steering"), (0.04, 0.08, 0.12, 0.2),
                             "%", 0.01, needs=("steering",)),
    "yaw_rate_scale": Effect(("yaw_rate_scale",), _scale("yaw_rate"), (0.03, 0.06, 0.1, 0.15),
                             "%", 0.01, "yaw_rate.scale", ("yaw_rate",)),
    "yaw_rate_offset": Effect(("yaw_rate_offset",), _offset("yaw_rate"),
                              (0.2 * DEG, 0.4 * DEG, 0.8 * DEG, 1.6 * DEG), "deg/s", DEG,
                              "yaw_rate.offset", ("yaw_rate",)),
}  # fmt: skip


def with_effect(
    samples: Samples, effect: str, size: float, rng: np.random.Generator, R: Array
) -> tuple[Samples, float]:
    """Samples with an effect put in, and the number; R_vehicle_from_sensor as far as known."""
    changed = dict(samples)
    x = EFFECTS[effect].put(changed, size, rng, R)
    return changed, x
