"""Outside effects of what carries the sensor: its board, its bracket, a handlebar."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.real_effects import Array, Drive


def handlebar(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The sensor is clamped to what steers, as a handlebar: in a bend of radius r it stands turned
    by atan(size / r) about the upward axis, with a wheelbase of size [m], and it feels the steering
    as a rate (Cossalter, Motorcycle Dynamics, 2006, 1.4: kinematic steering angle; wheelbases of
    1.2 to 1.6 m). Below 2 m/s the angle is that at 2 m/s."""
    gyro, speed = s["gyro"], s["speed"]
    grid = np.arange(gyro.t[0], gyro.t[-1] + 0.1, 0.1)
    turn = np.interp(grid, gyro.t, gyro.values @ R[2] - np.median(gyro.values @ R[2]))
    turn = np.convolve(turn, np.ones(10) / 10.0, "same")
    v = np.interp(grid, speed.t, np.abs(speed.values))
    angle = np.arctan(size * turn * (v > 0.5) / np.maximum(v, 2.0))
    _turn_by(s, grid, np.convolve(angle, np.ones(5) / 5.0, "same"), R)
    return size


def loose_screw(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The bracket's screws are loose, and their holes give it play about the upward axis: a
    sideways force of more than 1 m/s^2, which overcomes friction, turns the sensor within 0.3 s to
    the stop of that side, size [rad] off the middle, where it stays until the force is as large to
    the other side (Junker, New criteria for self-loosening of fasteners under vibration, SAE
    690055, 1969). Two M6 screws 30 mm apart in coarse holes of 7 mm (ISO 273:1979) let a bracket
    turn by 1 mm in 30 mm, 2 deg, to each side: a yaw of the mount that no calibration can hold."""
    own = s["accel"]
    grid = np.arange(own.t[0], own.t[-1] + 0.1, 0.1)
    force = np.interp(grid, own.t, own.values @ R[1] - np.median(own.values @ R[1]))
    force = np.convolve(force, np.ones(5) / 5.0, "same")
    strong = np.abs(force) > 1.0
    last = np.maximum.accumulate(np.where(strong, np.arange(len(grid)), 0))
    angle = size * np.sign(force[last]) * strong[last]
    _turn_by(s, grid, np.convolve(angle, np.ones(3) / 3.0, "same"), R)
    return size


def board_resonance(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Firing of a four-cylinder engine shakes the gyroscope's board, which has a resonance at 70 Hz
    with a quality of 8.4. The gyroscope turns a part of the shaking's square into a rate: its zero
    moves by size [rad/s] on each axis at the resonance, so at some speeds of each gear and not at
    others (Weinberg, Gyro mechanical performance: the most important parameter, Analog Devices
    MS-2158, 2011: g^2 sensitivity; Steinberg, Vibration Analysis for Electronic Equipment, 2000:
    quality as the root of the frequency in Hz). Five gears, shifted at 40 turns a second, idle at
    13. A zero of 0.3 deg/s, as of 0.003 deg/s/g^2 and 10 g rms on the board, turns a heading by 3
    deg in ten seconds."""
    t, x = s["gyro"].t, s["gyro"].values
    wheel = np.interp(t, s["speed"].t, np.abs(s["speed"].values)) / (2.0 * np.pi * 0.3)
    turns = 3.2 * wheel
    for overall in (4.0, 5.5, 8.0, 13.5):
        turns = np.where(overall * wheel < 40.0, overall * wheel, turns)
    ratio = 2.0 * np.maximum(turns, 13.0) / 70.0
    shaking = 1.0 / (8.4**2 * (1.0 - ratio**2) ** 2 + ratio**2)
    set_values(s, "gyro", x + size * shaking[:, None] * rng.choice([-1.0, 1.0], 3))
    return size


def held_at_one_end(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The sensor is in a phone whose holder grips it at one end, so that its middle is 40 mm beside
    the joint: braking and pulling away turn it about the upward axis, by size [rad] for each m/s^2,
    as far as the arm gives, and it feels the turning as a rate. Mounts of phones have their
    resonance at 6 to 18 Hz, by the arm's length and stiffness (Yu, Mitigating mounting effects on
    smartphone-based road roughness, 2024: laboratory tests of four mounts). 0.2 kg of 160 by 75 mm
    at 6 Hz are 1.2 N m/rad, so that each m/s^2 turns the phone by 0.0067 rad, 0.4 deg: 1.2 deg in
    braking with 3 m/s^2, and 1 deg/s as it begins."""
    own = s["accel"]
    grid = np.arange(own.t[0], own.t[-1] + 0.1, 0.1)
    force = np.interp(grid, own.t, own.values @ R[0] - np.median(own.values @ R[0]))
    angle = rng.choice([-1.0, 1.0]) * size * np.convolve(force, np.ones(5) / 5.0, "same")
    _turn_by(s, grid, angle, R)
    return size


def _turn_by(s: Drive, grid: Array, angle: Array, R: Array) -> None:
    """The sensor turned by an angle [rad] about the vehicle's upward axis, at times 0.1 s apart."""
    rate = np.interp(s["gyro"].t, grid, np.gradient(angle, 0.1))
    for name in ("accel", "gyro"):
        x, by = s[name].values, np.interp(s[name].t, grid, angle)[:, None]
        up = (x @ R[2])[:, None] * R[2]
        # A sensor that turns to the left sees the vehicle turned to the right.
        x = up + np.cos(by) * (x - up) - np.sin(by) * np.cross(R[2], x)
        set_values(s, name, x + rate[:, None] * R[2] if name == "gyro" else x)
