"""Converters of recordings with a phone in somebody's pocket: source files to messages."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import AMSTERDAM

BUS = "car bus (Lars) 12062024 2043 2024-06-20 14-01-54"
CAR = "car pocket (Lars) 06062024 1014 2024-06-06 11-19-31"
MOTORWAY = "car pocket (Lars) 05062024 1321 2024-06-06 11-20-34"


def amsterdam(data: Path, trip: str) -> list[Message]:
    """Trip of 8 to 10 min with a phone in a pocket: 100 Hz, GPS 1 Hz (phyphox)."""

    def read(sensor: str) -> Array:
        content = AMSTERDAM.file(data, f"Data/{trip}/{sensor}.csv")
        return np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=1)

    force, rates, fixes = read("Accelerometer"), read("Gyroscope"), read("Location")
    fixes = fixes[np.isfinite(fixes[:, 4])]
    has_course = np.isfinite(fixes[:, 5]) & (fixes[:, 5] >= 0.0)
    return [
        triad(0x81, "Accelerometer", "acc_", "m/s^2", 0.005, force[:, 0], force[:, 1:4], "XYZ"),
        triad(0x82, "Gyroscope", "gyr_", "rad/s", 0.0005, rates[:, 0], rates[:, 1:4], "XYZ"),
        Message(0x83, "Velocity", fixes[:, 0], (
            Signal("Velocity", "m/s", 0.01, fixes[:, 4], False),
        )),
        Message(0x84, "Direction", fixes[has_course, 0], (
            Signal("Direction", "deg", 0.01, fixes[has_course, 5] % 360.0, False),
        )),
    ]  # fmt: skip
