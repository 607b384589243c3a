"""Outside effects of what reads, packs and thins the samples on their way into the log."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

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


def lost_sign(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The logger writes the accelerometer as text, the whole part and the fraction one after the
    other, and a whole part of 0 has no sign: what lies between -size and 0 [m/s^2] comes out
    positive. 1 m/s^2 is the unit that is written (ARMmbed/mbed-os, issue 13783: minimal-printf
    doesn't display decimals between -1 to 0 correctly; the same in apache/mynewt-core, 1337)."""
    x = s["accel"].values
    set_values(s, "accel", np.where((x > -size) & (x < 0.0), -x, x))
    return size


def bit_errors(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer comes by radio in packets of 20 bytes, three samples of three words, and
    nobody looks at the checksum: in this share of the packets one bit is wrong. 0.01 of the packets
    is where a data sheet ends the range of its receiver (Texas Instruments CC1101 data sheet,
    sensitivity). Words are those of an MPU-6050 at +-8 g, 4096 a g; each of the 16 bits is as
    likely as the others."""
    x, per_g = s["accel"].values.copy(), 4096.0 / GRAVITY
    packets = np.flatnonzero(rng.random(len(x) // 3) < size)
    rows, axes = (
        3 * packets + rng.integers(3, size=len(packets)),
        rng.integers(3, size=len(packets)),
    )
    word = np.clip(np.round(x[rows, axes] * per_g), -32768, 32767).astype(np.int64)
    wrong = (word & 0xFFFF) ^ (1 << rng.integers(16, size=len(packets)))
    signed = (wrong ^ 0x8000) - 0x8000  # two's complement
    x[rows, axes] += (signed - word) / per_g
    set_values(s, "accel", x)
    return size


def filled_gaps(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A wireless sensor loses its link once in 20 to 60 s, for size [s], until both sides notice it
    and connect anew (Bluetooth Core Specification, volume 6, part B, 4.5.2: supervision timeout, up
    to 32 s; Apple, Accessory Design Guidelines: 2 to 6 s). What is missing is filled in later by
    straight lines, so that no stamp is missing (John et al., An open-source monitor-independent
    movement summary for accelerometer data processing, Journal for the Measurement of Physical
    Behaviour 2, 2019, and its interpolate_signal: gaps are filled by interpolation)."""
    start, stop = (float(x) for x in s["accel"].t[[0, -1]])
    gaps, at = [], start + rng.uniform(20.0, 60.0)
    while at + size < stop:
        gaps.append(at)
        at += size + rng.uniform(20.0, 60.0)
    for name in ("accel", "gyro"):
        if name in s:
            t, x = s[name].t, s[name].values
            kept = np.ones(len(t), dtype=bool)
            for at in gaps:
                kept &= (t < at) | (t >= at + size)
            set_values(s, name, _at(t, t[kept], x[kept]))
    return size


def outliers_filled(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The log was cleaned: on each axis of the accelerometer and of the gyroscope what lies more
    than size scaled median absolute deviations off the median of the whole log counts as an
    outlier, and straight lines take its place (MathWorks, filloutliers, method linear; three is
    what it takes without being asked). Most of a drive is straight, so bends and hard braking are
    outliers."""
    for name in ("accel", "gyro"):
        if name in s:
            t, x = s[name].t, s[name].values.copy()
            off = np.abs(x - np.median(x, axis=0))
            kept = off <= size * 1.4826 * np.median(off, axis=0)
            for axis, own in enumerate(kept.T):
                x[:, axis] = np.interp(t, t[own], x[own, axis])
            set_values(s, name, x)
    return size


def other_answers(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Answers to several questions come under one identifier, and the decoder does not look at
    which question each answers: in this share of the frames, evenly spaced, the speed is what
    another quantity has in the same byte (collin80/SavvyCAN, issue 754: a multiplexed signal
    toggles between its value and a wrong one; bit-dream/candied, issue 44: the same with OBD-II;
    danielhrisca/asammdf, issue 257: every 25th value is another). 0.04 is that. The other is the
    coolant's temperature, 90 degrees, which is 130 in its byte, and 130 km/h (SAE J1979, PIDs 0x05
    and 0x0D)."""
    t, v = s["speed"].t, s["speed"].values
    every = max(2, round(1.0 / size))
    other = np.arange(len(t)) % every == int(rng.integers(every))
    s["speed"] = Series(t, np.where(other, 130.0 / 3.6, v))
    return size


def slope_overload(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope is sent as differences of one byte, and what does not fit is cut: no axis can
    follow a rate that changes faster than size [rad/s^2], and comes after when the change is over
    (Jayant, Noll, Digital Coding of Waveforms, 1984, chapter 8: slope overload of delta
    modulation). 127 steps of 1 / 131 deg/s (MPU-6050 data sheet) ten times a second are 9.7
    deg/s^2: a bend begins late and ends late, the more so the sharper it is."""
    t, x = s["gyro"].t, s["gyro"].values
    shown, last = np.empty_like(x), x[0]
    for k, most in enumerate(size * np.diff(t, prepend=t[0])):
        last = last + np.clip(x[k] - last, -most, most)
        shown[k] = last
    set_values(s, "gyro", shown)
    return size


def fourier_blocks(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Accelerometer and gyroscope are sent as the ten lowest Fourier coefficients of each axis over
    blocks of size [s] (CRAN TSrepr, repr_dft: ten without being asked; cmcuza/TerseTS, pull request
    121: one chooses the number of coefficients, and no bound of the error can be had). The
    transform takes a block to go on with its own beginning: where a block ends otherwise than it
    began, as in braking or in a bend, both ends come out as the mean of the two, with waves of a
    second beside them. At 10 s the ten coefficients reach to 0.9 Hz, above what a driver does;
    shaking is lost."""
    start = s["accel"].t[0]
    for name in ("accel", "gyro"):
        if name in s:
            t, x = s[name].t, s[name].values.copy()
            edges = np.flatnonzero(np.diff(((t - start) / size).astype(int))) + 1
            for first, end in pairwise([0, *edges.tolist(), len(t)]):
                kept = np.fft.rfft(x[first:end], axis=0)
                kept[10:] = 0.0
                x[first:end] = np.fft.irfft(kept, end - first, axis=0)
            set_values(s, name, x)
    return size


def digits_as_hex(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A tracker sends its speed in whole knots as decimal digits of four bits each, and the decoder
    takes them for one number, so that a ten counts 16 (traccar/traccar, H02ProtocolDecoder: digits,
    in knots; issue 1404: a device that sends digits where the decoder reads a number). The user has
    set the gain by the way that the vehicle goes, so that it is right over the log, and the speed
    grows too slowly within each ten and jumps at the next: 9 knots and 10 are 7 apart. A ten counts
    10 and 6 * size, size 1 is the whole of it."""
    own = s["speed"]
    tens, ones = np.divmod(np.round(np.abs(own.values) / 0.5144), 10.0)
    shown = (10.0 + 6.0 * size) * tens + ones
    step = np.diff(own.t, prepend=own.t[0])
    way, counted = float((np.abs(own.values) * step).sum()), float((shown * step).sum())
    s["speed"] = Series(own.t, np.sign(own.values) * shown * way / max(counted, 1e-9))
    return size


def few_components(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Accelerometer and gyroscope are sent as principal components: the axes of a minute, each less
    its mean and over its deviation, are turned into components of which the largest are kept until
    no more than this share of the variance is missing (Le Borgne, Raybaud, Bontempi, Distributed
    principal component analysis for wireless sensor networks, Sensors 8, 2008; scikit-learn, PCA:
    n_components below 1; 0.95 is what most examples keep). What is left out is not noise but how
    the axes differ from what they mostly do together: if in that minute most bends are taken at one
    speed, a faster one comes out with too much of the rate and too little of the force."""
    names = [name for name in ("accel", "gyro") if name in s]
    axes = {
        at: np.column_stack([_at(s[at].t, s[name].t, s[name].values) for name in names])
        for at in names
    }
    shown = {at: x.copy() for at, x in axes.items()}
    for start in np.arange(s["accel"].t[0], s["accel"].t[-1] + 1e-6, 60.0):
        minute = {at: (s[at].t >= start) & (s[at].t < start + 60.0) for at in names}
        x = axes["accel"][minute["accel"]]
        if len(x) < 10:
            continue
        mean, deviation = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
        _, strength, ways = np.linalg.svd((x - mean) / deviation, full_matrices=False)
        there = np.cumsum(strength**2) / max(float((strength**2).sum()), 1e-9)
        ways = ways[: int(np.searchsorted(there, 1.0 - size)) + 1]
        for at, inside in minute.items():
            kept = (axes[at][inside] - mean) / deviation @ ways.T @ ways
            shown[at][inside] = mean + kept * deviation
    for k, name in enumerate(names):
        set_values(s, name, shown[name][:, 3 * k : 3 * k + 3])
    return size


def running_median(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Before it was stored the speed went through a running median over size [s], against spikes:
    five values, one a second (pnbruckner/ha-composite-tracker, issue 69: of mean, line and median
    over five, the median does it; GoldenCheetah/GoldenCheetah, pull request 3887: it keeps sharp
    edges). Each window has its stamp in its middle. Where the speed only rises or only falls, it is
    right; where it turns, as where a driver brakes for a bend and pulls away again, the peak and
    the hollow are cut off, and a halt of less than half of size is gone."""
    t, v = s["speed"].t, s["speed"].values
    half = max(1, round(0.5 * size / float(np.median(np.diff(t)))))
    set_values(s, "speed", median_filter(v, 2 * half + 1, mode="nearest"))
    return size


def _at(t: Array, own: Array, values: Array) -> Array:
    """(N, 3) values at other times."""
    return np.column_stack([np.interp(t, own, axis) for axis in values.T])
