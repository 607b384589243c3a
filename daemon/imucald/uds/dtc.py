"""The diagnostic trouble codes (DTCs)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

NOT_CALIBRATED_S: Final = 1200.0
"""Time without a calibration until the code is confirmed [s]. A calibration takes minutes of
driving."""


@dataclass(frozen=True)
class Dtc:
    """One DTC.

    number: three bytes, the last is the failure type (SAE J2012-DA). confirm_after: duration of the
    failure until the code is confirmed [s].
    """

    number: int
    name: str
    meaning: str
    confirm_after: float = 0.0

    @property
    def display(self) -> str:
        """The code as a tester shows it, such as "C1A10-54"."""
        kind = "PCBU"[self.number >> 22]
        return f"{kind}{self.number >> 8 & 0x3FFF:04X}-{self.number & 0xFF:02X}"


FAULTS: Final = {
    "saturated": (0x22, "many of its values are at the end of its range"),
    "stuck": (0x2A, "one or more of its axes repeat the same value"),
    "implausible": (0x64, "its values are impossible for a road vehicle, or its unit is wrong"),
}
"""Faults of sensors, each with its failure type and its meaning. The failure types are: signal
amplitude above maximum, signal stuck in range, signal plausibility failure."""
FAULTY: Final = {
    sensor: {
        fault: Dtc(code << 8 | kind, f"{sensor}_{fault}", meaning)
        for fault, (kind, meaning) in FAULTS.items()
    }
    for sensor, code in (("accelerometer", 0x5A12), ("gyroscope", 0x5A13), ("magnetometer", 0x5A16))
} | {
    signal: {"stuck": Dtc(code << 8 | FAULTS["stuck"][0], f"{signal}_stuck", meaning)}
    for signal, code, meaning in (
        ("speed", 0x5A14, "it repeats the same value while the motion of the vehicle changes"),
        ("yaw_rate", 0x5A17, "it repeats the same value while the vehicle turns"),
    )
}
"""The DTC of each fault, by sensor or signal."""
NOT_CALIBRATED = Dtc(
    0x5A1054, "not_calibrated", "no correction of the sensor is known yet", NOT_CALIBRATED_S
)
SENSOR_MOVED = Dtc(0x5A1176, "sensor_moved", "the sensor seems to have been moved")
ACCELEROMETER_MISSING = Dtc(0x5A1287, "accelerometer_missing", "no good sample for a second")
GYROSCOPE_MISSING = Dtc(0x5A1387, "gyroscope_missing", "no good sample for a second")
SPEED_MISSING = Dtc(0x5A1487, "speed_missing", "no good sample for a second")
CHECKSUM_FAILING = Dtc(
    0xDA1083, "checksum_failing", "three frames with a wrong checksum within ten seconds"
)
COUNTER_FAILING = Dtc(
    0xDA1082,
    "counter_failing",
    "three frames with a repeated, reversed, jumping or invalid counter within ten seconds",
)
DUPLICATE_SENDER = Dtc(
    0xDA1281, "duplicate_sender", "an input comes more often than one sender can send it"
)
ID_CONFLICT = Dtc(0xDA1181, "id_conflict", "another node sends our identifiers")
STATE_CORRUPT = Dtc(0x5A1546, "state_corrupt", "the saved state could not be used")

DTCS: Final = (
    NOT_CALIBRATED,
    SENSOR_MOVED,
    ACCELEROMETER_MISSING,
    GYROSCOPE_MISSING,
    SPEED_MISSING,
    STATE_CORRUPT,
    COUNTER_FAILING,
    CHECKSUM_FAILING,
    ID_CONFLICT,
    DUPLICATE_SENDER,
    *(dtc for faults in FAULTY.values() for dtc in faults.values()),
)
"""All DTCs, in the order in which they are reported."""
