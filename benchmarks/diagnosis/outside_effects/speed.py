"""Outside effects of the speed: wheels, instruments, receivers, and the clock that stamps it."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.real_effects import Array, Drive
from imucald.core.samples import Series


def held_speed(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed follows in braking, and holds back by `size` seconds when it rises."""
    t, v = s["speed"].t, s["speed"].values
    out = v.copy()
    for k in range(1, len(t)):
        keep = np.exp(-(t[k] - t[k - 1]) / size) if v[k] > out[k - 1] else 0.0
        out[k] = keep * out[k - 1] + (1.0 - keep) * v[k]
    set_values(s, "speed", out)
    return size


def wheel_slip(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
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
    set_values(s, "speed", out)
    return size


def speedometer(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of the instrument, which by law never shows too little: above 10 km/h it
    adds size [m/s] to the true one (UN Regulation 39, 5.3: up to 4 km/h and a tenth)."""
    v = s["speed"].values
    set_values(s, "speed", v + size * np.sign(v) * np.minimum(np.abs(v) * 3.6 / 10.0, 1.0))
    return size


def clock_step(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit that stamps the speed sets its clock once: from then on stamps are late by size [s]
    (ntpd steps a clock that is off by more than 0.128 s, RFC 5905, STEPT)."""
    t = s["speed"].t
    at = t[0] + rng.uniform(0.35, 0.65) * (t[-1] - t[0])
    s["speed"] = Series(t + size * (t >= at), s["speed"].values)
    return size


def tyre_growth(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Tyres grow with the square of the speed, by this share at 40 m/s, and wheels that count turns
    show too little (Pacejka, Tyre and Vehicle Dynamics, 2012, 8.3.1: growth of the free radius)."""
    v = s["speed"].values
    set_values(s, "speed", v * (1.0 - size * (v / 40.0) ** 2))
    return size


def outer_wheel(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of the fastest wheel ("select high") and not of the middle: in a bend it is
    too high by the yaw rate's amount times half the track, size [m] (Rajamani, Vehicle Dynamics and
    Control, 2012, 8.2: speeds of the left and the right wheels)."""
    gyro, t, v = s["gyro"], s["speed"].t, s["speed"].values
    n = max(1, round(0.2 / float(np.median(np.diff(gyro.t)))))
    upward = np.convolve(gyro.values @ R[2], np.ones(n) / n, "same")
    turn = np.abs(np.interp(t, gyro.t, upward))
    set_values(s, "speed", v + size * turn * (np.abs(v) > 0.5))
    return size


def tone_wheel(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of one wheel whose toothed ring is not centred: it swings by this share
    once a turn of the wheel, 1.9 m (Persson, Gustafsson, Event based sampling with application to
    vibration analysis in pneumatic tires, ICASSP 2001: errors of the teeth)."""
    t, v = s["speed"].t, s["speed"].values
    way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    swing = np.sin(2.0 * np.pi * way / 1.9 + rng.uniform(0.0, 6.0))
    set_values(s, "speed", v * (1.0 + size * swing))
    return size


def whole_kmh(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed comes in whole steps of size [m/s], to the nearest (SAE J1979, PID 0x0D: one byte,
    1 km/h a bit)."""
    own = s["speed"]
    s["speed"] = Series(own.t, size * np.round(own.values / size))
    return size


def slow_wheels(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Passive (inductive) wheel sensors give too little voltage at a crawl: below size [m/s] the
    speed says 0 (Tire Review, Passive wheel speed sensors: nothing at or below 2 mph)."""
    own = s["speed"]
    s["speed"] = Series(own.t, np.where(np.abs(own.values) <= size, 0.0, own.values))
    return size


def multipath(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is a satellite receiver's: between high buildings, 20 to 60 s at a time, reflected
    signals with another Doppler shift put an error on it of rms size [m/s] that changes within 4 s
    (Xie, Petovello, Measuring GNSS multipath distributions in urban canyon environments, IEEE
    Transactions on Instrumentation and Measurement 64, 2015)."""
    t, v = s["speed"].t, s["speed"].values
    error, keep = np.zeros(len(t)), np.exp(-np.diff(t, prepend=t[0]) / 4.0)
    for k in range(1, len(t)):
        error[k] = keep[k] * error[k - 1]
        error[k] += np.sqrt(1.0 - keep[k] ** 2) * rng.standard_normal()
    high, at = np.zeros(len(t)), float(t[0]) + rng.uniform(10.0, 60.0)
    while at < t[-1]:
        runs = rng.uniform(20.0, 60.0)
        high[(t >= at) & (t < at + runs)] = size
        at += runs + rng.uniform(30.0, 120.0)
    s["speed"] = Series(t, np.maximum(v + error * high * (v > 1.0), 0.0))
    return size


def whole_seconds(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The logger of the speed has a clock of whole seconds, size [s], and asks it where a block is
    written, every 8 to 12 s; stamps between are spread evenly (Maxim DS1307 data sheet: seconds are
    its finest register). Half a second is added to what it says, so that stamps are right on
    average."""
    t = s["speed"].t
    gaps = rng.uniform(8.0, 12.0, int((t[-1] - t[0]) / 8.0) + 3)
    asked = t[0] - 12.0 + np.concatenate([[0.0], np.cumsum(gaps)])
    phase = rng.uniform(0.0, size)
    shown = size * (np.floor((asked + phase) / size) + 0.5) - phase
    s["speed"] = Series(np.interp(t, asked, shown), s["speed"].values)
    return size


def predicted(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is a satellite receiver's that sees nothing for size [s], as below a wide bridge,
    once in one to two minutes. Its filter goes on with the acceleration of the last 2 s, which it
    takes to fade over 20 s (Singer, Estimating optimal tracking filter performance for manned
    maneuvering targets, IEEE Transactions on Aerospace and Electronic Systems 6, 1970; u-blox
    ANTARIS 4 manual, 4.6.5.2: extrapolation until the dead reckoning timeout)."""
    t, v = s["speed"].t, s["speed"].values
    out, at = v.copy(), float(t[0])
    while (at := at + rng.uniform(60.0, 120.0)) < t[-1]:
        last = float(np.interp(at, t, v))
        pull = (last - float(np.interp(at - 2.0, t, v))) / 2.0
        inside = (t >= at) & (t < at + size)
        gained = pull * 20.0 * (1.0 - np.exp(-(t[inside] - at) / 20.0))
        out[inside] = np.maximum(last + gained, 0.0)
        at += size
    set_values(s, "speed", out)
    return size


def engine_gear(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit has no speed of the wheels and makes one of the engine's turns and the gear
    (speed = turns * circumference / (gear * final drive); bgsoflex.com, RPM and MPH). While the
    driver changes gear, for size [s], the clutch is open and the engine goes from the turns of the
    old gear to those of the new, and the unit still takes the old: the speed falls by up to 41 %
    as he shifts up and rises by up to 69 % as he shifts down, and is right again when the clutch is
    closed. 0.5 to 1 s between gears that lie behind one another, 1 to 2 s beside one another
    (Wikipedia, Shift time). Five gears on wheels of 0.3 m, up at 40 turns a second, down at 20."""
    t, v = s["speed"].t, s["speed"].values
    gears = (13.5, 8.0, 5.5, 4.0, 3.2)
    grid = np.arange(t[0], t[-1] + 0.1, 0.1)
    wheel = np.convolve(np.interp(grid, t, np.abs(v)), np.ones(10) / 10.0, "same")
    wheel /= 2.0 * np.pi * 0.3
    gear, to, began, wrong = 0, 0, -np.inf, np.ones(len(grid))
    for k, at in enumerate(grid):
        if at - began >= size:
            gear = to
            up, down = gears[gear] * wheel[k] > 40.0, gears[gear] * wheel[k] < 20.0
            to = min(gear + 1, 4) if up else max(gear - 1, 0) if down else gear
            began = at if to != gear else -np.inf
        if to != gear:
            wrong[k] = 1.0 + (gears[to] / gears[gear] - 1.0) * (at - began) / size
    last = np.clip(np.searchsorted(grid, t, "right") - 1, 0, len(grid) - 1)
    set_values(s, "speed", v * wrong[last])
    return size


def other_gearbox(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The unit makes the speed of the engine's turns and the gear, and was set for a gearbox that
    looks the same (FOME-Tech/fome-fw, issue 497: three or four gearboxes fit the same engine, and
    the ratios are not always known). Of Volkswagen's 020 with the 1.6-litre Diesel, code ACH of
    1985 has 3.45, 1.94, 1.37, 1.03 and 0.75, and code AGS of 1986 has 1.29 and 0.91 in the third
    and fourth gear, both behind a final drive of 3.94 (vwgolfmk1.org.uk, Gear ratio guide). Set for
    the second in a car with the first, the unit shows 6 % too much in third and 13 % in fourth, and
    is right in the other gears. size 1 is the whole of it. Wheels of 0.3 m, up at 40 turns a
    second, down at 20, and no time for a shift."""
    t, v = s["speed"].t, s["speed"].values
    car, unit = np.array([3.45, 1.94, 1.37, 1.03, 0.75]), np.array([3.45, 1.94, 1.29, 0.91, 0.75])
    grid = np.arange(t[0], t[-1] + 0.1, 0.1)
    wheel = np.convolve(np.interp(grid, t, np.abs(v)), np.ones(10) / 10.0, "same")
    wheel /= 2.0 * np.pi * 0.3
    gear, gears = 0, np.zeros(len(grid), dtype=int)
    for k, turns in enumerate(3.94 * wheel):
        if car[gear] * turns > 40.0:
            gear = min(gear + 1, 4)
        elif car[gear] * turns < 20.0:
            gear = max(gear - 1, 0)
        gears[k] = gear
    last = np.clip(np.searchsorted(grid, t, "right") - 1, 0, len(grid) - 1)
    set_values(s, "speed", v * ((car / unit) ** size)[gears[last]])
    return size


def momentum(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is a satellite receiver's, and an app smooths it once a second by a filter that has
    a speed and an acceleration (an alpha-beta filter): steady acceleration comes through with no
    delay, but where it begins the shown speed stays behind, and where it ends it goes on too far
    (bastian2001/Kolibri-FC, pull request 48: speeds vary by around 1 m/s, and heavier filtering
    overshoots in coming to a stop; commaai/opendbc, pull request 1533: the same near a stop). The
    gains are those for a noise of size [m/s] beside an acceleration that changes by 0.5 m/s^2 from
    one second to the next (Kalata, The tracking index, IEEE Transactions on Aerospace and
    Electronic Systems 20, 1984): 0.63 and 0.31 at 1 m/s, the noise of that receiver. Below 0 it
    shows 0."""
    t = s["speed"].t
    grid = np.arange(t[0], t[-1] + 1.0, 1.0)
    index = 0.5 / size
    r = (4.0 + index - np.sqrt(8.0 * index + index**2)) / 4.0
    alpha, beta = 1.0 - r**2, 2.0 * (1.0 + r**2) - 4.0 * r
    measured = np.interp(grid, t, s["speed"].values)
    shown, last, pull = np.empty_like(grid), float(measured[0]), 0.0
    for k, now in enumerate(measured):
        expected = last + pull
        last = expected + alpha * (now - expected)
        pull += beta * (now - expected)
        shown[k] = last
    set_values(s, "speed", np.maximum(np.interp(t, grid, shown), 0.0))
    return size


def rim_accelerometer(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is made of the force outwards that an accelerometer feels on a wheel's rim, 0.19 m
    from the axle, with tyres of 0.31 m: it goes with the root of that force (US patent application
    20250237578, motion of a wheel: sensors of centrifugal acceleration do badly at low speed;
    insidegnss.com, Wheel-mounted MEMS IMU for vehicular navigation: large biases). An error of its
    zero is added to the square of the speed, or taken off it, as the square of size [m/s]: 1 g (ST
    H3LIS331DL data sheet, zero-g level offset accuracy) is 2.23 m/s, of which 0.5 m/s are left at 5
    m/s and 0.1 at 20 m/s. Where nothing is left to take the root of, the speed is 0, and so at a
    stop, where gravity does not turn on the rim. Gravity is left out: it averages out over a
    turn."""
    v = s["speed"].values
    square = v * v + rng.choice([-1.0, 1.0]) * size * size
    shown = np.sign(v) * np.sqrt(np.maximum(square, 0.0))
    set_values(s, "speed", np.where(np.abs(v) > 0.3, shown, v))
    return size


def coarse_ticks(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A counter at a wheel sends five times a second how far it went, and a program divides this by
    the time since the last message, which it takes from a clock that goes in ticks of size [s]
    (AutonomyLab/libcreate, issue 36: a velocity by the time between arrivals is too large, with
    spikes downward). 0.2 s come out as 12 ticks or as 13, and the speed 7 % too high in one message
    of five or six and 1.4 % too low in the others; it is right on average. Windows has ticks of
    15.6 ms (dotnet/android, issue 2641: 10 to 16 ms; monero-project/monero, pull request 799: 15 to
    16 ms). Stamps in the log are right."""
    t, v = s["speed"].t, s["speed"].values
    sent = np.arange(0.0, t[-1] - t[0] + 0.4, 0.2) + rng.uniform(0.0, size)
    ticks = np.maximum(np.diff(np.floor(sent / size)), 1.0)
    last = np.clip(((t - t[0]) / 0.2).astype(int), 0, len(ticks) - 1)
    set_values(s, "speed", v * 0.2 / (size * ticks[last]))
    return size
