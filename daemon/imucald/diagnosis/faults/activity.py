"""What the other signals say of each moment: whether a signal should be changing there."""

from __future__ import annotations

import numpy as np

from imucald.core.samples import Samples, Series
from imucald.diagnosis.faults.fault import Array, Index, Mask, runs
from imucald.diagnosis.forward_mount import mount_of
from imucald.model.model import VehicleModel

BIN_S = 0.5
STANDING_MPS = 0.3
SPEED_KINDS, CHANGE_KINDS = 4, 4
"""Moments are told apart by so many classes of motion and of its change."""
DEAD_MPS = 0.8
"""Below this a sound speed signal may say 0."""
REST_MARGIN_S = 1.5
"""One speed signal may be so much older than another."""
SLOWEST_MPS = 3.0
"""Below this a yaw rate says little about the steering."""


def situations(name: str, samples: Samples, model: VehicleModel) -> Index:
    """Return the kind of moment of each sample of a channel: (N,) small numbers."""
    series = samples[name]
    start = float(series.t[0])
    n = int((series.t[-1] - start) / BIN_S) + 1
    t = np.asarray(start + (np.arange(n) + 0.5) * BIN_S, dtype=np.float64)
    others = {key: value for key, value in samples.items() if key != name and len(value.t) > 10}
    motion = _classes(_motion(name, others, t), SPEED_KINDS)
    change = _classes(_change(name, others, t, model), CHANGE_KINDS)
    kind = motion * CHANGE_KINDS + change
    return np.asarray(kind[((series.t - start) / BIN_S).astype(np.int64)])


def resting(name: str, samples: Samples) -> Mask:
    """(N,) where a speed signal may well say 0: another one says so, or nearly, or there is none.

    A phone that is turned in the hand of a waiting driver shakes as in a moving car.
    """
    t = samples[name].t
    other = {"speed": "wheel_speeds", "wheel_speeds": "speed"}.get(name)
    if other is None or other not in samples:
        return np.full(len(t), other is not None)
    values = samples[other].values
    slow = (np.abs(values) if values.ndim == 1 else np.abs(values).min(axis=1)) < DEAD_MPS
    clock = samples[other].t
    # Where it is silent nobody knows.
    slow[:-1] |= np.diff(clock) > REST_MARGIN_S
    slow[1:] |= slow[:-1] & (np.diff(clock) > REST_MARGIN_S)
    first, last = runs(slow)
    starts = np.searchsorted(t, clock[first] - REST_MARGIN_S)
    stops = np.searchsorted(t, clock[last - 1] + REST_MARGIN_S)
    depth = np.zeros(len(t) + 1)
    np.add.at(depth, starts, 1)
    np.add.at(depth, stops, -1)
    heard = (t >= clock[0]) & (t <= clock[-1])
    return np.asarray((np.cumsum(depth)[:-1] > 0) | ~heard)


def _motion(name: str, others: Samples, t: Array) -> Array:
    """How fast the vehicle moves, in any unit; below 0: it stands."""
    for key in ("wheel_speeds", "speed"):
        if key in others:
            values = others[key].values
            speed = values if values.ndim == 1 else values[:, 0]
            at = np.interp(t, others[key].t, np.abs(speed))
            return np.where(at < STANDING_MPS, -1.0, at)
    for key in ("accel", "gyro"):
        if key in others:
            return _vibration(others[key], t)
    return np.zeros(len(t))


def _change(name: str, others: Samples, t: Array, model: VehicleModel) -> Array:
    """Size of the change that a signal should show around each moment, in any unit."""
    if name in ("speed", "wheel_speeds", "longitudinal_accel"):
        key = "wheel_speeds" if name == "speed" else "speed"
        if key in others:
            values = others[key].values
            speed = values if values.ndim == 1 else values[:, 0]
            return _range(np.interp(_fine(t), others[key].t, speed))
        if "accel" in others:
            forward = others["accel"].values @ mount_of(model)[0]
            return _range(np.interp(_fine(t), others["accel"].t, forward))
        return np.zeros(len(t))
    turning = _turning(name, others, t, model)
    if turning is None:
        return np.zeros(len(t))
    if name == "steering" and "speed" in others:
        speed = np.interp(_fine(t), others["speed"].t, np.abs(others["speed"].values))
        turning = turning / np.maximum(speed, SLOWEST_MPS)
    return _range(turning)


def _turning(name: str, others: Samples, t: Array, model: VehicleModel) -> Array | None:
    fine = _fine(t)
    for key in ("yaw_rate", "gyro", "steering"):
        if key in others:
            values = others[key].values
            turning = values if values.ndim == 1 else values @ mount_of(model)[2]
            return np.asarray(np.interp(fine, others[key].t, turning))
    return None


def _fine(t: Array) -> Array:
    """Moments four times as dense as the bins: 0.125 s apart, from half a second before."""
    return np.asarray(t[0] - 0.5 * BIN_S + (np.arange(4 * len(t)) + 0.5) * (BIN_S / 4.0))


def _range(fine: Array) -> Array:
    """Highest less lowest value in each bin and its neighbours."""
    bins = fine.reshape(-1, 4)
    high, low = bins.max(axis=1), bins.min(axis=1)
    around = np.pad(high, 1, mode="edge"), np.pad(low, 1, mode="edge")
    top = np.maximum(np.maximum(around[0][:-2], around[0][1:-1]), around[0][2:])
    bottom = np.minimum(np.minimum(around[1][:-2], around[1][1:-1]), around[1][2:])
    result: Array = top - bottom
    return result


def _vibration(series: Series, t: Array) -> Array:
    """Mean size of sample-to-sample changes in each bin."""
    values = series.values.reshape(len(series.t), -1)
    change = np.abs(np.diff(values, axis=0)).sum(axis=1)
    index = np.floor((series.t[1:] - t[0]) / BIN_S + 0.5).astype(np.int64)
    inside = (index >= 0) & (index < len(t))
    total = np.bincount(index[inside], change[inside], minlength=len(t))
    result: Array = total / np.maximum(np.bincount(index[inside], minlength=len(t)), 1)
    return result


def _classes(x: Array, count: int) -> Index:
    """Class of each value: what is below 0 apart, the rest in equal parts."""
    if np.ptp(x) == 0.0:
        return np.zeros(len(x), dtype=np.int64)
    apart = x < 0.0
    parts = count - int(apart.any())
    rest = x[~apart]
    if not len(rest):
        return np.zeros(len(x), dtype=np.int64)
    bounds = np.quantile(rest, np.arange(1, parts) / parts)
    kind = np.searchsorted(bounds, x, side="right")
    return np.where(apart, count - 1, kind)
