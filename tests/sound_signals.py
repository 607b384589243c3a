"""Other sensors for a recorded drive: sound ones, unlike those that recorded it.

Each kind is what some maker sells or some gateway does: coarser steps, other rates, filters, frames
sent twice or in batches, late stamps, noise. None is a fault.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples, Series

Array = NDArray[np.float64]
Edit = Callable[[Series, np.random.Generator], Series]

SENSORS = ("accel", "gyro")
NUMBERS = (
    *SENSORS, "speed", "wheel_speeds", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel"
)  # fmt: skip
ALL = (*NUMBERS, "reverse", "brake", "heading", "temperature")


def step_of(values: Array) -> float:
    """The smallest change."""
    change = np.abs(np.diff(values, axis=0)).ravel()
    change = change[change > 1e-9 * np.abs(values).max()]
    return float(change.min()) if len(change) else 1.0


def _rounded(like: Series, values: Array) -> Series:
    step = step_of(like.values)
    return Series(like.t, np.round(values / step) * step)


def coarser(times: float) -> Edit:
    """Steps that are so many times larger."""

    def edit(s: Series, _: np.random.Generator) -> Series:
        step = times * step_of(s.values)
        return Series(s.t, np.round(s.values / step) * step)

    return edit


def slower(hz: float) -> Edit:
    """So many samples a second, no mean taken."""

    def edit(s: Series, _: np.random.Generator) -> Series:
        rows = np.searchsorted(s.t, np.arange(s.t[0], s.t[-1], 1.0 / hz))
        rows = np.unique(np.minimum(rows, len(s.t) - 1))
        return Series(s.t[rows], s.values[rows])

    return edit


def _smoothed(s: Series, hz: float) -> Array:
    part = 1.0 - np.exp(-2.0 * np.pi * hz * float(np.median(np.diff(s.t))))
    out = s.values.copy()
    for k in range(1, len(out)):
        out[k] = out[k - 1] + part * (s.values[k] - out[k - 1])
    return out


def low_pass(hz: float) -> Edit:
    """A filter of first order in the sensor, in front of its steps."""
    return lambda s, _: _rounded(s, _smoothed(s, hz))


def sent_again(times: int) -> Edit:
    """Each value in so many frames, evenly spaced: a gateway faster than the sensor."""

    def edit(s: Series, _: np.random.Generator) -> Series:
        gap = np.diff(s.t)
        gap = np.minimum(np.append(gap, gap[-1]), 2.0 * np.median(gap))
        t = s.t[:, None] + gap[:, None] * np.arange(times) / times
        return Series(t.ravel(), np.repeat(s.values, times, axis=0))

    return edit


def held(times: int) -> Edit:
    """A sensor so many times slower in the same frames."""
    return lambda s, _: Series(s.t, s.values[np.arange(len(s.t)) // times * times])


def late(s: Series, rng: np.random.Generator) -> Series:
    """Stamps late by up to a cycle."""
    return Series(
        np.sort(s.t + rng.uniform(0.0, 0.9 * np.median(np.diff(s.t)), len(s.t))), s.values
    )


def batched(size: int) -> Edit:
    """So many frames at once, when the last of them is there."""

    def edit(s: Series, _: np.random.Generator) -> Series:
        k = np.arange(len(s.t))
        last = np.minimum(k // size * size + size - 1, len(s.t) - 1)
        return Series(s.t[last] + 1e-4 * (k % size), s.values)

    return edit


def noisy(times: float) -> Edit:
    """So many times the sensor's own noise, on top."""

    def edit(s: Series, rng: np.random.Generator) -> Series:
        middle = s.values[1:-1] - 0.5 * (s.values[:-2] + s.values[2:])
        own = np.median(np.abs(middle), axis=0) / 0.6745 / np.sqrt(1.5)
        return _rounded(s, s.values + times * own * rng.standard_normal(s.values.shape))

    return edit


def rough_road(s: Series, _: np.random.Generator) -> Series:
    """Three times what is faster than manoeuvres (1 Hz)."""
    slow = _smoothed(s, 1.0)
    return _rounded(s, slow + 3.0 * (s.values - slow))


def lossy(s: Series, rng: np.random.Generator) -> Series:
    """Without a fifth of its frames."""
    rows = np.flatnonzero(rng.random(len(s.t)) > 0.2)
    return Series(s.t[rows], s.values[rows])


def repeated_if_lost(s: Series, rng: np.random.Generator) -> Series:
    """A gateway that sends the last value again where a fifth of them is late."""
    fresh = np.where(rng.random(len(s.t)) > 0.2, np.arange(len(s.t)), 0)
    return Series(s.t, s.values[np.maximum.accumulate(fresh)])


def dead_band(s: Series, _: np.random.Generator) -> Series:
    """Values that are sent anew only where they have changed by three steps."""
    step, out = 2.97 * step_of(s.values), s.values.reshape(len(s.t), -1).copy()
    for column in out.T:
        last = column[0]
        for k, value in enumerate(column.tolist()):
            if abs(value - last) >= step:
                last = value
            column[k] = last
    return Series(s.t, out.reshape(s.values.shape))


def _one_after_another(*edits: Edit) -> Edit:
    def edit(s: Series, rng: np.random.Generator) -> Series:
        for each in edits:
            s = each(s, rng)
        return s

    return edit


KINDS: Mapping[str, tuple[Collection[str], Edit]] = {
    "as recorded": ((), coarser(1.0)),
    "4 times coarser": (NUMBERS, coarser(4.0)),
    "accelerometer 16 times coarser": (("accel",), coarser(16.0)),
    "gyroscope 16 times coarser": (("gyro",), coarser(16.0)),
    "5 Hz": (SENSORS, slower(5.0)),
    "10 Hz": (SENSORS, slower(10.0)),
    "20 Hz": (SENSORS, slower(20.0)),
    "all at 5 Hz": (NUMBERS, slower(5.0)),
    "accelerometer at 10 Hz": (("accel",), slower(10.0)),
    "gyroscope at 5 Hz": (("gyro",), slower(5.0)),
    "low-pass of 1 Hz": (SENSORS, low_pass(1.0)),
    "low-pass of 5 Hz": (SENSORS, low_pass(5.0)),
    "low-pass of 1 Hz, 4 times coarser": (
        SENSORS,
        _one_after_another(low_pass(1.0), coarser(4.0)),
    ),
    "10 Hz, 4 times coarser": (SENSORS, _one_after_another(slower(10.0), coarser(4.0))),
    "sent twice": (SENSORS, sent_again(2)),
    "a sensor 5 times slower": (SENSORS, held(5)),
    "late stamps": (ALL, late),
    "batches of 10": (SENSORS, batched(10)),
    "all in batches of 10": (ALL, batched(10)),
    "10 times the gyroscope's noise": (("gyro",), noisy(10.0)),
    "a rough road": (SENSORS, rough_road),
    "a fifth lost": (SENSORS, lossy),
    "a fifth repeated": (SENSORS, repeated_if_lost),
    "a dead band": (SENSORS, dead_band),
}


def recorded_by(kind: str, samples: Samples) -> dict[str, Series]:
    """The samples as sensors of this kind give them."""
    channels, edit = KINDS[kind]
    rng = np.random.default_rng(0)
    return {c: edit(s, rng) if c in channels else s for c, s in samples.items()}
