"""Converters of recordings of small vehicles, and of IMUs beside a receiver: files to messages."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import BREMEN, FRICTION_MAPS, NAVEGO, WHEEL_INERTIAL

EARTH_RADIUS = 6_371_000.0
MOVED = 0.5
"""Metres between two fixes from which on they have a course."""


def racer(data: Path, run: int) -> list[Message]:
    """Car of scale 1:10, 2 min on a floor: its motor controller's IMU and speed 25 to 50 Hz.

    Units are those of its description, which says m/s² and rad/s where g and deg/s are sent.
    """

    def read(name: str) -> tuple[Array, Array]:
        table = np.genfromtxt(
            io.BytesIO(FRICTION_MAPS.file(data, f"DataSets/DS{run}/{name}.csv")),
            delimiter=",", skip_header=1,
        )  # fmt: skip
        return table[:, 1] + 1e-9 * table[:, 2], table[:, 3:]

    t, imu = read("imuData")
    t_speed, odometry = read("odomData")
    t_command, command = read("commandData")
    return [
        triad(0x71, "IMU_ACC", "a", "m/s^2", 0.0005, t, imu[:, 3:6], "xyz"),
        triad(0x72, "IMU_RATE", "w", "rad/s", 0.02, t, imu[:, 6:9], "xyz"),
        Message(0x73, "ODOM", t_speed, (Signal("vx", "m/s", 0.001, odometry[:, 0]),)),
        Message(0x74, "COMMAND", t_command, (
            Signal("V", "m/s", 0.001, command[:, 0]),
            Signal("delta", "rad", 0.0001, command[:, 1]),
        )),
    ]  # fmt: skip


def mars_yard(data: Path) -> list[Message]:
    """Robot with four wheels on sand and gravel, 6 min at 0.7 m/s: IMU 200 Hz, positions 2 Hz.

    The axes are said to be forward, right and down.
    """
    folder = "examples/visual-data"
    content = NAVEGO.file(data, f"{folder}/canada-planetary-data/data/imu_planetary.mat")
    imu = loadmat(io.BytesIO(content))["imu_planetary"][0, 0]
    t = imu["t"].ravel()
    content = NAVEGO.file(data, f"{folder}/external-data/canada/gnss/global-pose-utm.txt")
    poses = np.loadtxt(io.BytesIO(content), delimiter=",")
    return [
        triad(0x81, "IMU_F", "fb", "m/s^2", 0.001, t, imu["fb"], "_x _y _z"),
        triad(0x82, "IMU_W", "wb", "rad/s", 0.0001, t, imu["wb"], "_x _y _z"),
        *_track(0x83, poses[:, 0] - poses[0, 0], poses[:, 1:3]),
    ]


def skoda_receiver(data: Path) -> list[Message]:
    """Car, 2.2 min: IMU 100 Hz and positions 5 Hz of a receiver, stamped tenfold too far apart."""
    t, rows = _receiver(data, trial=2)
    return [
        triad(0x91, "MRU_ACC", "Acc", "g", 0.0005, t, rows[:, 3:6]),
        triad(0x92, "MRU_GYRO", "Gyro", "deg/s", 0.02, t, rows[:, 6:9]),
        *_track(0x93, *_places(t, rows)),
    ]


def skoda_dot(data: Path) -> list[Message]:
    """Car, 2.6 min: an IMU on its body 120 Hz, positions of a receiver 5 Hz.

    Their clocks began within 0.02 s of each other, by the turns.
    """
    t, rows = _receiver(data, trial=7)
    content = WHEEL_INERTIAL.file(data, "Datasets/trial07/CAR.csv")
    # the first row is all zeros
    body = np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=3)[:, 1:11]
    t_body = 1e-6 * (body[:, 0] - body[0, 0])
    return [
        triad(0x91, "DOT_ACC", "Acc", "m/s^2", 0.001, t_body, body[:, 4:7]),
        triad(0x92, "DOT_GYR", "Gyr", "deg/s", 0.02, t_body, body[:, 7:10]),
        *_track(0x93, *_places(t, rows)),
    ]


def bremen_bicycle(data: Path) -> list[Message]:
    """Bicycle in a city, 41 min: an Arduino's IMU read at 1.9 Hz, its receiver's positions."""
    content = BREMEN.file(data, "RecordedData/Arduino/ArduinoLog.csv")
    rows = np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=1)
    rows = rows[np.isfinite(rows).all(axis=1)]
    t = 0.001 * rows[:, 0]
    return [
        triad(0x95, "NANO_ACC", "A", "g", 0.0005, t, rows[:, 1:4], "xyz"),
        triad(0x96, "NANO_GYRO", "G", "deg/s", 0.06, t, rows[:, 4:7], "xyz"),
        *_track(0x97, *_places(t, rows[:, 7:])),
    ]


def _receiver(data: Path, trial: int) -> tuple[Array, Array]:
    """Times [s] and the receiver's columns from the latitude on."""
    content = WHEEL_INERTIAL.file(data, f"Datasets/trial{trial:02}/GNSS.csv")
    table = np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=1)
    return 0.1 * table[:, 0], table[:, 1:]


def _places(t: Array, rows: Array) -> tuple[Array, Array]:
    """Times [s] at which the position is new, and there (n, 2) east and north [m]."""
    is_new = np.append(True, np.any(np.diff(rows[:, :2], axis=0) != 0.0, axis=1))
    latitude, longitude = np.radians(rows[is_new, :2].T)
    east = EARTH_RADIUS * np.cos(latitude[0]) * (longitude - longitude[0])
    return t[is_new], np.stack([east, EARTH_RADIUS * (latitude - latitude[0])], axis=1)


def _track(id_: int, t: Array, places: Array) -> list[Message]:
    """Speed and course between positions (n, 2) of east and north [m], over two steps of them."""
    steps = places[2:] - places[:-2]
    way = np.hypot(steps[:, 0], steps[:, 1])
    course = np.degrees(np.arctan2(steps[:, 0], steps[:, 1])) % 360.0
    has_course = way > MOVED
    speed = way / (t[2:] - t[:-2])
    return [
        Message(id_, "FIX_SPEED", t[1:-1], (Signal("speed", "m/s", 0.005, speed, False),)),
        Message(id_ + 1, "FIX_COURSE", t[1:-1][has_course], (
            Signal("course", "deg", 0.01, course[has_course], False),
        )),
    ]  # fmt: skip
