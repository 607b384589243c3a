"""Drives for the attitude benchmark: samples in order in vehicle axes, and the true attitude."""

from __future__ import annotations

import csv
import gzip
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.measured import DATA, MEASURED_DRIVES
from imucald.can.logs.log_reader import LogReader
from imucald.core.rotations import IDENTITY, quaternion_turned, rows_from_quaternion
from imucald.runtime.session import make_engine, open_config
from imucald.runtime.timebase import TimeBase
from imucald.simulation.drive import Drive

Array = NDArray[np.float64]
Event = tuple[float, str, Sequence[float]]
ORDER = ("reverse", "speed", "heading", "gyro", "mag", "accel")
TRIADS = ("gyro", "mag", "accel")


@dataclass(frozen=True)
class Truth:
    """Third row of R_earth_from_vehicle (N, 3) (the vertical in vehicle axes) at times t (N,)."""

    t: Array
    up: Array
    speed: Array
    grade: Array | None = None
    """Slope of the road, tangent, positive uphill."""

    @property
    def roll_pitch(self) -> Array:
        """(N, 2) [rad], ISO 8855."""
        return angles_of(self.up)


def angles_of(up: Array) -> Array:
    """Roll and pitch (N, 2) of the vertical in vehicle axes (N, 3)."""
    roll = np.arctan2(up[:, 1], up[:, 2])
    return np.column_stack([roll, -np.arctan2(up[:, 0], np.hypot(up[:, 1], up[:, 2]))])


def in_order(samples: dict[str, tuple[Array, Array]], R: Array) -> list[Event]:
    """Samples as the daemon takes them; the sensor's are turned by R_vehicle_from_sensor."""
    found: list[tuple[float, int, str, Sequence[float]]] = []
    for channel, (t, values) in samples.items():
        if channel not in ORDER:
            continue
        v = values @ R.T if channel in TRIADS else values.reshape(len(t), -1)
        rank = ORDER.index(channel)
        found += [(a, rank, channel, b) for a, b in zip(t.tolist(), v.tolist(), strict=True)]
    found.sort(key=lambda event: event[:2])
    return [(t, channel, v) for t, _, channel, v in found]


def feed(take: object, events: Sequence[Event], after: Callable[[float, str], None]) -> None:
    """Hand events to something with the filter's verbs; call `after` each."""
    verbs = {c: getattr(take, c) for c in ORDER}
    for t, channel, values in events:
        if channel in TRIADS:
            verbs[channel](t, values)
        elif channel == "reverse":
            verbs[channel](values[0] > 0.5)
        else:
            verbs[channel](t, values[0])
        after(t, channel)


def simulated(drive: Drive) -> tuple[list[Event], Truth]:
    """A simulated drive, its sensor turned by the true mount."""
    samples = {c: (s.t, s.values) for c, s in drive.samples.items()}
    truth = drive.truth
    sr, cr = np.sin(truth.road_roll), np.cos(truth.road_roll)
    sp, cp = np.sin(truth.road_pitch), np.cos(truth.road_pitch)
    x, y, z = -sp, cp * sr, cp * cr  # the vertical in road axes
    sp, cp = np.sin(truth.body_pitch), np.cos(truth.body_pitch)
    sr, cr = np.sin(truth.body_roll), np.cos(truth.body_roll)
    x, z = cp * x - sp * z, sp * x + cp * z
    up = np.column_stack([x, cr * y + sr * z, cr * z - sr * y])
    return in_order(samples, truth.R_vehicle_from_sensor()), Truth(
        truth.t, up, truth.speed, -np.tan(truth.road_pitch)
    )


def kingston() -> tuple[list[Event], Truth, Array]:
    """The van: samples turned by the mount that replay finds, and the INS in the same axes.

    The INS' body axes are the sensor's axes (right, forward, up) but for its zero errors, so the
    same rotation takes both to vehicle axes, and an error of the mount does not count as one of
    attitude. Also returns that rotation.
    """
    log = DATA / "kingston_2008" / "drive.log.gz"
    engine = make_engine(open_config(MEASURED_DRIVES / "kingston_2008.yaml"))
    timebase = TimeBase()
    parts: dict[str, list[tuple[Array, Array]]] = {}
    first = math.nan
    for chunk in LogReader([log], engine.router.matches):
        first = float(chunk.t[0]) if math.isnan(first) else first
        engine.columns(chunk, keep=False)
    router = make_engine(open_config(MEASURED_DRIVES / "kingston_2008.yaml")).router
    for chunk in LogReader([log], router.matches):
        for segment in timebase.segments(chunk.t):
            part = chunk.take(slice(segment.start, segment.stop))
            for c, s in router.columns(segment.t, part).samples.items():
                parts.setdefault(c, []).append((s.t, s.values))
    R = engine.pipeline.estimator.estimate().R_vehicle_from_sensor
    assert R is not None
    samples = {
        c: (np.concatenate([t for t, _ in p]), np.concatenate([v for _, v in p]))
        for c, p in parts.items()
    }
    return in_order(samples, R), _ins(first, R), R


def _ins(first: float, R_vehicle_from_sensor: Array) -> Truth:
    """INS angles (azimuth clockwise, pitch nose up, roll right side down; x right, y forward)."""
    found = []
    with gzip.open(DATA / "kingston_2008" / "ins_truth.csv.gz", "rt") as file:
        for line in csv.DictReader(file):
            pitch, roll = (math.radians(float(line[f"{k}_deg"])) for k in ("pitch", "roll"))
            C = rows_from_quaternion(
                quaternion_turned(quaternion_turned(IDENTITY, pitch, 0.0, 0.0), 0.0, roll, 0.0)
            )
            speed = math.hypot(float(line["v_east_mps"]), float(line["v_north_mps"]))
            found.append((float(line["time_s"]) - first, *C[6:9], speed))
    table = np.array(found)
    return Truth(table[:, 0], table[:, 1:4] @ R_vehicle_from_sensor.T, table[:, 4])
