"""Slope and cross fall of the road, from what two sensors say of them alike.

A slope s shows in the accelerometer as g s and in the gyroscope as its rate of change; nothing
else moves both so. The path of the slope is put together from both: slow parts from the
accelerometer's residual, faster ones from the gyroscope's. Its mean square is taken from the cross
spectrum, to which the noise of neither sensor contributes. The cause is named when the road is
steeper or more uneven than the model file's by more than it may be wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.search import PRIOR
from imucald.diagnosis.spectra import transform

MIDDLE_HZ = (0.015, 0.12)
"""Band in which both sensors see the road."""
FAST_HZ = 0.6
"""Above it the body's springs and the road's roughness move the gyroscope."""
LEAST_COHERENCE = 0.35
"""Share of the accelerometer's slow residual that the gyroscope must confirm."""
TOLERANCE = 0.16
"""Relative standard deviation by which a model's road may be wrong."""
OWN_ERROR = 0.06
WIDE = 1.0
"""Standard deviation of the logarithm of the ratio when the cause is at work."""
LEAST_RMS = 0.003
"""A road counts as having at least this rms (tangent)."""
CORRELATION_M = 2.0
"""Lengths of the model's waves that make one independent value."""

KINDS: Mapping[str, tuple[str, str, float, str, str]] = {
    "road_grade": ("accel_x", "gyro_y", -1.0, "road.grade_rms", "road.grade_length_m"),
    "road_bank": ("accel_y", "gyro_x", 1.0, "road.bank_rms", "road.bank_length_m"),
}
"""Cause: accelerometer's signal, gyroscope's signal, its sign, keys of rms and length."""


@dataclass(frozen=True)
class RoadFinding:
    """What was found of one kind of slope."""

    cause: str
    key: str
    rms: float
    """rms of the tangent over the distance."""
    std: float
    declared: float
    score: float
    """Log posterior odds that the model's road is wrong."""
    coherence: float
    paths: tuple[Array, ...]
    """(N,) per drive: the tangent."""


def find_roads(forwards: Sequence[Forward], values: Mapping[str, float]) -> list[RoadFinding]:
    """Compare slope and cross fall of all drives with the model file's, for fitted values."""
    found = []
    residuals = [f.measured - f.predict(values) for f in forwards]
    for cause, (accel, gyro, sign, key, length_key) in KINDS.items():
        names = forwards[0].names
        if accel not in names or gyro not in names:
            continue
        road = forwards[0].model.road
        on = road.grade if cause == "road_grade" else road.bank
        declared = getattr(road, key.split(".")[1]) if on else 0.0
        length = getattr(road, length_key.split(".")[1])
        pieces = [
            _piece(f, e[names.index(accel)], sign * e[names.index(gyro)])
            for f, e in zip(forwards, residuals, strict=True)
        ]
        found.append(_judge(cause, key, declared, length, pieces))
    return found


@dataclass(frozen=True)
class _Piece:
    path: Array
    square: float
    """Integral of the squared tangent over the distance [m]."""
    distance: float
    coherence: float


def _piece(forward: Forward, accel: Array, gyro: Array) -> _Piece:
    """Path of the slope in one drive."""
    track, spectrum = forward.track, forward.spectrum
    moving = np.abs(track.scalars["speed"])
    usable = forward.usable.all(axis=0)
    weight = moving * usable
    total = max(float(weight.sum()), 1e-9)
    accel, gyro = accel * usable / GRAVITY, gyro * usable
    if "accel_x" in forward.names and track.scalars["speed"].min() < 0.0:
        backwards = track.scalars["speed"] < 0.0
        accel = np.where(backwards, 0.0, accel)
        gyro = np.where(backwards, 0.0, gyro)
    f = spectrum.frequency
    slow = 1.0 / (1.0 + (f / MIDDLE_HZ[0]) ** 4)
    middle = (1.0 - slow) / (1.0 + (f / MIDDLE_HZ[1]) ** 6)
    fast = (1.0 - 1.0 / (1.0 + (f / MIDDLE_HZ[1]) ** 6)) / (1.0 + (f / FAST_HZ) ** 6)
    with np.errstate(divide="ignore", invalid="ignore"):
        integral = np.where(f > 0.0, 1.0 / spectrum.s, 0.0)
    accel_slow = spectrum.apply(accel, slow.astype(complex))
    accel_middle = spectrum.apply(accel, middle.astype(complex))
    gyro_middle = spectrum.apply(gyro, integral * middle)
    gyro_fast = spectrum.apply(gyro, integral * fast)
    accel_slow = accel_slow - float(np.sum(accel_slow * weight)) / total
    cross = float(np.sum(accel_middle * gyro_middle * weight))
    own = float(np.sum(accel_middle**2 * weight))
    coherence = cross / max(own, 1e-12)
    confirmed = min(max(coherence, 0.0), 1.0)
    slow_square = float(np.sum(accel_slow**2 * weight)) * confirmed
    square = max(cross, 0.0) + slow_square + float(np.sum(gyro_fast**2 * weight))
    path = confirmed * accel_slow + gyro_middle + gyro_fast
    return _Piece(path, square / 10.0, total / 10.0, coherence)


def _judge(
    cause: str, key: str, declared: float, length: float, pieces: Sequence[_Piece]
) -> RoadFinding:
    distance = sum(p.distance for p in pieces)
    rms = math.sqrt(sum(p.square for p in pieces) / max(distance, 1e-9))
    coherence = float(np.average([p.coherence for p in pieces],
                                 weights=[p.distance + 1e-9 for p in pieces]))  # fmt: skip
    count = max(distance / (CORRELATION_M * length), 1.0)
    relative = math.hypot(math.sqrt(0.5 / count), OWN_ERROR)
    ratio = math.log(max(rms, LEAST_RMS) / max(declared, LEAST_RMS))
    null = math.hypot(relative, TOLERANCE)
    wide = math.hypot(null, WIDE)
    score = 0.5 * ratio**2 * (null**-2 - wide**-2) - math.log(wide / null) + PRIOR
    if coherence < LEAST_COHERENCE or ratio < 0.0:
        score = -math.inf
    return RoadFinding(
        cause, key, rms, rms * OWN_ERROR + rms * relative * 0.3, declared, score, coherence,
        tuple(p.path for p in pieces),
    )  # fmt: skip


def road_added(forward: Forward, roads: Sequence[RoadFinding], drive: int) -> Array:
    """What the found roads add to a drive's predicted signals: (C, N)."""
    added = np.zeros_like(forward.measured)
    for road in roads:
        accel, gyro, sign, _, _ = KINDS[road.cause]
        path = road.paths[drive]
        unit = "longitudinal_accel" if road.cause == "road_grade" else "lateral_accel"
        for name in (accel, unit):
            if name in forward.names:
                added[forward.names.index(name)] += GRAVITY * path
        added[forward.names.index(gyro)] += sign * forward.derivative(path)
    return added


def road_blocks(
    forwards: Sequence[Forward], roads: Sequence[RoadFinding]
) -> list[NDArray[np.complexfloating]] | None:
    """The same, transformed by stretches: (B, F, C) per drive; None without roads."""
    if not roads:
        return None
    return [
        transform(road_added(f, roads, i)[None], f.usable, f.track.top_hz).values[..., 0]
        for i, f in enumerate(forwards)
    ]
