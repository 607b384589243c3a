"""A fault of a signal as it is sent: what is found, how sure that is, which stretches it spoils."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples
from imucald.diagnosis.result import Estimated

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Stretches = tuple[tuple[float, float], ...]

PRIOR = math.log(0.02)
"""Log prior odds that a given cause is at work, as for the causes of the physics."""
ACCEPT = 2.0
"""Log posterior odds from which on a fault is told."""
WATCHED = (
    "accel", "gyro", "speed", "wheel_speeds", "steering", "yaw_rate", "lateral_accel",
    "longitudinal_accel",
)  # fmt: skip
"""Channels that are examined. Flags and temperatures may rest for minutes."""
FEWEST = 200
"""Samples below which nothing is said of a channel."""


@dataclass(frozen=True)
class Fault:
    """One cause seen in one channel's samples and stamps."""

    cause: str
    signal: str
    """Channel of `Samples`; of clock drift, the first channel of the unit."""
    parameters: Mapping[str, Estimated]
    """Dotted keys: those of the model file, and shares and counts that have no place in it."""
    score: float
    """Log posterior odds against chance."""
    spoilt: Stretches
    """From, to [s]: samples that must not be used."""
    text: str
    """One sentence for a person."""


def odds(log_p: float) -> float:
    """Return the highest log odds that a p-value can stand for: -log(-e p log p).

    Source: Sellke, Bayarri, Berger, "Calibration of p values", The American Statistician 55 (2001).
    """
    if log_p > -1.0:
        return 0.0
    return -(1.0 + log_p + math.log(-log_p))


def watched(samples: Samples) -> list[str]:
    """Channels that are there and long enough to be examined."""
    return [name for name in WATCHED if name in samples and len(samples[name].t) >= FEWEST]


def step_of(values: Array) -> float:
    """Return the quantisation step of a signal's values (N,): their least difference; 0: none."""
    some = np.unique(values[:: max(1, len(values) // 20_000)])
    if len(some) < 2:
        return 0.0
    steps = np.diff(some)
    real = steps[steps > 1e-9 * (some[-1] - some[0])]
    return float(real.min()) if len(real) else 0.0


def repeats(values: Array) -> Mask:
    """(N-1,) where all axes are exactly as in the sample before."""
    same: Mask = values[1:] == values[:-1]
    if same.ndim == 1:
        return same
    whole: Mask = same[:, 0].copy()
    for i in range(1, same.shape[1]):
        whole &= same[:, i]
    return whole


def runs(on: Mask) -> tuple[Index, Index]:
    """Return where stretches of True begin, and where they have ended (exclusive)."""
    edge = np.diff(np.concatenate(([False], on, [False])).astype(np.int8))
    return np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)


def joined(stretches: list[tuple[float, float]], apart_s: float = 0.0) -> Stretches:
    """Sorted stretches, those closer than `apart_s` made one."""
    whole: list[tuple[float, float]] = []
    for first, last in sorted(stretches):
        if whole and first <= whole[-1][1] + apart_s:
            whole[-1] = (whole[-1][0], max(last, whole[-1][1]))
        else:
            whole.append((first, last))
    return tuple(whole)
