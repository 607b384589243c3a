"""Converters of recordings on race tracks: files of data loggers to messages."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import RACECHRONO, REVS

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
