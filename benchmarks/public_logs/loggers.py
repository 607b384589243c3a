"""Converters of recordings by apps and small loggers, of a sixth search: source files to messages.

Positions stay behind; speed and course come from them only where the recorder wrote no others.
"""

from __future__ import annotations

import csv
import io
import re
import sqlite3
import struct
import tempfile
import zipfile
from datetime import datetime
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import (
    BOSTON_1HZ,
    BOSTON_CIRCLES,
    BOSTON_DRIVE,
    FREEMATICS,
    KLANG,
    ROME,
    TRACKADDICT,
)

ROME_TRACKS = {
    904: ("904_track_1_0_gps.csv", 15.75), 906: ("906_track_2_0_gps.csv", 21.75),
    908: ("908_track_2_0_gps.csv", 12.25), 909: ("909_track_1_0_gps.csv", 14.5),
}  # fmt: skip
"""The app's track, and its start before that of the accelerometer's app [s], by the turns."""
MOVED = 1.5
"""Metres between two fixes a second apart from which on they have a course."""


def rome(data: Path, drive: int) -> list[Message]:
    """Car in and near Rome, 12 to 24 min: an iPhone's accelerometer 15 Hz, no gyroscope.

    Speed and course are those of another app on the phone, 1 Hz; its speed jumps by up to 100 km/h.
    """
    name, start = ROME_TRACKS[drive]
    rows = [line.split(",") for line in ROME.file(
        data, f"Iphone Files/{drive}_sj.csv").decode().splitlines()[1:]]  # fmt: skip
    values = np.array([[float(x) for x in row[:4]] for row in rows if all(row[:4])])
    fixes = [line.split("\t") for line in ROME.file(
        data, f"Iphone Files/{name}").decode("utf-8-sig").splitlines()]  # fmt: skip
    fixes = [row for row in fixes if len(row) >= 9 and row[1][:2] == "20"]
    t = np.array([datetime.fromisoformat(row[1]).timestamp() for row in fixes])
    return [
        triad(0x21, "ScienceJournal", "Acc", "m/s^2", 0.002, values[:, 0] / 1000.0 + start,
              values[:, 1:4], "XYZ"),
        Message(0x22, "GPS_Speed", t - t[0], (
            Signal("Velocita", "km/h", 0.1, _italian(fixes, 7), False),
        )),
        Message(0x23, "GPS_Course", t - t[0], (
            Signal("Corso", "deg", 0.1, _italian(fixes, 6), False),
        )),
    ]  # fmt: skip


def lausitz_track(data: Path) -> list[Message]:
    """Car on a race track, 21 min: TrackAddict on a phone, accelerations without gravity 20 Hz."""
    text = TRACKADDICT.file(data, "example/STC_log.csv").decode()
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    fixes = [row for row in rows if row["GPS_Update"] == "1"]
    t = _column(fixes, "Time")
    return [
        triad(0x31, "ACCEL", "Accel", "g", 0.01, _column(rows, "Time"),
              np.stack([_column(rows, f"Accel {axis}") for axis in "XYZ"], axis=1)),
        Message(0x32, "GPS", t, (
            Signal("Speed", "km/h", 0.1, _column(fixes, "Speed (Km/h)"), False),
            Signal("Heading", "deg", 0.1, _column(fixes, "Heading"), False),
        )),
    ]  # fmt: skip


def klang_car(data: Path) -> list[Message]:
    """Car, 44 min: Torque on a phone, one row a second of OBD-II, GPS and accelerometer."""
    text = KLANG.file(data, "trackLog.csv").decode("utf-8-sig")
    rows = [{key.strip(): x for key, x in row.items() if key} for row in
            csv.DictReader(io.StringIO(text))]  # fmt: skip
    is_row = re.compile(r"\d\d-\w{3}-\d{4} ")

    def message(id_: int, name: str, signals: tuple[tuple[str, str, str, float, bool], ...],
                ) -> Message:  # fmt: skip
        full = [row for row in rows if is_row.match(row["Device Time"])
                and all(row[column] not in ("-", "") for column, *_ in signals)]  # fmt: skip
        t = np.array([datetime.strptime(row["Device Time"], "%d-%b-%Y %H:%M:%S.%f").timestamp()
                      for row in full])  # fmt: skip
        return Message(id_, name, t, tuple(
            Signal(signal, unit, step, _column(full, column), signed)
            for column, signal, unit, step, signed in signals
        ))  # fmt: skip

    return [
        message(0x41, "PHONE", tuple(
            (f"G({axis})", f"G_{axis}", "m/s^2", 0.001, True) for axis in "xyz")),
        message(0x42, "OBD", (("Speed (OBD)(km/h)", "OBD_Speed", "km/h", 1.0, False),)),
        message(0x43, "GPS", (
            ("GPS Speed (Meters/second)", "GPS_Speed", "m/s", 0.01, False),
            ("Bearing", "Bearing", "deg", 0.01, False),
        )),
    ]  # fmt: skip


def sydney_audi(data: Path) -> list[Message]:
    """Hybrid car, 78 min: Freematics ONE+ in its OBD-II socket, everything at 1.6 Hz.

    The logger takes what it measures at its start from the accelerations, gravity with it.
    """
    text = FREEMATICS.file(data, "DAT00009.CSV").decode()
    found: dict[str, list[tuple[float, list[float]]]] = {"20": [], "10D": [], "D": []}
    for line in text.splitlines():
        match = re.fullmatch(r"(\d+):(20|10D|D)=([-\d;]+) ?", line)
        if match:
            values = [float(x) for x in match[3].split(";")]
            found[match[2]].append((float(match[1]) / 1000.0, values))
    t, values = (
        {key: np.array([row[i] for row in rows]) for key, rows in found.items()} for i in (0, 1)
    )
    return [
        triad(0x51, "ACC", "ACC", "g", 0.01, t["20"], values["20"] / 100.0),
        Message(0x52, "OBD_0D", t["10D"], (
            Signal("VehicleSpeed", "km/h", 1.0, values["10D"][:, 0], False),
        )),
        Message(0x53, "GPS", t["D"], (
            Signal("GpsSpeed", "km/h", 1.0, values["D"][:, 0], False),
        )),
    ]  # fmt: skip


def boston_1hz(data: Path) -> list[Message]:
    """University car in a city, 21 min: an IMU read once a second, GPS positions 1 Hz."""
    content = BOSTON_1HZ.file(data, "LAB4/src/data/data_driving/data_driving_0.db3")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(content)
        bag = sqlite3.connect(path)
        of_topic = "select timestamp, data from messages where topic_id = ? order by timestamp"
        imu, fixes = (bag.execute(of_topic, (topic,)).fetchall() for topic in (1, 2))
        bag.close()
    # $VNYMR: yaw, pitch, roll, magnetic field, acceleration, angular rate
    sentence = re.compile(rb"\$VNYMR,([-+.,\d]+)\*")
    matches = [(stamp, match) for stamp, raw in imu if (match := sentence.search(raw))]
    columns = np.array([[float(x) for x in match[1].split(b",")] for _, match in matches])
    # after the header: latitude, longitude, altitude, hdop, easting, northing
    places = np.array([struct.unpack_from("<6d", raw, 28)[4:6] for _, raw in fixes])
    t_fix = np.array([stamp for stamp, _ in fixes]) * 1e-9
    return _vectornav(
        np.array([stamp for stamp, _ in matches]) * 1e-9, columns[:, 6:9], columns[:, 9:12],
        t_fix, places,
    )  # fmt: skip


def boston_circles(data: Path) -> list[Message]:
    """University car, 95 s in circles: an IMU 40 Hz, GPS positions 1 Hz."""
    stem = "lab5/src/data/going_in_circles_"
    return _boston(*(BOSTON_CIRCLES.file(data, f"{stem}{kind}.csv") for kind in ("imu", "gps")))


def boston_drive(data: Path) -> list[Message]:
    """University car in a city, 12.6 min: an IMU 40 Hz, GPS positions 1 Hz."""
    content = BOSTON_DRIVE.file(data, "lab5/src/data/data_driving.zip")
    with zipfile.ZipFile(io.BytesIO(content)) as both:
        return _boston(*(both.read(f"data_driving/{kind}.csv") for kind in ("imu", "gps")))


def _boston(*tables: bytes) -> list[Message]:
    """Topics of the IMU and of the receiver as tables."""
    imu, fixes = (list(csv.DictReader(io.StringIO(table.decode()))) for table in tables)
    force, rates = (
        np.stack([_column(imu, f"imu.{kind}.{axis}") for axis in "xyz"], axis=1)
        for kind in ("linear_acceleration", "angular_velocity")
    )
    places = np.stack([_column(fixes, f"utm_{axis}") for axis in ("easting", "northing")], axis=1)
    return _vectornav(_column(imu, "Time"), force, rates, _column(fixes, "Time"), places)


def _vectornav(t: Array, force: Array, rates: Array, t_fix: Array, places: Array) -> list[Message]:
    """An IMU, and the speed and course of positions (n, 2) of east and north [m]."""
    steps = np.diff(places, axis=0)
    way = np.hypot(steps[:, 0], steps[:, 1])
    course = np.degrees(np.arctan2(steps[:, 0], steps[:, 1])) % 360.0
    has_course = way > MOVED
    return [
        triad(0x61, "IMU_ACC", "acceleration", "m/s^2", 0.001, t, force, "_x _y _z"),
        triad(0x62, "IMU_RATE", "rate", "rad/s", 0.0001, t, rates, "_x _y _z"),
        Message(0x63, "FIX_SPEED", t_fix[1:], (
            Signal("speed", "m/s", 0.01, way / np.diff(t_fix), False),
        )),
        Message(0x64, "FIX_COURSE", t_fix[1:][has_course], (
            Signal("course", "deg", 0.01, course[has_course], False),
        )),
    ]  # fmt: skip


def _italian(rows: list[list[str]], place: int) -> Array:
    """Numbers with a comma before their decimals."""
    return np.array([float(row[place].replace(".", "").replace(",", ".")) for row in rows])


def _column(rows: list[dict[str, str]], name: str) -> Array:
    return np.array([float(row[name]) for row in rows])
