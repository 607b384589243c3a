"""Converters of recordings with a phone in a vehicle: source files to messages."""

from __future__ import annotations

import csv
import gzip
import io
import re
from datetime import datetime
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal
from benchmarks.public_logs.repositories import BRODOVSKY, CLOUDPOSE, SANTOLLAN, VEHSENSE

SHUTTLE_START = 1542645195.0
SHUTTLE_PARTS = ((5100.0, 7800.0), (9600.0, 12300.0))
"""Of the shuttle's 4.8 h two parts of 45 min [s after its start]: those with the most GPS fixes."""


def austin_bmw(data: Path) -> list[Message]:
    """BMW M235i, 6 min: the car's speed, steering and accelerations; an iPhone on the dashboard.

    iOS gives the acceleration due to gravity with the opposite sign of the specific force.
    """
    car = _rows(CLOUDPOSE.file(data, "dataset1_car.csv"))
    phone = _rows(CLOUDPOSE.file(data, "dataset1_phone.csv"))
    t_car = np.array([_clock(row["Time"]) for row in car])
    logged = np.array([_clock(row["loggingTime(txt)"]) for row in phone])
    messages = [
        Message(0x201, "CAR_SPEED", t_car, (
            Signal("SPEED", "mph", 0.005, _column(car, "Speed (MPH)"), False),
        )),
        Message(0x202, "CAR_STEER", t_car, (
            Signal("STEER", "deg", 0.1, _column(car, "Steering Angle")),
        )),
        Message(0x203, "CAR_ACC", t_car, (
            Signal("LAT_G", "g", 0.01, _column(car, "Lateral Gs")),
            Signal("LON_G", "g", 0.01, _column(car, "Acceleration Gs")),
        )),
    ]  # fmt: skip
    for id_, name, stamp, stem, unit, step in (
        (0x210, "PHONE_ACC", "accelerometerTimestamp_sinceReboot(s)",
         "accelerometerAcceleration{}(G)", "g", 0.0002),
        (0x211, "PHONE_GYR", "gyroTimestamp_sinceReboot(s)", "gyroRotation{}(rad/s)", "rad/s",
         0.0005),
    ):  # fmt: skip
        own = _column(phone, stamp)
        is_new = np.concatenate([[True], np.diff(own) > 0.0])
        t = own + np.min(logged - own)  # the app's clock is the sensor's and some waiting
        messages.append(
            Message(id_, name, t[is_new], tuple(
                Signal(f"{name[-3:]}_{axis}", unit, step,
                       _column(phone, stem.format(axis))[is_new]) for axis in "XYZ"
            ))
        )  # fmt: skip
    fixes = _column(phone, "locationTimestamp_since1970(s)")
    is_new = np.concatenate([[True], np.diff(fixes) > 0.0])
    messages.append(
        Message(0x212, "PHONE_GPS", logged[is_new], (
            Signal("GPS_V", "m/s", 0.01, _column(phone, "locationSpeed(m/s)")[is_new], False),
            Signal("GPS_COURSE", "deg", 0.01, _column(phone, "locationCourse(°)")[is_new], False),
        ))
    )  # fmt: skip
    return messages


def paratransit_shuttle(data: Path, part: int) -> list[Message]:
    """Small bus, 45 min of its morning: a phone's accelerometer and gyroscope, GPS 1 Hz."""
    folder = "data/358239052952076/VehSenseData2018_11_19_11_33_14"
    first, last = SHUTTLE_PARTS[part]
    messages = []
    for id_, name, kind, unit, step in (
        (0x200, "IMU_ACCEL", "acc", "m/s^2", 0.002), (0x201, "IMU_GYRO", "gyro", "rad/s", 0.0005)
    ):  # fmt: skip
        rows = _chunks(data, folder, f"raw_{kind}")
        own, clock = _column(rows, "abs_timestamp") * 1e-9, _column(rows, "sys_time") * 1e-3
        inside = (clock >= SHUTTLE_START + first) & (clock < SHUTTLE_START + last)
        t = own[inside] + np.min((clock - own)[inside])
        messages.append(
            Message(id_, name, t, tuple(
                Signal(f"{name[4:]}_{axis}", unit, step,
                       _column(rows, f"raw_{axis.lower()}_{kind}")[inside]) for axis in "XYZ"
            ))
        )  # fmt: skip
    fixes = [row for row in _chunks(data, folder, "gps") if row["provider"] == "gps"]
    t_gps = _column(fixes, "system_time") * 1e-3
    inside = (t_gps >= SHUTTLE_START + first) & (t_gps < SHUTTLE_START + last)
    messages.append(
        Message(0x202, "GNSS", t_gps[inside], (
            Signal("SPEED", "m/s", 0.01, _column(fixes, "speed")[inside], False),
            Signal("BEARING", "deg", 0.01, _column(fixes, "bearing")[inside], False),
        ))
    )  # fmt: skip
    return messages


def phone_s24(data: Path) -> list[Message]:
    """Phone, 3.4 min of a drive, picked up and put down by hand: IMU 60 Hz, GPS 1 Hz."""
    messages = []
    for id_, name, path, unit, step in (
        (0x31, "Acc", "TotalAcceleration.csv", "m/s^2", 0.002),
        (0x32, "Gyr", "Gyroscope.csv", "rad/s", 0.0005),
    ):
        rows = _rows(SANTOLLAN.file(data, path))
        messages.append(
            Message(id_, name, _column(rows, "time") * 1e-9, tuple(
                Signal(f"{name}_{axis}", unit, step, _column(rows, axis)) for axis in "xyz"
            ))
        )  # fmt: skip
    rows = _rows(SANTOLLAN.file(data, "Location.csv"))
    messages.append(
        Message(0x40, "Loc", _column(rows, "time") * 1e-9, (
            Signal("Loc_speed", "m/s", 0.01, _column(rows, "speed"), False),
            Signal("Loc_bearing", "deg", 0.01, _column(rows, "bearing"), False),
        ))
    )  # fmt: skip
    return messages


def pixel_1hz(data: Path) -> list[Message]:
    """Phone in a car, 57 min: one sample a second of everything."""
    folder = "data/processed/imu_datasets/20230809_124742"
    imu = [row for row in _rows(BRODOVSKY.file(data, f"{folder}/imu.csv")) if row["a_x"]]
    gps = [row for row in _rows(BRODOVSKY.file(data, f"{folder}/gps.csv")) if row["speed"]]
    t = np.array([datetime.fromisoformat(row["time"]).timestamp() for row in imu])
    t_gps = np.array([datetime.fromisoformat(row["time"]).timestamp() for row in gps])
    return [
        Message(0x71, "Accelerometer", t, tuple(
            Signal(name, "m/s^2", 0.002, _column(imu, name)) for name in ("a_x", "a_y", "a_z")
        )),
        Message(0x72, "Gyroscope", t, tuple(
            Signal(name, "rad/s", 0.0002, _column(imu, name)) for name in ("w_x", "w_y", "w_z")
        )),
        Message(0x73, "Location", t_gps, (
            Signal("speed", "m/s", 0.01, _column(gps, "speed"), False),
            Signal("bearing", "deg", 0.01, _column(gps, "bearing"), False),
        )),
    ]  # fmt: skip


def _chunks(data: Path, folder: str, stem: str) -> list[dict[str, str]]:
    """Rows of all of a trip's numbered, gzipped files of one kind, in their order."""
    numbered = re.compile(rf"{re.escape(folder)}/{stem}(\d+)\.txt\.zip$")
    found = [(int(m[1]), m[0]) for m in map(numbered.match, VEHSENSE.files(data, folder)) if m]
    # only the first has the line of names
    whole = b"".join(gzip.decompress(VEHSENSE.file(data, path)) for _, path in sorted(found))
    return [row for row in _rows(whole) if None not in row.values()]


def _rows(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def _column(rows: list[dict[str, str]], name: str) -> Array:
    return np.array([float(row[name]) for row in rows])


def _clock(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()
