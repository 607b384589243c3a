"""Converters of what the app phyphox wrote, in a pocket or fixed in a car: files to messages."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import Repository

BUS = "Data/car bus (Lars) 12062024 2043 2024-06-20 14-01-54"
CAR = "Data/car pocket (Lars) 06062024 1014 2024-06-06 11-19-31"
MOTORWAY = "Data/car pocket (Lars) 05062024 1321 2024-06-06 11-20-34"


def phyphox(data: Path, repository: Repository, folder: str) -> list[Message]:
    """Trip of 2 to 11 min: a phone's sensors at 10 or 100 Hz, GPS 1 Hz.

    iOS writes a speed of -1 where it has none; such rows are no fixes.
    """

    def read(sensor: str) -> Array:
        content = repository.file(data, f"{folder}/{sensor}.csv")
        return np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=1)

    force, rates, fixes = read("Accelerometer"), read("Gyroscope"), read("Location")
    fixes = fixes[np.isfinite(fixes[:, 4]) & ~(fixes[:, 4] < 0.0)]
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
