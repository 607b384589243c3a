"""Effects that the catalogue does not have, put into measured samples.

By date: shaking, swing, gusts, hysteresis, dead_zone and glitches were written when the tests of
`imucald.diagnosis.adequacy` and the generator's own outside effects were known, and seen many times
since (hysteresis and dead_zone also before `patterns` and `held_values` were written): they show
what is seen, not what an effect that nobody thought of would do. fading, restarts and held_speed
were written on 2026-11-22, when the method stood, and not run before its judge. wheel_slip,
loose_contact and heated_gain were written on 2026-11-22 at 19:08, before anything of the tests was
changed that day, and not run before the judge of draw 14. Since then (19:20) all are put in on the
sensor's own levels: before, a gain made every value but 0 a level of its own, which gave it away.
gyro_highpass, supply_dips and speedometer were written on 2026-11-22 at 22:26, each from a
published source, before anything of the tests was looked at or changed that evening, and not run
before the judge of draw 15. clock_step and tyre_growth were written on 2026-11-23 at 01:45, before
anything of the tests was changed that day, and not run before the judge of draw 16. (A third of
that hour, a gyroscope that feels acceleration, was taken out before its outcome was looked at: the
catalogue has that cause.) uneven_gain, outer_wheel, engine_beat and tone_wheel were written on
2026-11-23 at 05:10, each from a published source, before anything of the tests was looked at or
changed in that session, and not run before the judge of draw 17, which has run them; only what an
ideal filter sees of them was computed before. auto_zero, learned_zero, whole_kmh and slow_wheels
were written on 2026-11-23 at 06:50, each from a published source, by one who read neither the tests
nor their page, and are not run before the judge of draw 23; again only what an ideal filter sees of
them was computed. (Two more of that hour, a soft holder's resonance at 5 Hz and a cab that pitches
at 1.2 Hz, were left out: the ideal filter saw each in no long log but one, and there at twice the
size. A speed held for 1 s and a jitter of stamps were left out for these four.)
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.diagnosis.real_effects import Drive, Put
from imucald.core.samples import Series

Array = NDArray[np.float64]


def _set(s: Drive, name: str, values: Array) -> None:
    """In the sensor's own levels: what acts on it acts before its converter."""
    old = s[name].values.reshape(len(values), -1).T
    new = values.reshape(len(values), -1).T
    columns = [_on_levels(x, y) for x, y in zip(old, new, strict=True)]
    s[name] = Series(s[name].t, np.column_stack(columns).reshape(values.shape))


def _on_levels(old: Array, new: Array) -> Array:
    levels = np.unique(old)
    if len(levels) < 3:
        return new
    step = float(np.quantile(np.diff(levels), 0.1))
    return np.asarray(levels[0] + np.round((new - levels[0]) / step) * step)


def _shaking(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer's zero moves with the shaking: size is that of the roughest tenth."""
    t, x = s["accel"].t, s["accel"].values
    power = np.concatenate([[0.0], np.sum(np.diff(x, axis=0) ** 2, axis=1)])
    n = max(1, round(10.0 / float(np.median(np.diff(t)))))
    smooth = np.convolve(power, np.ones(n) / n, "same")
    _set(s, "accel", x + size * (smooth / np.quantile(smooth, 0.9))[:, None] * R[0])
    return size


def _swing(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A sideways force that swings at 0.5 Hz, in and out over minutes."""
    t = s["accel"].t
    loud = np.sin(np.pi * t / 170.0) ** 2
    push = size * loud * np.sin(np.pi * t + 2.0 * np.sin(t / 31.0))
    _set(s, "accel", s["accel"].values + push[:, None] * R[1])
    return size


def _gusts(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Sideways forces that last seconds, rms `size`, while moving."""
    t = s["accel"].t
    grid = np.arange(t[0], t[-1] + 2.0, 1.0)
    noise = rng.standard_normal(len(grid))
    slow = np.convolve(noise, np.ones(3) / np.sqrt(3.0), "same")
    speed = np.interp(t, s["speed"].t, s["speed"].values)
    push = size * np.interp(t, grid, slow) * (speed > 3.0)
    _set(s, "accel", s["accel"].values + push[:, None] * R[1])
    return size


def _hysteresis(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
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
    _set(s, "accel", x + size * state[:, None] * R[0])
    return size


def _dead_zone(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope shows no rate below size [rad/s] on any axis."""
    x = s["gyro"].values
    _set(s, "gyro", np.sign(x) * np.maximum(np.abs(x) - size, 0.0))
    return size


def _glitches(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope jumps by size [rad/s] for a second, once a minute."""
    t, x = s["gyro"].t, s["gyro"].values.copy()
    for start in np.arange(t[0] + 20.0, t[-1], 60.0):
        at = start + rng.uniform(0.0, 30.0)
        x[(t >= at) & (t < at + 1.0), int(rng.integers(3))] += size * rng.choice([-1.0, 1.0])
    _set(s, "gyro", x)
    return size


def _fading(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The gyroscope's gain falls by this share within seconds of each strong turn, and recovers
    over 20 s: a sensor that heats itself."""
    t, x = s["gyro"].t, s["gyro"].values
    heat, step = np.zeros(len(t)), np.diff(t, prepend=t[0])
    load = np.minimum(np.linalg.norm(x, axis=1) / 0.2, 1.0)
    for k in range(1, len(t)):
        dt = min(float(step[k]), 1.0)
        heat[k] = heat[k - 1] + dt * (load[k] * (1.0 - heat[k - 1]) / 3.0 - heat[k - 1] / 20.0)
    _set(s, "gyro", x * (1.0 - size * heat)[:, None])
    return size


def _restarts(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer starts anew every four minutes, each time with another zero (rms size)."""
    t, x = s["accel"].t, s["accel"].values.copy()
    for start in np.arange(t[0] + 90.0, t[-1], 240.0):
        inside = (t >= start) & (t < start + 240.0)
        x[inside] += size * rng.standard_normal(3)
    _set(s, "accel", x)
    return size


def _held_speed(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed follows in braking, and holds back by `size` seconds when it rises."""
    t, v = s["speed"].t, s["speed"].values
    out = v.copy()
    for k in range(1, len(t)):
        keep = np.exp(-(t[k] - t[k - 1]) / size) if v[k] > out[k - 1] else 0.0
        out[k] = keep * out[k - 1] + (1.0 - keep) * v[k]
    _set(s, "speed", out)
    return size


def _wheel_slip(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The driven wheels spin when the vehicle pulls away hard: for two seconds at the beginning of
    every strong acceleration the speed is too high, by this share at most."""
    t, v = s["speed"].t, s["speed"].values
    grid = np.arange(t[0], t[-1], 0.1)
    smooth = np.convolve(np.interp(grid, t, v), np.ones(20) / 20.0, "same")
    pull = np.gradient(smooth, 0.1)
    pulling = pull[pull > 0.2]
    strong = pull > (np.quantile(pulling, 0.8) if len(pulling) else np.inf)
    out = v.copy()
    for start in grid[1:][strong[1:] & ~strong[:-1]]:
        at = (t - start) / 2.0
        inside = (at > 0.0) & (at < 1.0)
        out[inside] = v[inside] * (1.0 + size * np.sin(np.pi * at[inside]) ** 2)
    _set(s, "speed", out)
    return size


def _loose_contact(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A connector opens for `size` seconds twice a minute, and the accelerometer says 0 on all
    axes."""
    t, x = s["accel"].t, s["accel"].values.copy()
    for start in np.arange(t[0], t[-1], 30.0):
        at = start + rng.uniform(0.0, 30.0 - size)
        x[(t >= at) & (t < at + size)] = 0.0
    _set(s, "accel", x)
    return size


def _heated_gain(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A heater beside the gyroscope goes on and off every two minutes; its gain follows by this
    share within half a minute."""
    t, x = s["gyro"].t, s["gyro"].values
    on = np.floor((t - t[0]) / 120.0) % 2.0
    warm, step = np.zeros(len(t)), np.minimum(np.diff(t, prepend=t[0]), 1.0)
    for k in range(1, len(t)):
        warm[k] = warm[k - 1] + (on[k] - warm[k - 1]) * step[k] / 30.0
    _set(s, "gyro", x * (1.0 + rng.choice([-1.0, 1.0]) * size * warm)[:, None])
    return size


def _gyro_highpass(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A gyroscope whose high-pass filter was left on, corner at size [Hz]: it forgets long bends
    (ST LSM6DSO data sheet, CTRL7_G: HP_EN_G, 16 mHz is the lowest corner)."""
    t, x = s["gyro"].t, s["gyro"].values
    mean = np.zeros_like(x)
    keep = np.exp(-2.0 * np.pi * size * np.diff(t, prepend=t[0]))
    for k in range(1, len(t)):
        mean[k] = keep[k] * mean[k - 1] + (1.0 - keep[k]) * x[k]
    _set(s, "gyro", x - mean)
    return size


def _supply_dips(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A fan on the sensor's supply, at irregular times: while it runs, the voltage falls by this
    share. A ratiometric accelerometer's gain falls with it, and its zero, which is half the supply,
    5 g above where it would say nothing (ADXL335 data sheet: 300 mV/g and 1.5 V, both at 3 V)."""
    t, x = s["accel"].t, s["accel"].values
    share, at = np.zeros(len(t)), float(t[0]) + rng.uniform(10.0, 60.0)
    while at < t[-1]:
        runs = rng.uniform(15.0, 40.0)
        share[(t >= at) & (t < at + runs)] = size
        at += runs + rng.uniform(30.0, 120.0)
    _set(s, "accel", x - share[:, None] * (x + 5.0 * 9.80665))
    return size


def _speedometer(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of the instrument, which by law never shows too little: above 10 km/h it
    adds size [m/s] to the true one (UN Regulation 39, 5.3: up to 4 km/h and a tenth)."""
    v = s["speed"].values
    _set(s, "speed", v + size * np.sign(v) * np.minimum(np.abs(v) * 3.6 / 10.0, 1.0))
    return size


def _clock_step(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit that stamps the speed sets its clock once: from then on stamps are late by size [s]
    (ntpd steps a clock that is off by more than 0.128 s, RFC 5905, STEPT)."""
    t = s["speed"].t
    at = t[0] + rng.uniform(0.35, 0.65) * (t[-1] - t[0])
    s["speed"] = Series(t + size * (t >= at), s["speed"].values)
    return size


def _tyre_growth(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Tyres grow with the square of the speed, by this share at 40 m/s, and wheels that count turns
    show too little (Pacejka, Tyre and Vehicle Dynamics, 2012, 8.3.1: growth of the free radius)."""
    v = s["speed"].values
    _set(s, "speed", v * (1.0 - size * (v / 40.0) ** 2))
    return size


def _uneven_gain(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A gyroscope whose gain is this share too high for one way of turning and too low for the
    other (IEEE Std 528-2019: scale factor asymmetry)."""
    x = s["gyro"].values
    _set(s, "gyro", x + rng.choice([-1.0, 1.0]) * size * np.abs(x))
    return size


def _outer_wheel(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of the fastest wheel ("select high") and not of the middle: in a bend it is
    too high by the yaw rate's amount times half the track, size [m] (Rajamani, Vehicle Dynamics and
    Control, 2012, 8.2: speeds of the left and the right wheels)."""
    gyro, t, v = s["gyro"], s["speed"].t, s["speed"].values
    n = max(1, round(0.2 / float(np.median(np.diff(gyro.t)))))
    upward = np.convolve(gyro.values @ R[2], np.ones(n) / n, "same")
    turn = np.abs(np.interp(t, gyro.t, upward))
    _set(s, "speed", v + size * turn * (np.abs(v) > 0.5))
    return size


def _engine_beat(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
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
    _set(s, "accel", s["accel"].values + shake[:, None] * R[2])
    return size


def _tone_wheel(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of one wheel whose toothed ring is not centred: it swings by this share
    once a turn of the wheel, 1.9 m (Persson, Gustafsson, Event based sampling with application to
    vibration analysis in pneumatic tires, ICASSP 2001: errors of the teeth)."""
    t, v = s["speed"].t, s["speed"].values
    way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    _set(s, "speed", v * (1.0 + size * np.sin(2.0 * np.pi * way / 1.9 + rng.uniform(0.0, 6.0))))
    return size


def _auto_zero(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
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
    _set(s, "accel", x - zeros[span])
    return size


def _learned_zero(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
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
    _set(s, "gyro", x - zeros)
    return size


def _whole_kmh(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed comes in whole steps of size [m/s], to the nearest (SAE J1979, PID 0x0D: one byte,
    1 km/h a bit)."""
    own = s["speed"]
    s["speed"] = Series(own.t, size * np.round(own.values / size))
    return size


def _slow_wheels(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Passive (inductive) wheel sensors give too little voltage at a crawl: below size [m/s] the
    speed says 0 (Tire Review, Passive wheel speed sensors: nothing at or below 2 mph)."""
    own = s["speed"]
    s["speed"] = Series(own.t, np.where(np.abs(own.values) <= size, 0.0, own.values))
    return size


OUTSIDE: Mapping[str, tuple[Put, float, str]] = {
    "shaking": (_shaking, 0.3, "accel"),
    "swing": (_swing, 0.4, "accel"),
    "gusts": (_gusts, 0.4, "accel"),
    "hysteresis": (_hysteresis, 0.2, "accel"),
    "dead_zone": (_dead_zone, 0.035, "gyro"),
    "glitches": (_glitches, 0.2, "gyro"),
    "fading": (_fading, 0.25, "gyro"),
    "restarts": (_restarts, 0.3, "accel"),
    "held_speed": (_held_speed, 1.0, "speed"),
    "wheel_slip": (_wheel_slip, 0.15, "speed"),
    "loose_contact": (_loose_contact, 0.3, "accel"),
    "heated_gain": (_heated_gain, 0.15, "gyro"),
    "gyro_highpass": (_gyro_highpass, 0.016, "gyro"),
    "supply_dips": (_supply_dips, 0.005, "accel"),
    "speedometer": (_speedometer, 4.0 / 3.6, "speed"),
    "clock_step": (_clock_step, 0.15, "speed"),
    "tyre_growth": (_tyre_growth, 0.015, "speed"),
    "uneven_gain": (_uneven_gain, 0.05, "gyro"),
    "outer_wheel": (_outer_wheel, 0.75, "gyro"),
    "engine_beat": (_engine_beat, 1.0, "accel"),
    "tone_wheel": (_tone_wheel, 0.02, "speed"),
    "auto_zero": (_auto_zero, 0.1, "accel"),
    "learned_zero": (_learned_zero, float(np.deg2rad(3.0)), "gyro"),
    "whole_kmh": (_whole_kmh, 1.0 / 3.6, "speed"),
    "slow_wheels": (_slow_wheels, 0.9, "speed"),
}
"""Effect, medium size [SI], signal that must be there."""
NOT_RUN = ("auto_zero", "learned_zero", "whole_kmh", "slow_wheels")
"""Written on 2026-11-23 at 06:50; not run before the judge of draw 23."""
