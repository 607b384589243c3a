"""Outside effects of the accelerometer, its supply and what shakes it."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.outside_effects.spells import in_spells
from benchmarks.diagnosis.real_effects import Array, Drive
from imucald.core.samples import GRAVITY, Series


def shaking(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer's zero moves with the shaking: size is that of the roughest tenth."""
    t, x = s["accel"].t, s["accel"].values
    power = np.concatenate([[0.0], np.sum(np.diff(x, axis=0) ** 2, axis=1)])
    n = max(1, round(10.0 / float(np.median(np.diff(t)))))
    smooth = np.convolve(power, np.ones(n) / n, "same")
    set_values(s, "accel", x + size * (smooth / np.quantile(smooth, 0.9))[:, None] * R[0])
    return size


def swing(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A sideways force that swings at 0.5 Hz, in and out over minutes."""
    t = s["accel"].t
    loud = np.sin(np.pi * t / 170.0) ** 2
    push = size * loud * np.sin(np.pi * t + 2.0 * np.sin(t / 31.0))
    set_values(s, "accel", s["accel"].values + push[:, None] * R[1])
    return size


def gusts(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Sideways forces that last seconds, rms `size`, while moving."""
    t = s["accel"].t
    grid = np.arange(t[0], t[-1] + 2.0, 1.0)
    noise = rng.standard_normal(len(grid))
    slow = np.convolve(noise, np.ones(3) / np.sqrt(3.0), "same")
    speed = np.interp(t, s["speed"].t, s["speed"].values)
    push = size * np.interp(t, grid, slow) * (speed > 3.0)
    set_values(s, "accel", s["accel"].values + push[:, None] * R[1])
    return size


def hysteresis(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The zero forward stays at +-size after each strong acceleration or braking."""
    t, x = s["accel"].t, s["accel"].values
    n = max(1, round(1.0 / float(np.median(np.diff(t)))))
    forward = np.convolve(x @ R[0], np.ones(n) / n, "same")
    forward -= np.median(forward)
    state, held = np.empty(len(t)), 0.0
    for k, f in enumerate(forward):
        if abs(f) > 1.0:
            held = float(np.sign(f))
        state[k] = held
    set_values(s, "accel", x + size * state[:, None] * R[0])
    return size


def restarts(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer starts anew every four minutes, each time with another zero (rms size)."""
    t, x = s["accel"].t, s["accel"].values.copy()
    for start in np.arange(t[0] + 90.0, t[-1], 240.0):
        inside = (t >= start) & (t < start + 240.0)
        x[inside] += size * rng.standard_normal(3)
    set_values(s, "accel", x)
    return size


def loose_contact(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A connector opens for `size` seconds twice a minute, and the accelerometer says 0 on all
    axes."""
    t, x = s["accel"].t, s["accel"].values.copy()
    for start in np.arange(t[0], t[-1], 30.0):
        at = start + rng.uniform(0.0, 30.0 - size)
        x[(t >= at) & (t < at + size)] = 0.0
    set_values(s, "accel", x)
    return size


def supply_dips(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A fan on the sensor's supply, at irregular times: while it runs, the voltage falls by this
    share. A ratiometric accelerometer's gain falls with it, and its zero, which is half the supply,
    5 g above where it would say nothing (ADXL335 data sheet: 300 mV/g and 1.5 V, both at 3 V)."""
    t, x = s["accel"].t, s["accel"].values
    share = size * in_spells(t, 15.0, rng)
    set_values(s, "accel", x - share[:, None] * (x + 5.0 * 9.80665))
    return size


def engine_beat(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Firing of a four-cylinder engine shakes an accelerometer that has no filter before its
    converter: upward, with this amplitude [m/s^2], twice a turn of the crankshaft. What is sampled
    is a beat, slow where the firing comes near a multiple of the sample rate (Oppenheim, Schafer,
    Discrete-Time Signal Processing, 2010, 4.2; two firings a turn: Heywood, Internal Combustion
    Engine Fundamentals, 1988, 2.1). Five gears, shifted at 40 turns a second."""
    t = s["accel"].t
    grid = np.arange(t[0], t[-1] + 0.01, 0.01)
    v = np.interp(grid, s["speed"].t, np.abs(s["speed"].values))
    wheel = np.convolve(v, np.ones(100) / 100.0, "same") / (2.0 * np.pi * 0.3)
    turns = np.full(len(grid), 13.0)  # idle
    for overall in (3.2, 4.0, 5.5, 8.0, 13.5):
        at = overall * wheel
        turns = np.where((at > 20.0) & (at < 40.0), at, turns)
    phase = 4.0 * np.pi * np.cumsum(turns) * 0.01
    shake = size * np.sin(np.interp(t, grid, phase))
    set_values(s, "accel", s["accel"].values + shake[:, None] * R[2])
    return size


def auto_zero(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """An accelerometer that seeks its own zero: every 1.049 s each axis' zero moves by size [m/s^2]
    towards what the last six such spans showed on average, where that is more than half of size
    away. Long braking and long bends are taken for zero (NXP MMA68xx data sheet, 3.8.4, offset
    cancellation: a quarter of an LSB; at a range of 20 to 25 g an LSB is 0.04 to 0.05 g)."""
    t, x = s["accel"].t, s["accel"].values
    span = ((t - t[0]) / 1.049).astype(int)
    count = np.bincount(span)
    about = np.median(x, axis=0)
    sums = np.column_stack([np.bincount(span, axis) for axis in (x - about).T])
    zero, zeros = np.zeros(3), np.zeros((len(count) + 1, 3))
    for k in range(len(count)):
        last = slice(max(0, k - 5), k + 1)
        off = sums[last].sum(axis=0) / max(1, count[last].sum()) - zero
        zero = zero + size * np.sign(off) * (np.abs(off) > 0.5 * size)
        zeros[k + 1] = zero
    set_values(s, "accel", x - zeros[span])
    return size


def missing_bit(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """One bit of the converter that all axes share stays 0: while it should be 1, an axis shows
    size [m/s^2] too little (IEEE Std 1241-2010: missing codes; ISO 26262-5:2018, annex D: stuck-at
    faults). Bit 3 of a 12-bit converter of 5 V weighs 9.8 mV, and a g is 300 mV (ADXL335 data
    sheet). Each axis has its own zero among the codes."""
    x = s["accel"].values
    code = np.floor(x / size + rng.uniform(0.0, 2.0, 3))
    set_values(s, "accel", x - size * (code % 2.0))
    return size


def brake_lamps(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """An analogue accelerometer that shares a poor ground with the brake lamps: while they are lit,
    in braking and at a stop, each axis shows size [m/s^2] more. 4.5 A over 2 milliohm are 9 mV at
    300 mV/g (ISO 16750-2:2012, 4.8: offsets of the reference ground up to 1 V; ADXL335 data
    sheet)."""
    t = s["accel"].t
    grid = np.arange(t[0], t[-1], 0.1)
    v = np.interp(grid, s["speed"].t, s["speed"].values)
    smooth = np.convolve(v, np.ones(10) / 10.0, "same")
    lit = (np.gradient(smooth, 0.1) < -0.4) | (v < 0.5)
    on = np.interp(t, grid, lit.astype(float)) > 0.5
    set_values(s, "accel", s["accel"].values + size * on[:, None])
    return size


def auto_sleep(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """An accelerometer that saves current: after 5 s in which no axis has moved by more than 0.25 g
    past a high-pass filter of 2 Hz it sleeps, and makes a new value every size [s] only, with no
    filter before it but its own; what is read between is the last one. The first value that has
    moved by so much wakes it (Freescale MMA8451Q data sheet, 6.7, auto-wake and sleep, and register
    0x1F: steps of 0.063 g; AN4074). 1.56 Hz is its slowest rate. Vibration comes through as it is
    at that instant, and stands."""
    t, x = s["accel"].t, s["accel"].values
    mean, made, read = x[0], float(t[0]), np.zeros(len(t), dtype=int)
    moved, last = float(t[0]), 0
    for k in range(1, len(t)):
        asleep = made - moved > 5.0
        if not asleep or t[k] - made >= size:
            keep = np.exp(-2.0 * np.pi * 2.0 * (t[k] - made))
            mean = keep * mean + (1.0 - keep) * x[last]
            made, last = float(t[k]), k
            if np.abs(x[k] - mean).max() > 0.25 * GRAVITY:
                moved = made
        read[k] = last
    s["accel"] = Series(t, x[read])
    return size


def unit_length(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit sends the accelerometer after its attitude filter has scaled the vector to length 1
    for its own use, so that only the direction is left (Madgwick's filter as it is copied from one
    library to the next: kriswiner/MPU9250, ax *= norm; jremington/ICM_20948-AHRS, issue 15, where a
    user who publishes the vectors has to copy them before). The receiver takes 1 for g. Each bump
    makes the forces forward and sideways smaller, each hollow larger, and strong braking is shown
    weaker. size 1 is the whole of it. What length 1 stands for is right on average, so that no gain
    is put in."""
    x = s["accel"].values
    length = np.maximum(np.linalg.norm(x, axis=1), 1e-3)
    set_values(s, "accel", x * ((np.median(length) / length) ** size)[:, None])
    return size


def vibration_alert(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The sensor is a phone's, and somebody calls once in three to six minutes: for 20 s its motor
    shakes it, 1 s on and 1 s off (AOSP, Ringer.java: VIBRATE_LENGTH and PAUSE_LENGTH 1000), in
    the plane of two axes with size [m/s^2], 200 times a second and a few more or less. What is
    sampled is a beat. A coin motor shakes 100 g with 1.4 g (Precision Microdrives 310-103 data
    sheet), a phone of 170 g with 8 m/s^2, of which a sixth is left behind a filter of second order
    at 80 Hz (Bosch BMI160 data sheet: bandwidth at 200 Hz): 1.3."""
    t, at = s["accel"].t, float(s["accel"].t[0]) + rng.uniform(30.0, 180.0)
    first, second = rng.choice(3, 2, replace=False)
    push = np.zeros_like(s["accel"].values)
    while at < t[-1]:
        on = (t >= at) & (t < at + 20.0) & ((t - at) % 2.0 < 1.0)
        phase = 2.0 * np.pi * rng.uniform(195.0, 205.0) * (t[on] - at)
        push[on, first], push[on, second] = size * np.cos(phase), size * np.sin(phase)
        at += rng.uniform(180.0, 360.0)
    set_values(s, "accel", s["accel"].values + push)
    return size


def warm_gas(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The two axes that lie most level are those of a thermal accelerometer, which feels a heated
    bubble of gas move and has no compensation: its gain falls with the 2.67th power of the absolute
    temperature, in every unit the same (Memsic MXD2125 and MXD2002 data sheets, compensation for
    the change in sensitivity over temperature). It was calibrated in a warm car. In a drive that
    begins after a cold night the car's inside is size [K] below 20 degrees Celsius, and comes
    nearer with a time constant of ten minutes: from -10 degrees, where ADAC begins its test of
    heaters, which lasts half an hour, the gain is a third too high at first, and right at last."""
    t, x = s["accel"].t, s["accel"].values
    kelvin = 293.0 - size * np.exp(-(t - t[0]) / 600.0)
    gains = np.ones_like(x)
    gains[:, np.argsort(np.abs(R[2]))[:2]] = ((293.0 / kelvin) ** 2.67)[:, None]
    set_values(s, "accel", x * gains)
    return size


def tin_whisker(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A tin whisker lies between the outputs of an analogue accelerometer's two axes that lie most
    level, and touches both now and then, for 10 to 40 s: each axis then shows its own force less
    this share of the difference to the other's (Leidecker, Panashchenko, Brusse, Electrical failure
    of an accelerator pedal position sensor caused by a tin whisker, 5th International Tin Whisker
    Symposium, 2011: a short of some 250 ohm between two outputs). Each output has 32 kilohm
    (ADXL335 data sheet), beside which the whisker is nothing, so that both axes show the mean of
    the two, size 0.5: braking shows as half a bend."""
    t, x = s["accel"].t, s["accel"].values.copy()
    first, second = np.argsort(np.abs(R[2]))[:2]
    over = size * in_spells(t, 10.0, rng) * (x[:, second] - x[:, first])
    x[:, first] += over
    x[:, second] -= over
    set_values(s, "accel", x)
    return size


def slow_passes(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The sensor's controller smooths the accelerometer with a fixed weight for the newest value in
    each pass of its loop, and not by the time that went by (PX4/PX4-Autopilot, pull request 24116:
    such a filter has another time constant than is expected where the time between its steps
    changes; Ardumower/ardumower, issue 22). With a weight of 0.3 and 100 passes a second it takes
    0.03 s, which nobody minds. While the modem is asked, 5 to 40 s at a time, a pass takes 300 to
    500 ms (arduino-libraries/MKRGSM, issue 109), and the filter 0.8 to 1.4 s: size [s] is 1. That
    values stand between such passes is left out."""
    t, x = s["accel"].t, s["accel"].values.copy()
    asked = in_spells(t, 5.0, rng)
    keep = asked * np.exp(-np.diff(t, prepend=t[0]) / size)
    for k in range(1, len(t)):
        x[k] = keep[k] * x[k - 1] + (1.0 - keep[k]) * x[k]
    set_values(s, "accel", x)
    return size
