"""Saturation: a sensor's values pile up at one size that they never pass."""

from __future__ import annotations

import math

import numpy as np

from imucald.core.samples import Samples, Series
from imucald.diagnosis.faults.fault import (
    ACCEPT,
    PRIOR,
    Array,
    Fault,
    Mask,
    Stretches,
    joined,
    odds,
    repeats,
    runs,
    step_of,
    watched,
)
from imucald.diagnosis.result import Estimated
from imucald.model.model import VehicleModel

RAILED = ("accel", "gyro", "yaw_rate", "lateral_accel", "longitudinal_accel")
"""Sensors; a speed or a steering angle has ends of its own."""
APART_S = 0.3
"""Arrivals at the rail closer than this are one movement."""
FEWEST_SAMPLES = 3
BROAD = 3.0
"""The tail is measured from where it holds this many times the samples on the rail."""
STAYS_COUNT = 0.5
"""Neighbouring samples are not independent: each counts for so much."""
FINEST = 1e-5
"""Share of the largest value that counts as the same value where a signal has no steps."""
FROZEN_FRAMES = 6
"""All axes the same for so long is a signal that stands still, not one at its end."""
JUMP = 12.0
"""A signal leaves its rail as it moves otherwise, not by so many of its usual changes."""
SPOILT_SHARE = 0.25
"""Half seconds with more of their samples on the rail must not be used."""
WINDOW_S = 0.5


def find(samples: Samples, model: VehicleModel) -> list[Fault]:
    """Return the sensors that sat on their rail."""
    found = [_channel(name, samples[name]) for name in watched(samples) if name in RAILED]
    return [fault for fault in found if fault is not None]


def on_rail(series: Series) -> tuple[float, Mask]:
    """Return the largest size of any axis, and which samples (N,) sit on it."""
    columns = series.values.reshape(len(series.t), -1)
    # A declared axis (a planar sensor's third) does not move and says nothing.
    columns = columns[:, np.ptp(columns, axis=0) > 0.0]
    if columns.shape[1] == 0:
        return 0.0, np.zeros(len(series.t), dtype=bool)
    size = np.abs(columns[:, 0])
    for i in range(1, columns.shape[1]):
        np.maximum(size, np.abs(columns[:, i]), out=size)
    rail = float(size.max())
    return rail, np.asarray(size > rail - 0.5 * _step(columns, rail))


def _step(columns: Array, rail: float) -> float:
    steps = [step_of(column) for column in columns.T]
    return max([*steps, FINEST * rail])


def _channel(name: str, series: Series) -> Fault | None:
    rail, at = on_rail(series)
    if np.count_nonzero(at) < FEWEST_SAMPLES:
        return None
    at = at & ~_frozen(series)
    t = series.t[at]
    if len(t) < FEWEST_SAMPLES:
        return None
    arrivals = 1 + int(np.count_nonzero(np.diff(t) > APART_S))
    columns = series.values.reshape(len(series.t), -1)
    step = _step(columns, rail)
    scale = _tail(columns, rail, int(BROAD * len(t)))
    # Peaks of a tail that falls by 1/e over `scale` meet in one step with this probability each.
    log_p = (arrivals - 1) * math.log(-math.expm1(-step / scale)) if scale > 0.0 else 0.0
    log_p += _stays(columns, at, rail, BROAD * scale)
    score = PRIOR - math.log(len(RAILED)) + odds(log_p)
    if score < ACCEPT:
        return None
    share = len(t) / len(series.t)
    unit = "m/s^2" if "accel" in name else "rad/s"
    parameters = {
        f"{name}.full_scale": Estimated(rail, max(step, FINEST * rail) / math.sqrt(12.0), unit),
        f"{name}.saturated_share": Estimated(share, math.sqrt(len(t)) / len(series.t), "share"),
        f"{name}.saturated_arrivals": Estimated(float(arrivals), 0.5, "count"),
    }
    text = (
        f"{name} never passes {rail:.5g} {unit} and sat there {arrivals} times, in {len(t)} "
        f"samples ({100.0 * share:.2g} %), from {t[0]:.0f} s to {t[-1]:.0f} s."
    )
    return Fault("saturation", name, parameters, score, _spoilt(series.t, at), text)


def _stays(columns: Array, at: Mask, rail: float, reach: float) -> float:
    """Log probability of staying at the rail from sample to sample.

    Below the rail an axis is as it was with a probability that its step, noise and motion give.
    """
    log_p = 0.0
    for column in np.abs(columns).T:
        near = column[1:] > rail - reach
        top = near & at[1:] & at[:-1] & (column[1:] == column[:-1])
        below = near & ~at[1:] & ~at[:-1]
        if not top.any():
            continue
        equal = np.count_nonzero(below & (column[1:] == column[:-1]))
        chance = (equal + 1.0) / (np.count_nonzero(below) + 2.0)
        log_p += STAYS_COUNT * float(np.count_nonzero(top)) * math.log(chance)
    return log_p


def _frozen(series: Series) -> Mask:
    """(N,) samples in stretches in which the signal stood still as a whole, and then jumped."""
    first, last = runs(repeats(series.values))
    long = last - first >= FROZEN_FRAMES
    result = np.zeros(len(series.t), dtype=bool)
    if not long.any():
        return result
    columns = series.values.reshape(len(series.t), -1)
    usual = max(float(np.median(np.abs(np.diff(columns, axis=0)))), step_of(columns[:, 0]))
    for i, j in zip(first[long], last[long], strict=True):
        # Row j is the last of the stretch. Several axes do not stand still on one axis' rail.
        after = columns[min(j + 1, len(columns) - 1)]
        if columns.shape[1] > 1 or np.abs(after - columns[j]).max() > JUMP * usual:
            result[i : j + 1] = True
    return result


def _tail(columns: Array, rail: float, count: int) -> float:
    """Width over which the number of samples falls to 1/e, just below the rail."""
    size = np.abs(columns).max(axis=1)
    count = min(max(count, 10), len(size) - 1)
    level = float(np.partition(size, len(size) - count)[len(size) - count])
    return (rail - level) / math.log(BROAD)


def _spoilt(t: Array, at: Mask) -> Stretches:
    """Half seconds that were on the rail for a good part."""
    window = ((t - t[0]) / WINDOW_S).astype(np.int64)
    share = np.bincount(window, at) / np.maximum(np.bincount(window), 1)
    return joined(
        [(float(t[0] + i * WINDOW_S), float(t[0] + (i + 1) * WINDOW_S))
         for i in np.flatnonzero(share > SPOILT_SHARE)],
        1e-6,
    )  # fmt: skip
