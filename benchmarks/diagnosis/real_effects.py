"""Effects put into the samples of a measured drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples, Series

Array = NDArray[np.float64]
DEG = np.pi / 180.0
Put = Callable[[dict[str, Series], float, np.random.Generator, Array], None]


def _direction(rng: np.random.Generator) -> Array:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _rotated(values: Array, axis: Array, angle: float) -> Array:
    """Vectors (N, 3) turned about a unit axis."""
    along = (values @ axis)[:, None] * axis
    result: Array = (
        along + np.cos(angle) * (values - along) + np.sin(angle) * np.cross(axis, values)
    )
    return result


def _values(samples: dict[str, Series], name: str, values: Array) -> None:
    samples[name] = Series(samples[name].t, values)


def _accel_bias(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    _values(s, "accel", s["accel"].values + size * _direction(rng))


def _gyro_bias(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    _values(s, "gyro", s["gyro"].values + size * _direction(rng))


def _gyro_scale(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    _values(s, "gyro", s["gyro"].values * (1.0 + _sign(rng) * size))


def _g_sensitivity(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    felt = np.column_stack([np.interp(s["gyro"].t, s["accel"].t, a) for a in s["accel"].values.T])
    _values(s, "gyro", s["gyro"].values + _sign(rng) * size * felt)


def _mount_rotation(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    axis = _direction(rng)
    for name in ("accel", "gyro"):
        _values(s, name, _rotated(s[name].values, axis, size))


def _mount_shift(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    axis, share = _direction(rng), rng.uniform(0.25, 0.75)
    for name in ("accel", "gyro"):
        t, values = s[name].t, s[name].values.copy()
        after = t > t[0] + share * (t[-1] - t[0])
        values[after] = _rotated(values[after], axis, size)
        _values(s, name, values)


def _speed_scale(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    _values(s, "speed", s["speed"].values * (1.0 + _sign(rng) * size))


def _speed_delay(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    s["speed"] = Series(s["speed"].t + size, s["speed"].values)


def _lever_arm(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    """Along the vehicle: the sensor is moved forward or back."""
    accel, gyro = s["accel"], s["gyro"]
    arm = R.T @ np.array([_sign(rng) * size, 0.0, 0.0])
    w = np.column_stack([np.interp(accel.t, gyro.t, x) for x in gyro.values.T])
    # The rate's own noise would be differentiated: means over half a second.
    n = max(1, round(0.5 / float(np.median(np.diff(accel.t)))))
    w = np.column_stack([np.convolve(x, np.ones(n) / n, "same") for x in w.T])
    turning = np.gradient(w, accel.t, axis=0)
    felt = np.cross(turning, arm) + np.cross(w, np.cross(w, arm))
    _values(s, "accel", accel.values + np.where(np.isfinite(felt), felt, 0.0))


def _cross_axis(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    i, j = rng.choice(3, 2, replace=False)
    values = s["accel"].values.copy()
    values[:, i] += _sign(rng) * size * s["accel"].values[:, j]
    _values(s, "accel", values)


def _lowpass(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    """Gyroscope; two running sums of first order, as a damped pair of poles in time."""
    t, x = s["gyro"].t, s["gyro"].values
    step = float(np.median(np.diff(t)))
    w = 2.0 * np.pi * size
    out, rate, place = np.empty_like(x), np.zeros(3), x[0].copy()
    steps = max(1, int(np.ceil(w * step / 0.2)))
    h = step / steps
    for k in range(len(x)):
        for _ in range(steps):
            rate = rate + h * (w * w * (x[k] - place) - np.sqrt(2.0) * w * rate)
            place = place + h * rate
        out[k] = place
    _values(s, "gyro", out)


def _saturation(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    """Of the gyroscope, so that this share of samples sits on the rail."""
    values = s["gyro"].values
    rail = float(np.quantile(np.abs(values).max(axis=1), 1.0 - size))
    _values(s, "gyro", np.clip(values, -rail, rail))


def _stretches(
    rng: np.random.Generator, t: Array, share: float, longest: float
) -> NDArray[np.bool_]:
    """Rows (N,) within random stretches that make up a share of the time."""
    inside = np.zeros(len(t), dtype=bool)
    span = t[-1] - t[0]
    for _ in range(100_000):
        if inside.mean() >= share:
            break
        length = min(rng.uniform(0.2, 1.0) * longest, max((share - inside.mean()) * span, 0.1))
        start = rng.uniform(t[0], t[-1] - length)
        inside |= (t >= start) & (t < start + length)
    return inside


def _dropouts(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    lost = _stretches(rng, s["accel"].t, size, 2.0)
    s["accel"] = Series(s["accel"].t[~lost], s["accel"].values[~lost])


def _stuck(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    frozen = _stretches(rng, s["gyro"].t, size, 20.0)
    index = np.arange(len(frozen))
    first = np.maximum.accumulate(np.where(frozen, 0, index))
    # Within a stretch: the last sample before it.
    _values(s, "gyro", s["gyro"].values[first])


def _stamps(s: dict[str, Series], size: float, rng: np.random.Generator, R: Array) -> None:
    """The inertial unit's stamps run off against the vehicle's [ppm]."""
    way = _sign(rng)
    for name in ("accel", "gyro"):
        t = s[name].t
        s[name] = Series(t[0] + (t - t[0]) * (1.0 + way * size * 1e-6), s[name].values)


EFFECTS: Mapping[str, tuple[str, Put, tuple[float, ...], str, float]] = {
    "accel_bias": ("accel_bias", _accel_bias, (0.05, 0.1, 0.2, 0.4, 0.8), "m/s²", 1.0),
    "gyro_bias": ("gyro_bias", _gyro_bias,
                  tuple(x * DEG for x in (0.05, 0.1, 0.2, 0.4, 0.8)), "deg/s", DEG),
    "gyro_scale": ("gyro_scale", _gyro_scale, (0.01, 0.02, 0.04, 0.08, 0.16), "%", 0.01),
    "g_sensitivity": ("g_sensitivity", _g_sensitivity,
                      tuple(x * DEG for x in (0.02, 0.05, 0.1, 0.2, 0.4)),
                      "(deg/s)/(m/s²)", DEG),
    "mount_rotation": ("mount_rotation", _mount_rotation,
                       tuple(x * DEG for x in (0.5, 1.0, 2.0, 4.0, 8.0)), "deg", DEG),
    "mount_shift": ("mount_shift", _mount_shift,
                    tuple(x * DEG for x in (0.5, 1.0, 2.0, 4.0, 8.0)), "deg", DEG),
    "accel_cross_axis": ("accel_cross_axis", _cross_axis,
                         (0.01, 0.02, 0.04, 0.08, 0.16), "%", 0.01),
    "lever_arm": ("lever_arm", _lever_arm, (0.5, 1.0, 2.0, 4.0, 8.0), "m", 1.0),
    "wheel_speed_scale": ("wheel_speed_scale", _speed_scale,
                          (0.01, 0.02, 0.04, 0.08, 0.16), "%", 0.01),
    "speed_delay": ("signal_delay", _speed_delay, (0.05, 0.1, 0.2, 0.4, 0.8), "s", 1.0),
    "gyro_lowpass": ("sensor_lowpass", _lowpass, (4.0, 2.0, 1.0, 0.5, 0.25), "Hz", 1.0),
    "gyro_saturation": ("saturation", _saturation, (0.0005, 0.002, 0.005, 0.02, 0.05), "%", 0.01),
    "accel_dropouts": ("dropouts", _dropouts, (0.001, 0.0025, 0.005, 0.02, 0.08), "%", 0.01),
    "gyro_stuck": ("stuck_signal", _stuck, (0.002, 0.005, 0.01, 0.04, 0.12), "%", 0.01),
    "stamps_drift": ("clock_drift", _stamps, (50.0, 100.0, 200.0, 400.0, 800.0), "ppm", 1.0),
}  # fmt: skip
"""Effect to its cause, what it does, five sizes from slight to strong, unit shown and its size."""


def with_effect(
    samples: Samples, effect: str, size: float, rng: np.random.Generator, R: Array
) -> Samples:
    """Return samples with an effect put in; R_vehicle_from_sensor as far as it is known."""
    changed = dict(samples)
    EFFECTS[effect][1](changed, size, rng, R)
    return changed
