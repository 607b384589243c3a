"""Outside effects of the gyroscope."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.outside_effects.spells import in_spells
from benchmarks.diagnosis.real_effects import Array, Drive


def dead_zone(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope shows no rate below size [rad/s] on any axis."""
    x = s["gyro"].values
    set_values(s, "gyro", np.sign(x) * np.maximum(np.abs(x) - size, 0.0))
    return size


def glitches(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope jumps by size [rad/s] for a second, once a minute."""
    t, x = s["gyro"].t, s["gyro"].values.copy()
    for start in np.arange(t[0] + 20.0, t[-1], 60.0):
        at = start + rng.uniform(0.0, 30.0)
        x[(t >= at) & (t < at + 1.0), int(rng.integers(3))] += size * rng.choice([-1.0, 1.0])
    set_values(s, "gyro", x)
    return size


def fading(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope's gain falls by this share within seconds of each strong turn, and recovers
    over 20 s: a sensor that heats itself."""
    t, x = s["gyro"].t, s["gyro"].values
    heat, step = np.zeros(len(t)), np.diff(t, prepend=t[0])
    load = np.minimum(np.linalg.norm(x, axis=1) / 0.2, 1.0)
    for k in range(1, len(t)):
        dt = min(float(step[k]), 1.0)
        heat[k] = heat[k - 1] + dt * (load[k] * (1.0 - heat[k - 1]) / 3.0 - heat[k - 1] / 20.0)
    set_values(s, "gyro", x * (1.0 - size * heat)[:, None])
    return size


def heated_gain(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A heater beside the gyroscope goes on and off every two minutes; its gain follows by this
    share within half a minute."""
    t, x = s["gyro"].t, s["gyro"].values
    on = np.floor((t - t[0]) / 120.0) % 2.0
    warm, step = np.zeros(len(t)), np.minimum(np.diff(t, prepend=t[0]), 1.0)
    for k in range(1, len(t)):
        warm[k] = warm[k - 1] + (on[k] - warm[k - 1]) * step[k] / 30.0
    set_values(s, "gyro", x * (1.0 + rng.choice([-1.0, 1.0]) * size * warm)[:, None])
    return size


def gyro_highpass(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A gyroscope whose high-pass filter was left on, corner at size [Hz]: it forgets long bends
    (ST LSM6DSO data sheet, CTRL7_G: HP_EN_G, 16 mHz is the lowest corner)."""
    t, x = s["gyro"].t, s["gyro"].values
    mean = np.zeros_like(x)
    keep = np.exp(-2.0 * np.pi * size * np.diff(t, prepend=t[0]))
    for k in range(1, len(t)):
        mean[k] = keep[k] * mean[k - 1] + (1.0 - keep[k]) * x[k]
    set_values(s, "gyro", x - mean)
    return size


def uneven_gain(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A gyroscope whose gain is this share too high for one way of turning and too low for the
    other (IEEE Std 528-2019: scale factor asymmetry)."""
    x = s["gyro"].values
    set_values(s, "gyro", x + rng.choice([-1.0, 1.0]) * size * np.abs(x))
    return size


def learned_zero(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A gyroscope whose firmware learns its zero: after 5 s in which no axis showed more than size
    [rad/s] it takes itself to be at rest, and what it shows for its zero, with a corner at 0.02 Hz.
    It forgets gentle bends, and keeps what it learned there until the next rest (x-io Fusion,
    FusionBias.c, its version of 2021: STATIONARY_PERIOD, CORNER_FREQUENCY; 3 deg/s is the threshold
    of later versions)."""
    t, x = s["gyro"].t, s["gyro"].values
    about = np.median(x, axis=0)
    zero, zeros, still = np.zeros(3), np.zeros_like(x), 0.0
    for k, dt in enumerate(np.minimum(np.diff(t, prepend=t[0]), 1.0)):
        zeros[k], shown = zero, x[k] - about - zero
        if np.abs(shown).max() > size:
            still = 0.0
        elif still < 5.0:
            still += float(dt)
        else:
            zero = zero + shown * (2.0 * np.pi * 0.02 * dt)
    set_values(s, "gyro", x - zeros)
    return size


def range_reset(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Start-stop: where the engine starts again after a stop of 3 s and more, the supply falls so
    far that the gyroscope's registers fall back to their reset values, +-250 deg/s in place of
    +-500. It shows twice the rate, until the driver checks the registers size [s] later (MPU-9250
    register map: awake after reset, FS_SEL 0; ISO 16750-2:2012, 4.6.3: starting profile). The
    accelerometer is used in its default range and shows nothing of it."""
    gyro, t, still = s["gyro"], s["speed"].t, s["speed"].values < 0.3
    gain = np.ones(len(gyro.t))
    for k in np.flatnonzero(still[:-1] & ~still[1:]) + 1:
        moved = t[:k][~still[:k]]
        if t[k] - (moved[-1] if len(moved) else t[0]) > 3.0:
            start = t[k] - 1.0
            gain[(gyro.t >= start) & (gyro.t < start + size)] = 2.0
    set_values(s, "gyro", gyro.values * gain[:, None])
    return size


def second_gyro(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Of two gyroscopes the first fails again and again for 10 to 40 s, and the second, whose zero
    is size [rad/s] off on each axis, takes its place meanwhile (PX4-Autopilot,
    DataValidatorGroup::get_best: the best sensor is shown, and the first again once it is sound).
    0.05 deg/s a kelvin over 6 K (Bosch BMI160 data sheet: change of the zero with temperature)."""
    t, x = s["gyro"].t, s["gyro"].values
    second = size * in_spells(t, 10.0, rng)
    set_values(s, "gyro", x + second[:, None] * rng.choice([-1.0, 1.0], 3))
    return size


def compass_pull(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit shows rates less the zero that its attitude filter learns, and the filter follows a
    compass: beside trucks and below bridges, 5 to 40 s at a time, the field points size [rad] to
    one side, and the zero about the upward axis runs off and comes back (PX4-Autopilot,
    attitude_estimator_q: ATT_W_MAG 0.1, ATT_W_GYRO_BIAS 0.1, ATT_BIAS_MAX 0.05 rad/s). 50 mG across
    a level field of 200 to 300 mG are 10 to 14 deg (Caruso, Withanawasam, Vehicle detection and
    compass applications using AMR magnetic sensors, Sensors Expo 1999)."""
    t, step = s["gyro"].t, 0.1
    grid = np.arange(t[0], t[-1] + step, step)
    beside = in_spells(grid, 5.0, rng)
    place = np.cumsum(np.diff(beside.astype(int), prepend=0) > 0)
    field = size * beside * rng.choice([-1.0, 1.0], int(place[-1]) + 1)[place]
    heading, zero, zeros = 0.0, 0.0, np.zeros(len(grid))
    for k, to in enumerate(field):
        pull = 0.1 * (to - heading)
        zero = float(np.clip(zero + 0.1 * pull * step, -0.05, 0.05))
        heading += (zero + pull) * step
        zeros[k] = zero
    set_values(s, "gyro", s["gyro"].values + np.interp(t, grid, zeros)[:, None] * R[2])
    return size


def late_sign(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The rate about the upward axis is that of a car which sends the amount and the sign as two
    signals (commaai/opendbc, vw_mqb: ESP_Gierrate and ESP_VZ_Gierrate; commaai/openpilot, pull
    request 20238: the amount of such a rate was right and its sign that of another signal, and
    nobody saw it for a long time). The logger takes amounts as they come and what has one bit, as a
    switch, every size [s] only, and the two are put together afterwards: where the rate changes its
    side it keeps the old one until the next bit. 1 s is a usual slow raster of a logger. All else
    of such a rate is left as the gyroscope has it."""
    t, x = s["gyro"].t, s["gyro"].values
    upward = x @ R[2] - np.median(x @ R[2])
    raster = ((t - t[0]) / size).astype(int)
    bits = np.maximum.accumulate(np.where(np.diff(raster, prepend=-1) > 0, np.arange(len(t)), 0))
    shown = np.abs(upward) * np.where(upward[bits] < 0.0, -1.0, 1.0)
    set_values(s, "gyro", x + (shown - upward)[:, None] * R[2])
    return size
