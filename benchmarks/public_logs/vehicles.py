"""Converters of recordings with sensors fixed in a vehicle: source files to messages."""

from __future__ import annotations

import csv
import io
import struct
import tempfile
from collections.abc import Callable
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import (
    BALZER,
    COMMA2K19,
    DTU,
    EVERETT,
    GENESIS,
    KAU,
    TORONTO_IMU,
    TORONTO_OBD,
    XDRK,
)
from imucald.api.interchange import library


def everett_roof(data: Path) -> list[Message]:
    """IMU and RTK receiver on a car's roof: hilly streets, then a parking lot, 9 min."""
    folder = "data/drive_0708"
    imu = np.genfromtxt(
        io.BytesIO(EVERETT.file(data, f"{folder}/imu_1934.csv")), delimiter=",", skip_header=1
    )
    imu = imu[np.isfinite(imu).all(axis=1)]
    start, stop = _tagged_span(EVERETT.file(data, f"{folder}/imu_1934.csv.tag"))
    ticks = imu[:, 6] / 1000.0
    t = start + (ticks - ticks[0]) * (stop - start) / (ticks[-1] - ticks[0])
    text = EVERETT.file(data, f"{folder}/gnss_1934_sf.pos").decode()
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("%")]
    t_gnss = np.array([_utc(f"{row[0]} {row[1]}", "%Y/%m/%d %H:%M:%S.%f") for row in rows])
    north, east = (np.array([float(row[i]) for row in rows]) for i in (15, 16))
    return [
        triad(0x120, "IMU_ACC", "ACC", "g", 0.001, t, imu[:, :3]),
        triad(0x121, "IMU_RATE", "RATE", "deg/s", 0.004, t, imu[:, 3:6]),
        Message(0x130, "GNSS_VEL", t_gnss, (
            Signal("SPEED", "m/s", 0.001, np.hypot(north, east), is_signed=False),
            Signal("COURSE", "deg", 0.01, np.degrees(np.arctan2(east, north)) % 360.0, False),
        )),
    ]  # fmt: skip


def dresden_city(data: Path) -> list[Message]:
    """Car, 3.6 min in a city: IMU 50 Hz, GPS 10 Hz."""
    text = BALZER.file(data, "2014-03-26-000-Data.csv").decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    t = np.array([float(row["millis"]) for row in rows]) / 1000.0
    is_fix = np.array([True] + [a["time"] != b["time"] for a, b in pairwise(rows)])

    def column(name: str) -> Array:
        return np.array([float(row[name]) for row in rows])

    return [
        triad(0x10, "Accel", "a", "m/s^2", 0.002, t, _stack(column, "ax", "ay", "az"), "xyz"),
        Message(0x11, "Rates", t, tuple(
            Signal(name, "deg/s", 0.02, column(name))
            for name in ("rollrate", "pitchrate", "yawrate")
        )),
        Message(0x20, "GPS", t[is_fix], (
            Signal("speed", "km/h", 0.01, column("speed")[is_fix], False),
            Signal("course", "deg", 0.01, column("course")[is_fix], False),
        )),
    ]  # fmt: skip


def tcr_civic(data: Path) -> list[Message]:
    """Honda Civic TCR, 3 min of a qualifying session: the logger's sensors and the car's CAN."""
    libxrk = library("libxrk", "public-logs")
    path = "testdata/072/TCR_EU-21_E02-LCA_Q1_HO-FK7-M5-X-S_072_A_1252.xrk"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "session.xrk"
        file.write_bytes(XDRK.file(data, path))
        channels = libxrk.aim_xrk(str(file)).channels

    def message(id_: int, name: str, unit: str, step: float, *names: str,
                signed: bool = True) -> Message:  # fmt: skip
        tables = [channels[channel] for channel in names]
        t = np.asarray(tables[0].column("timecodes"), dtype=np.float64) / 1000.0
        return Message(id_, name, t, tuple(
            Signal(channel, unit, step, np.asarray(table.column(channel), dtype=np.float64), signed)
            for channel, table in zip(names, tables, strict=True)
        ))  # fmt: skip

    wheels = ("vWheelFL", "vWheelFR", "vWheelRL", "vWheelRR")
    speed = message(0x320, "LOG_GPS", "m/s", 0.005, "GPS Speed", signed=False)
    speed = Message(speed.id, speed.name, speed.t, (
        Signal("vGPS", "m/s", 0.005, speed.signals[0].values, False),
    ))  # fmt: skip
    return [
        message(0x300, "LOG_ACC", "g", 0.0002, "aLon", "aLat", "aVer"),
        message(0x301, "LOG_RATE", "deg/s", 0.01, "wRoll", "wPitch", "wYaw"),
        message(0x310, "ECU_WHEELS", "km/h", 0.05, *wheels, signed=False),
        message(0x311, "ECU_STEER", "deg", 0.1, "bSteering"),
        message(0x312, "ECU_BRAKE", "bar", 0.01, "pBrakeF", "pBrakeR"),
        message(0x313, "ECU_GEAR", "", 1.0, "posGear"),
        speed,
    ]


JEDDAH_LSB_PER_G = 16384.0
JEDDAH_LSB_PER_DEG_S = 16.4
"""MPU-6050 at +-2 g and +-2000 deg/s, the ranges that its motion processor's start sets."""


def jeddah_car(data: Path, drive: str) -> list[Message]:
    """Car in a city, "uni_home" 60 min, "harsh_data" 4 min: hobby logger, 4 Hz, stamps of 0.1 s.

    The files are those that their authors cleaned; they turned the sign of Ax, which is kept here.
    """
    text = KAU.file(data, f"Analysis_cleansing/cleaned_{drive}.csv").decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    t = np.array([_utc(row["Time"], "%Y-%m-%d %H:%M:%S.%f") for row in rows])

    def column(name: str) -> Array:
        return np.array([float(row[name]) for row in rows])

    acceleration = _stack(column, "Ax", "Ay", "Az") / JEDDAH_LSB_PER_G
    rates = _stack(column, "Gx", "Gy", "Gz") / JEDDAH_LSB_PER_DEG_S
    return [
        triad(0x101, "MPU_ACC", "A", "g", 1.0 / JEDDAH_LSB_PER_G, t, acceleration, "xyz"),
        triad(0x102, "MPU_GYR", "G", "deg/s", 1.0 / JEDDAH_LSB_PER_DEG_S, t, rates, "xyz"),
        Message(0x103, "MPU_DMP", t, (Signal("Yaw", "deg", 0.01, column("Yaw")),)),
        Message(0x110, "GPS_VTG", t, (
            Signal("Speed", "km/h", 0.01, column("Speed(km/h)"), False),
        )),
    ]  # fmt: skip


def comma_rav4(data: Path) -> list[Message]:
    """Toyota RAV4, 1 min of a motorway: a device behind the windscreen and the car's CAN."""
    folder = "Example_1/b0c9d2329ad1606b|2018-08-02--08-34-47/40/processed_log"

    def read(path: str) -> tuple[Array, Array]:
        t, value = (
            np.load(io.BytesIO(COMMA2K19.file(data, f"{folder}/{path}/{name}")))
            for name in ("t", "value")
        )
        return t, value

    speed, steering, wheels = (
        read(f"CAN/{name}") for name in ("speed", "steering_angle", "wheel_speed")
    )
    gnss = read("GNSS/live_gnss_ublox")
    corners = ("FL", "FR", "RL", "RR")
    return [
        triad(0x21, "EON_ACCEL", "a", "m/s^2", 0.001, *read("IMU/accelerometer"), "123"),
        triad(0x22, "EON_GYRO", "w", "rad/s", 0.0001, *read("IMU/gyro"), "123"),
        Message(0xAA, "WHEEL_SPEEDS", wheels[0], tuple(
            Signal(f"WHEEL_{corner}", "m/s", 0.002, wheels[1][:, i], False)
            for i, corner in enumerate(corners)
        )),
        Message(0x25, "STEER_ANGLE_SENSOR", steering[0], (
            Signal("STEER_ANGLE", "deg", 0.1, steering[1].ravel()),
        )),
        Message(0xB4, "SPEED", speed[0], (
            Signal("VEHICLE_SPEED", "m/s", 0.002, speed[1].ravel(), False),
        )),
        Message(0x30, "UBLOX", gnss[0], (
            Signal("GNSS_SPEED", "m/s", 0.005, gnss[1][:, 2], False),
            Signal("GNSS_BEARING", "deg", 0.01, gnss[1][:, 5], False),
        )),
    ]  # fmt: skip


def toronto_sienna(data: Path) -> list[Message]:
    """Toyota Sienna, 59 min of a city: IMU at 5 Hz, OBD-II speed resampled by its authors to 15 Hz.

    Both carry seconds of the GPS week. The reference beside the IMU is not on this bus.
    """
    imu, speed = (
        np.genfromtxt(io.BytesIO(repository.file(data, path)), delimiter=",", skip_header=1)
        for repository, path in (
            (TORONTO_IMU, "Toronto_Traj_one_IMU_sync.csv"),
            (TORONTO_OBD, "OBDII_Toronto_13_10_19_Trj1_15Hz_ZED.csv"),
        )
    )
    return [
        triad(0x61, "IMU_F", "f", "m/s^2", 0.0005, imu[:, 0], imu[:, 1:4], "_x _y _z"),
        triad(0x62, "IMU_W", "w", "rad/s", 0.00002, imu[:, 0], imu[:, 4:7], "_x _y _z"),
        Message(0x63, "OBD", speed[:, 0], (Signal("odom_speed", "m/s", 0.001, speed[:, 1]),)),
    ]


def genesis_lap(data: Path, lap: str) -> list[Message]:
    """Hyundai Genesis on a proving ground, a lap of 4 to 6 min: the car's own ESP sensors 100 Hz.

    Speed and heading are those of an INS; the steering is the angle of the front wheels.
    """
    recorded = loadmat(io.BytesIO(GENESIS.file(data, f"paths/cpg_{lap}_lap.mat")))
    column = {name: recorded[name].ravel() for name in ("t", "a_long", "a_lat", "wz", "df", "v",
                                                        "psi")}  # fmt: skip
    t = column["t"]
    return [
        Message(0x220, "ESP", t, (
            Signal("a_long", "m/s^2", 0.01, column["a_long"]),
            Signal("a_lat", "m/s^2", 0.01, column["a_lat"]),
            Signal("wz", "rad/s", 0.0001, column["wz"]),
        )),
        Message(0x2B0, "MDPS", t, (Signal("df", "rad", 0.0001, column["df"]),)),
        Message(0x2C0, "INS", t, (
            Signal("v", "m/s", 0.002, column["v"], False),
            Signal("psi", "rad", 0.0002, column["psi"]),
        )),
    ]  # fmt: skip


def dtu_ugv(data: Path) -> list[Message]:
    """Ground robot, 4 min outdoors: IMU 100 Hz; speed of the GNSS/INS solution at 10 Hz."""
    imu = np.genfromtxt(io.BytesIO(DTU.file(data, "data/run4_imu.txt")), skip_header=1)
    truth = ugv_truth(data)[::10]
    speed = np.linalg.norm(truth[:, 7:10], axis=1)
    return [
        triad(0x51, "IMU_A", "Accel", "m/s^2", 0.001, imu[:, 0], imu[:, 4:7]),
        triad(0x52, "IMU_G", "Gyro", "deg/s", 0.005, imu[:, 0], imu[:, 1:4]),
        Message(0x60, "ODO", truth[:, 0], (Signal("Velocity", "m/s", 0.001, speed, False),)),
    ]


def ugv_truth(data: Path) -> Array:
    """(n, 11): time [s], ECEF position [m], heading, pitch, roll [deg], ECEF velocity, UTC."""
    text = DTU.file(data, "data/run4_groundtruth.txt").decode(errors="replace")
    rows = [line.split() for line in text.splitlines()]
    return np.array(
        [[float(x) for x in row] for row in rows if len(row) == 11 and _is_number(row[0])]
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _tagged_span(tag: bytes) -> tuple[float, float]:
    """First and last time [s] of RTKLIB's time-tag file: head, then (tick [ms], position)."""
    seconds, fraction = struct.unpack_from("<Id", tag, 64)
    ticks = np.frombuffer(tag[76 : 76 + (len(tag) - 76) // 8 * 8], dtype="<u4").reshape(-1, 2)
    return seconds + fraction, seconds + fraction + ticks[-1, 0] / 1000.0


def _utc(text: str, form: str) -> float:
    return (datetime.strptime(text, form) - datetime(1970, 1, 1)).total_seconds()


def _stack(column: Callable[[str], Array], *names: str) -> Array:
    return np.stack([column(name) for name in names], axis=1)
