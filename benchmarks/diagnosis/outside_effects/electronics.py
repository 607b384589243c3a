"""Outside effects of wires, wheel sensors and converters."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.real_effects import Array, Drive
from imucald.core.samples import GRAVITY


def wheel_wire(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The wire of one front wheel's sensor has rubbed through, and opens where the wheels are
    steered to one side: in bends of less than 25 m radius that wheel says 0, and the speed, the
    mean of four wheels, is too low by this share (Honda service bulletin 97-072: harness of the
    front wheel sensor rubs against the wheel; commaai/opendbc, car/interfaces.py and carstate.py:
    mean of the wheel speeds). A quarter, one wheel of four, is what the fault takes."""
    gyro, t, v = s["gyro"], s["speed"].t, s["speed"].values
    n = max(1, round(1.0 / float(np.median(np.diff(gyro.t)))))
    upward = gyro.values @ R[2]
    upward = np.convolve(upward - np.median(upward), np.ones(n) / n, "same")
    turn = rng.choice([-1.0, 1.0]) * np.interp(t, gyro.t, upward)
    # 2 m/s: noise of the gyroscope is no bend.
    opened = (np.abs(v) > 2.0) & (turn > np.abs(v) / 25.0)
    set_values(s, "speed", v * np.where(opened, 1.0 - size, 1.0))
    return size


def idle_pulses(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """At a stop the idling engine shakes an edge of the toothed ring to and fro before a wheel
    sensor that has no vibration detection (Allegro ATS651LSH data sheet: what such a detection is
    for), and each shake counts as a tooth: the speed says size [m/s] and not 0. 25 firings a second
    and 48 teeth on 1.9 m are 1 m/s. The speed is that of the fastest wheel, and of four one stands
    so at nearly every stop."""
    v = s["speed"].values
    set_values(s, "speed", np.where(np.abs(v) < 0.3, size, v))
    return size


def left_charge(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """One converter reads a voltage of the speed, 20 mV per km/h, and after it the accelerometer's
    forward axis, whose output has 32 kilohm and no buffer. This share of the speed's voltage is
    left on the converter's capacitor and added to what the axis shows (Microchip, Analog-to-digital
    converter: channel to channel crosstalk and error; ADXL335 data sheet: 300 mV/g, 32 kilohm, a
    filter capacitor of 4.7 nF at least). 14 pF (ATmega328P) beside 4.7 nF leave 0.003 each time,
    and 0.006 where 10000 readings a second do not let it fade, in 0.15 ms: 0.28 m/s^2 at 20 m/s,
    which a user takes for a mount that pitches by 1.6 deg."""
    x = s["accel"].values.copy()
    v = np.interp(s["accel"].t, s["speed"].t, np.abs(s["speed"].values))
    x[:, int(np.argmax(np.abs(R[0])))] += size * 0.020 * 3.6 * v / 0.3 * GRAVITY
    set_values(s, "accel", x)
    return size


def supply_ripple(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A switching converter beside the gyroscope leaves a ripple on its supply, at nearly the
    frequency at which the axis that stands most upright is driven. The gyroscope takes it for a
    rate that swings with the difference of both, which wanders by 0.5 Hz to either side within 80 s
    as the converter's load changes (MPU-6000 and MPU-6050 data sheet, 6.1: power supply
    sensitivity, 250 Hz to 100 kHz, 4 deg/s at 100 mV peak to peak; mechanical frequencies, 27 kHz
    for the axis z; 11.4.3: active signals may couple harmonically with it). A ripple of 1 % of 3.3
    V, 33 mV, makes size [rad/s], 1.3 deg/s."""
    t, x = s["gyro"].t, s["gyro"].values.copy()
    apart = 0.5 * np.sin(2.0 * np.pi * t / 80.0 + rng.uniform(0.0, 2.0 * np.pi))
    phase = 2.0 * np.pi * (np.cumsum(apart * np.diff(t, prepend=t[0])) + rng.uniform())
    x[:, int(np.argmax(np.abs(R[2])))] += size * np.sin(phase)
    set_values(s, "gyro", x)
    return size
