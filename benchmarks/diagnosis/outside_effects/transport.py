"""Outside effects of what reads, packs and thins the samples on their way into the log."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.real_effects import Array, Drive
from imucald.core.samples import GRAVITY, Series

MPS2_PER_RADPS = float(np.rad2deg(1.0)) * 131.0 / 16384.0 * GRAVITY
"""What a rate's word means where an acceleration's is expected (MPU-6050 data sheet, ranges of
+-250 deg/s and +-2 g: 131 a deg/s, 16384 a g)."""


def shifted_words(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The sensor's FIFO of 1024 bytes overflows once in one to two minutes. A sample has 12 bytes
    (acceleration x, y, z, rate x, y, z), so the oldest 4 bytes that are left are the end of a
    sample, and each word is read two places late: the accelerometer shows the rates y and z and its
    own x, the gyroscope the accelerations y and z and its own x. This lasts size [s], a full FIFO
    at 100 Hz, until the driver finds the overflow and empties it (MPU-6050 register map: FIFO_R_W,
    FIFO_OFLOW_INT; libdriver/mpu6050, issue 39: FIFO data alignment)."""
    own, gyro = s["accel"], s["gyro"]
    rates = _at(own.t, gyro.t, gyro.values) * MPS2_PER_RADPS
    forces = _at(gyro.t, own.t, own.values) / MPS2_PER_RADPS
    accel_late = np.column_stack([rates[:, 1], rates[:, 2], own.values[:, 0]])
    gyro_late = np.column_stack([forces[:, 1], forces[:, 2], gyro.values[:, 0]])
    at, bad_accel, bad_gyro = (
        float(own.t[0]),
        np.zeros(len(own.t), bool),
        np.zeros(len(gyro.t), bool),
    )
    while (at := at + rng.uniform(60.0, 120.0)) < own.t[-1]:
        bad_accel |= (own.t >= at) & (own.t < at + size)
        bad_gyro |= (gyro.t >= at) & (gyro.t < at + size)
    set_values(s, "accel", np.where(bad_accel[:, None], accel_late, own.values))
    set_values(s, "gyro", np.where(bad_gyro[:, None], gyro_late, gyro.values))
    return size


def lost_differences(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer's values are sent as differences, with whole values every 10 s. This share
    of the differences is lost, and the receiver adds up the others: until the next whole values all
    axes are off by what was lost (Jayant, Noll, Digital Coding of Waveforms, 1984, chapter 6: DPCM
    with transmission errors; ITU-T Y.1541: up to 1 in 1000 packets may be lost)."""
    t, x = s["accel"].t, s["accel"].values
    span = ((t - t[0]) / 10.0).astype(int)
    whole = np.diff(span, prepend=-1) > 0
    lost = (rng.random(len(t)) < size) & ~whole
    gone = np.cumsum(np.diff(x, axis=0, prepend=x[:1]) * lost[:, None], axis=0)
    first = np.maximum.accumulate(np.where(whole, np.arange(len(t)), 0))
    set_values(s, "accel", x - (gone - gone[first]))
    return size


def curve_logging(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit sends only the corners of the speed: a line through them misses no sample by more
    than size [m/s] (Ramer, Douglas, Peucker), and the receiver fills in between by straight lines.
    Corners are sought when 100 s are together, and where the vehicle stops or pulls away (Geotab,
    GPS curve log reasons: CurveSpeed, CurveTimeOut, CurveZeroSpeed; a receiver's speed counts as
    valid there to 1 m/s)."""
    t, v = s["speed"].t, s["speed"].values
    span, stands = ((t - t[0]) / 100.0).astype(int), v < 0.1
    edge = (np.diff(span, prepend=-1) > 0) | (np.diff(stands, prepend=stands[0]) != 0)
    edge[-1] = True
    kept = edge.copy()
    ends = np.flatnonzero(edge)
    parts = list(pairwise(ends.tolist()))
    while parts:
        a, b = parts.pop()
        off = np.abs(v[a : b + 1] - np.interp(t[a : b + 1], t[[a, b]], v[[a, b]]))
        k = a + int(np.argmax(off))
        if a < k < b and off[k - a] > size:
            kept[k] = True
            parts += [(a, k), (k, b)]
    s["speed"] = Series(t, np.interp(t, t[kept], v[kept]))
    return size


def swapped_blocks(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Accelerometer and gyroscope are sent in blocks of 1 s by a queue that does not keep the order
    (Amazon SQS developer guide, standard queues: best-effort ordering), and the receiver puts them
    one after another as they come: this share of the blocks stands after the block that should
    follow. Of packets in a backbone 0.05 are out of order, most since they were lost and sent again
    (Jaiswal et al., Measurement and classification of out-of-sequence packets in a tier-1 IP
    backbone, IEEE/ACM Transactions on Networking 15, 2007)."""
    start, stop = s["accel"].t[[0, -1]]
    late = rng.random(int(stop - start) + 3) < size
    # Neither a block that was overtaken nor the last overtakes.
    late[1:] &= ~late[:-1]
    late[-2:] = False
    place = np.arange(len(late)) + 1.5 * late
    for name in ("accel", "gyro"):
        if name in s:
            t = s[name].t
            block = np.clip((t - start).astype(int), 0, len(late) - 1)
            order = np.argsort(place[block], kind="stable")  # no sample is lost, none comes twice
            s[name] = Series(t, s[name].values[order])
    return size


def _at(t: Array, own: Array, values: Array) -> Array:
    """(N, 3) values at other times."""
    return np.column_stack([np.interp(t, own, axis) for axis in values.T])
