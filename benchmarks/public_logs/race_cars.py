"""Converters of recordings on race tracks: files of data loggers to messages."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import RACECAPTURE, RACECHRONO, REVS

TAUPO = "Test/session_20260103_141321_race_1_lap4.rcz"
BOX = ("2_301_0", "3_302_0")
PHONE = ("2_100_0", "3_101_0")
"""Accelerometer and gyroscope of the logger's box, and of the telephone, in RaceChrono's names."""


def taupo_lap(data: Path, sensors: tuple[str, str]) -> list[Message]:
    """BMW on a race track, one lap of 113 s: one of two loose sensors, GPS 25 Hz, the car's CAN."""
    with zipfile.ZipFile(io.BytesIO(RACECHRONO.file(data, TAUPO))) as session:

        def column(device: str, channel: int, per_unit: float) -> Array:
            raw = session.read(f"channel_{device}_{channel}_0")
            return np.frombuffer(raw, dtype="<i4") / per_unit

        def times(device: str) -> Array:
            return np.frombuffer(session.read(f"channel_{device}_1_1"), dtype="<i8") / 1e3

        def of_car(channel: int) -> tuple[Array, Array]:
            values = np.frombuffer(
                session.read(f"channel2_12_200_{channel}_{channel}_3"), dtype="<f8"
            )
            return times(f"12_200_{channel}"), values

        accelerometer, gyroscope = sensors
        force = np.stack([column(accelerometer, axis, 1e4) for axis in (9, 10, 11)], axis=1)
        rates = np.stack([column(gyroscope, axis, 1e3) for axis in (12, 13, 14)], axis=1)
        gps = "1_300_0"
        return [
            triad(0x401, "BOX_ACC", "acc", "g", 0.0005, times(accelerometer), force),
            triad(0x402, "BOX_GYR", "rate", "deg/s", 0.01, times(gyroscope), rates),
            Message(0x410, "BOX_GPS", times(gps), (
                Signal("speed", "m/s", 0.002, column(gps, 4, 1e3), False),
                Signal("bearing", "deg", 0.01, column(gps, 6, 1e3), False),
            )),
            _of_car(0x420, "CAR_SPEED", Signal("speed", "m/s", 0.01, of_car(4)[1]), of_car(4)[0]),
            _of_car(0x421, "CAR_STEER", Signal("angle", "deg", 0.1, of_car(1001)[1]),
                    of_car(1001)[0]),
            _of_car(0x422, "CAR_BRAKE", Signal("position", "%", 0.1, of_car(1002)[1]),
                    of_car(1002)[0]),
        ]  # fmt: skip


def _of_car(id_: int, name: str, signal: Signal, t: Array) -> Message:
    return Message(id_, name, t, (signal,))


def targa_250lm(data: Path) -> list[Message]:
    """Ferrari 250 LM, 9 min of a race: level accelerations, yaw rate and speed of an INS."""
    folder = "datasets/20140222_01_01_03_250lm"

    def column(name: str) -> Array:
        return np.loadtxt(io.BytesIO(REVS.file(data, f"{folder}/{name}.txt")))

    t = column("t")
    return [
        Message(0x31, "INS", t, (
            Signal("axCG", "m/s^2", 0.001, column("axCG")),
            Signal("ayCG", "m/s^2", 0.001, column("ayCG")),
            Signal("yawRate", "rad/s", 0.0001, column("yawRate")),
            Signal("vx", "m/s", 0.005, column("vx")),
        )),
        Message(0x32, "STEER", t, (
            Signal("roadWheelAngle", "deg", 0.005, np.degrees(column("delta"))),
        )),
    ]  # fmt: skip


COURSE_FIXES = 5
"""Fixes over which a course is taken: half a second, where positions have steps of 0.1 m."""
COURSE_WAY = 1.5
"""Metres in between from which on there is a course."""


def sonoma_car(data: Path) -> list[Message]:
    """Race car, 18.6 min of a race track: logger's accelerometer, gyroscope 25 Hz, GPS 10 Hz.

    The gyroscope, called deg/s, was never calibrated: its numbers are 3.8 times the rates, and at
    rest it shows -57 to -60.
    """
    column = _racecapture(RACECAPTURE.file(data, "test/sonoma.log").decode())
    t = column["Interval"] / 1000.0
    has = np.isfinite(column["AccelX"])
    has_steering = np.isfinite(column["Steering"])
    return [
        _columns(0x501, "RCP_ACCEL", t[has], "G", 0.01,
                 {name: column[name][has] for name in ("AccelX", "AccelY", "AccelZ")}),
        _columns(0x502, "RCP_GYRO", t[has], "deg/s", 0.1,
                 {name: column[name][has] for name in ("Yaw", "Pitch", "Roll")}),
        _columns(0x503, "RCP_STEER", t[has_steering], "", 1.0,
                 {"Steering": column["Steering"][has_steering]}),
        *_gps(column, t),
    ]  # fmt: skip


def seattle_car(data: Path) -> list[Message]:
    """Car in streets, 18.6 min round a block: accelerometer and yaw rate 30 Hz, GPS 10 Hz.

    Only rows with a fix have a time; those in between are spread evenly. The logger's box lies
    loose: gravity wanders by 13 deg, forward by some 20.
    """
    text = RACECAPTURE.file(data, "test/predictive_time_test_lap.log").decode()
    column = _racecapture(text)
    clock = column["Time"]
    fixes = np.flatnonzero(np.isfinite(clock))
    seconds = clock // 10000 * 3600 + clock // 100 % 100 * 60 + clock % 100
    rows = np.arange(len(clock))
    t = np.interp(rows, fixes, seconds[fixes])
    names = ("AccelX", "AccelY", "AccelZ", "Yaw")
    has = np.isfinite(np.stack([column[name] for name in names])).all(axis=0)
    has &= (rows >= fixes[0]) & (rows <= fixes[-1])
    return [
        _columns(0x511, "RCP_ACCEL", t[has], "G", 0.001,
                 {name: column[name][has] for name in names[:3]}),
        _columns(0x512, "RCP_YAW", t[has], "deg/s", 0.01, {"Yaw": column["Yaw"][has]}),
        *_gps(column, t),
    ]  # fmt: skip


def _racecapture(text: str) -> dict[str, Array]:
    """Columns of RaceCapture's log: its first line names them, an empty field is NaN."""
    head, *lines = text.splitlines()
    names = [field.split("|")[0].strip('"#') for field in head.split(",")]
    rows = [line.split(",") for line in lines if line and not line.startswith(("#", '"'))]
    values = np.array([[float(x) if x else np.nan for x in row] for row in rows
                       if len(row) == len(names)])  # fmt: skip
    return dict(zip(names, values.T, strict=True))


def _columns(
    id_: int, name: str, t: Array, unit: str, step: float, columns: dict[str, Array]
) -> Message:
    return Message(id_, name, t, tuple(
        Signal(key, unit, step, values) for key, values in columns.items()
    ))  # fmt: skip


def _gps(column: dict[str, Array], t: Array) -> list[Message]:
    """The receiver's speed, and the course of its positions over half a second before."""
    is_fix = np.isfinite(column["Speed"]) & np.isfinite(column["Latitude"])
    is_fix[is_fix] = np.concatenate([[True], np.diff(t[is_fix]) > 0.0])
    t, speed, latitude, longitude = (
        x[is_fix] for x in (t, column["Speed"], column["Latitude"], column["Longitude"])
    )
    north = (latitude[COURSE_FIXES:] - latitude[:-COURSE_FIXES]) * 111_194.0
    east = (longitude[COURSE_FIXES:] - longitude[:-COURSE_FIXES]) * 111_194.0
    east *= np.cos(np.radians(np.median(latitude)))
    has_course = np.hypot(north, east) > COURSE_WAY
    course = np.degrees(np.arctan2(east, north)) % 360.0
    return [
        Message(0x510, "RCP_GPS", t, (Signal("Speed", "mph", 0.01, speed, False),)),
        Message(0x520, "RCP_COURSE", t[COURSE_FIXES:][has_course], (
            Signal("Course", "deg", 0.01, course[has_course], False),
        )),
    ]  # fmt: skip
