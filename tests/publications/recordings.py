"""Measured recordings, unpacked by hand from the frames of their common database."""

from __future__ import annotations

import csv
import gzip

import numpy as np
import pytest

from paths import SHARED_DATA

SCALES = {
    0x200: ("accel", 0.002),
    0x201: ("gyro", np.radians(0.02)),
    0x202: ("speed", 0.01),
    0x204: ("mag", 0.02e-6),
}
START = 1600000000.0


def recording(name):
    """{channel: (t (N,), values (N, 3) or (N,))}, SI units, seconds since the log's zero."""
    path = SHARED_DATA / name / "drive.log.gz"
    if not path.exists():
        pytest.skip(f"measured data not here: {path}")
    found = {}
    with gzip.open(path, "rt") as lines:
        for line in lines:
            stamp, _, frame = line.split()
            can_id, _, data = frame.partition("#")
            times, payloads = found.setdefault(int(can_id, 16), ([], []))
            times.append(float(stamp[1:-1]) - START)
            payloads.append(bytes.fromhex(data))
    samples = {}
    for can_id, (times, payloads) in found.items():
        channel, scale = SCALES[can_id]
        if channel == "speed":
            values = np.frombuffer(b"".join(p[:2] for p in payloads), "<u2") * scale
        else:
            values = np.frombuffer(b"".join(payloads), "<i2").reshape(-1, 4)[:, :3] * scale
        samples[channel] = np.array(times), np.ascontiguousarray(values)
    return samples


def table(name, file):
    """A table beside a recording: {column: (N,)}; time_s counts from the log's zero."""
    path = SHARED_DATA / name / file
    if not path.exists():
        pytest.skip(f"measured data not here: {path}")
    with gzip.open(path, "rt") as lines:
        rows = list(csv.DictReader(lines))
    columns = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
    columns["time_s"] -= START
    return columns
