"""Converters of recordings with a phone in a vehicle: source files to messages."""

from __future__ import annotations

import csv
import gzip
import io
import re
from datetime import datetime
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import (
    BALZER,
    BRODOVSKY,
    CLOUDPOSE,
    ESCOOTER,
    INGENIEUR,
    POTHOLES,
    PUNE,
    ROAD_SURFACE,
    SANTOLLAN,
    VEHSENSE,
    Repository,
)
from imucald.api.interchange import library

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
        values = _columns(phone, *(stem.format(axis) for axis in "XYZ"))[is_new]
        messages.append(triad(id_, name, name[-3:], unit, step, t[is_new], values))
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
        values = _columns(rows, *(f"raw_{axis}_{kind}" for axis in "xyz"))[inside]
        messages.append(triad(id_, name, name[4:], unit, step, t, values))
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
    return _sensor_logger(data, SANTOLLAN, (0x31, 0x32, 0x40), ("Loc_speed", "Loc_bearing"))


def pixel_1hz(data: Path) -> list[Message]:
    """Phone in a car, 57 min: one sample a second of everything."""
    folder = "data/processed/imu_datasets/20230809_124742"
    imu = [row for row in _rows(BRODOVSKY.file(data, f"{folder}/imu.csv")) if row["a_x"]]
    gps = [row for row in _rows(BRODOVSKY.file(data, f"{folder}/gps.csv")) if row["speed"]]
    t = np.array([datetime.fromisoformat(row["time"]).timestamp() for row in imu])
    t_gps = np.array([datetime.fromisoformat(row["time"]).timestamp() for row in gps])
    return [
        triad(0x71, "Accelerometer", "a", "m/s^2", 0.002, t, _columns(imu, "a_x", "a_y", "a_z"),
              "_x _y _z"),
        triad(0x72, "Gyroscope", "w", "rad/s", 0.0002, t, _columns(imu, "w_x", "w_y", "w_z"),
              "_x _y _z"),
        Message(0x73, "Location", t_gps, (
            Signal("speed", "m/s", 0.01, _column(gps, "speed"), False),
            Signal("bearing", "deg", 0.01, _column(gps, "bearing"), False),
        )),
    ]  # fmt: skip


def provo_scooter(data: Path) -> list[Message]:
    """Electric scooter, 15 min of pavements: a phone upright on its steering column, GNSS 1 Hz.

    Fixes without a course (below walking pace) have none here.
    """
    stem = "data/pavement_data/20211016_120306/20211016_120306_"
    accelerometer, gyroscope, fixes = (
        _numbers(ESCOOTER.file(data, f"{stem}{kind}.csv"), ";") for kind in ("Acc", "Gyro", "GNSS")
    )
    has_course = fixes[:, 6] >= 0.0
    return [
        triad(0x120, "BMI160_A", "Acc", "m/s^2", 0.003, accelerometer[:, 0] * 1e-9,
              accelerometer[:, 1:4], "XYZ"),
        triad(0x121, "BMI160_G", "Gyro", "rad/s", 0.001, gyroscope[:, 0] * 1e-9,
              gyroscope[:, 1:4], "XYZ"),
        Message(0x130, "GNSS_SPEED", fixes[:, 0] * 1e-9, (
            Signal("Speed", "m/s", 0.0005, fixes[:, 5], False),
        )),
        Message(0x131, "GNSS_HEADING", fixes[has_course, 0] * 1e-9, (
            Signal("Heading", "deg", 0.01, fixes[has_course, 6], False),
        )),
    ]  # fmt: skip


def doha_iphone(data: Path) -> list[Message]:
    """Car, 2 min, never at rest: iPhone, gravity and user acceleration, a fix a second."""
    lines = ROAD_SURFACE.file(data, "data/20180412_120303.csv").decode().splitlines()[1:]
    rows = [line.split(",") for line in lines]
    motion = np.array([[float(x) for x in row[:13]] for row in rows if row[0]])
    fixes = np.array([[float(x) for x in row[16:22]] for row in rows if not row[0]])
    is_new = np.concatenate([[True], np.diff(fixes[:, 5]) > 0.0])
    return [
        triad(0x1, "MOTION_ACC", "acc_", "g", 0.0002, motion[:, 0],
              motion[:, 7:10] + motion[:, 10:13], "xyz"),
        triad(0x2, "MOTION_RATE", "rot_", "rad/s", 0.0005, motion[:, 0], motion[:, 4:7], "xyz"),
        Message(0x3, "LOCATION", fixes[is_new, 5], (
            Signal("speed", "m/s", 0.01, fixes[is_new, 3], False),
            Signal("course", "deg", 0.01, fixes[is_new, 4], False),
        )),
    ]  # fmt: skip


WATCH_AHEAD = 2.0
"""Seconds by which the watch's clock is set back: its speed else follows the phone's by 3 s."""


def helbert_c1(data: Path) -> list[Message]:
    """Citroen C1, 6 min: a phone's accelerometer in g, no gyroscope; speed of a watch, 1 Hz."""
    fitparse = library("fitparse", "public-logs")
    folder = "data/helbert/2023_03_02/path_5"
    text = INGENIEUR.file(data, f"{folder}/2023-03-0119.38.45.csv").decode()
    rows = [line.split(";") for line in text.replace(",", ".").splitlines()[1:]]
    rows = [row for row in rows if len(row) == 5]
    clock = np.array([[float(x) for x in row[0].split(":")] for row in rows])
    t = clock @ (3600.0, 60.0, 1.0, 1e-4)
    fit = fitparse.FitFile(io.BytesIO(INGENIEUR.file(data, f"{folder}/D31J3853.FIT")))
    records = [message.get_values() for message in fit.get_messages("record")]
    speeds = [(record["timestamp"], record["enhanced_speed"]) for record in records
              if record.get("enhanced_speed") is not None]  # fmt: skip
    # the watch writes UTC, the phone the time of Paris in winter
    t_watch = np.array([(at - at.replace(hour=0, minute=0, second=0)).total_seconds()
                        for at, _ in speeds]) + 3600.0 - WATCH_AHEAD  # fmt: skip
    values = np.array([[float(x) for x in row[1:4]] for row in rows])
    return [
        triad(0x11, "TOOLBOX", "gF", "g", 0.0001, t, values, "xyz"),
        Message(0x12, "WATCH", t_watch, (
            Signal("enhanced_speed", "m/s", 0.001, np.array([v for _, v in speeds]), False),
        )),
    ]  # fmt: skip


def pittsburgh(data: Path, trips: tuple[int, ...]) -> list[Message]:
    """Car in a city, trips of 5 to 7 min: an iPhone at 5 Hz in g, GPS speed 1 Hz held in between.

    iOS writes a speed of -1 where it has none; such rows are no fixes.
    """
    rows = np.concatenate([
        _numbers(POTHOLES.file(data, f"Pothole/trip{trip}_sensors.csv"), ",") for trip in trips
    ])  # fmt: skip
    t, places = rows[:, 0], rows[:, 1:4]
    is_new = np.concatenate([[True], np.any(np.diff(places, axis=0) != 0.0, axis=1)])
    is_new &= rows[:, 3] >= 0.0
    return [
        triad(0x41, "ACCEL", "accelerometer", "g", 0.0002, t, rows[:, 4:7], "XYZ"),
        triad(0x42, "GYRO", "gyro", "rad/s", 0.0002, t, rows[:, 7:10], "XYZ"),
        Message(0x43, "GPS", t[is_new], (Signal("speed", "m/s", 0.01, rows[is_new, 3], False),)),
    ]


def pune_phone(data: Path) -> list[Message]:
    """Phone, 4.5 min of a city, turned about on the way: accelerometer and gyroscope 100 Hz."""
    return _sensor_logger(data, PUNE, (0x51, 0x52, 0x53), ("speed", "bearing"))


def dresden_motorbike(data: Path) -> list[Message]:
    """Motorbike, 1.8 min: an iPhone at 50 Hz, in g and with the sign of iOS; GPS 1 Hz."""
    rows = _rows(BALZER.file(data, "2016-08-09-Motorbike.csv"))
    messages = []
    for id_, name, stem, unit, step in (
        (0x61, "accelerometer", "accelerometerAcceleration", "g", 0.0005),
        (0x62, "gyro", "gyroRotation", "rad/s", 0.0005),
    ):
        full = [row for row in rows if row[f"{stem}X"]]
        t = _column(full, f"{name}Timestamp_sinceReboot")
        logged = np.array([_clock(row["loggingTime"]) for row in full])
        is_new = np.concatenate([[True], np.diff(t) > 0.0])
        values = _columns(full, *(f"{stem}{axis}" for axis in "XYZ"))
        messages.append(triad(id_, name, stem, unit, step, (t + np.min(logged - t))[is_new],
                              values[is_new]))  # fmt: skip
    fixes = [row for row in rows if row["locationSpeed"] and float(row["locationSpeed"]) >= 0.0]
    own = _column(fixes, "locationTimestamp_since1970")
    is_new = np.concatenate([[True], np.diff(own) > 0.0])
    t = np.array([_clock(row["loggingTime"]) for row in fixes])[is_new]
    speed, course = (_column(fixes, f"location{name}")[is_new] for name in ("Speed", "Course"))
    has_course = course >= 0.0
    return [
        *messages,
        Message(0x63, "speed", t, (Signal("locationSpeed", "m/s", 0.01, speed, False),)),
        Message(0x64, "course", t[has_course], (
            Signal("locationCourse", "deg", 0.01, course[has_course], False),
        )),
    ]  # fmt: skip


def _sensor_logger(
    data: Path, repository: Repository, ids: tuple[int, int, int], names: tuple[str, str]
) -> list[Message]:
    """What the app Sensor Logger wrote. ids: of accelerometer, gyroscope, GPS; names: of the
    signals of speed and bearing."""
    messages = []
    for id_, name, path, unit, step in (
        (ids[0], "Acc", "TotalAcceleration.csv", "m/s^2", 0.002),
        (ids[1], "Gyr", "Gyroscope.csv", "rad/s", 0.0005),
    ):
        rows = _rows(repository.file(data, path))
        t, values = _column(rows, "time") * 1e-9, _columns(rows, *"xyz")
        messages.append(triad(id_, name, name, unit, step, t, values, "_x _y _z"))
    rows = _rows(repository.file(data, "Location.csv"))
    messages.append(
        Message(ids[2], "Loc", _column(rows, "time") * 1e-9, (
            Signal(names[0], "m/s", 0.01, _column(rows, "speed"), False),
            Signal(names[1], "deg", 0.01, _column(rows, "bearing"), False),
        ))
    )  # fmt: skip
    return messages


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


def _columns(rows: list[dict[str, str]], *names: str) -> Array:
    return np.stack([_column(rows, name) for name in names], axis=1)


def _numbers(content: bytes, separator: str) -> Array:
    """The rows that begin with a digit."""
    lines = [line.rstrip(separator) for line in content.decode().splitlines()]
    return np.array([[float(x) for x in line.split(separator)] for line in lines
                     if line[:1].isdigit()])  # fmt: skip


def _clock(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()
