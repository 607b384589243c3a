"""A vehicle that shuttles straight on: launches and brakings with stops between, as a candump log.

Made for tests that need a calibration within a minute; shares nothing with the simulation.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 512 IMU_A: 8 X
 SG_ AX : 0|16@1- (0.002,0) [-65.534|65.534] "m/s^2" X
 SG_ AY : 16|16@1- (0.002,0) [-65.534|65.534] "m/s^2" X
 SG_ AZ : 32|16@1- (0.002,0) [-65.534|65.534] "m/s^2" X
BO_ 513 IMU_G: 8 X
 SG_ GX : 0|16@1- (0.01,0) [-327.67|327.67] "deg/s" X
 SG_ GY : 16|16@1- (0.01,0) [-327.67|327.67] "deg/s" X
 SG_ GZ : 32|16@1- (0.01,0) [-327.67|327.67] "deg/s" X
BO_ 514 SPEED: 2 X
 SG_ V : 0|16@1+ (0.01,0) [0|655.35] "m/s" X
"""

CONFIG = """
database: shuttle.dbc
signals:
  accelerometer: {x: IMU_A.AX, y: IMU_A.AY, z: IMU_A.AZ}
  gyroscope: {x: IMU_G.GX, y: IMU_G.GY, z: IMU_G.GZ}
  speed: SPEED.V
calibration:
  estimator: published
  accelerometer_bias: 0.02
output:
  status_rate: 10
"""

ACCELERATION = 2.0
"""Of launches and brakings [m/s^2]."""
RATE = 100
"""IMU samples per second."""
G = 9.80665


def write(folder: Path, cycles: int = 6, yaw_deg: float = 25.0, t0: float = 1.6e9) -> Path:
    """Write shuttle.dbc, shuttle.yaml and shuttle.log; return the configuration's path."""
    (folder / "shuttle.dbc").write_text(DBC)
    (folder / "shuttle.yaml").write_text(CONFIG)
    cycle = [0.0] * (2 * RATE) + [ACCELERATION] * (3 * RATE) + [0.0] * (RATE // 2)
    cycle += [-ACCELERATION] * (3 * RATE)
    a = np.array([0.0] * RATE + cycle * cycles + [0.0] * (3 * RATE))
    v = np.maximum(np.cumsum(a) / RATE, 0.0)
    rng = np.random.default_rng(7)
    yaw = np.radians(yaw_deg)
    # the sensor is turned by yaw to the left: what is forward for the vehicle is to its right
    x, y = a * np.cos(yaw), -a * np.sin(yaw)
    f = np.stack([x, y, np.full(len(a), G)], axis=1) + rng.normal(0, 0.05, (len(a), 3))
    w = rng.normal(0, 0.2, (len(a), 3))
    lines = []
    for i in range(len(a)):
        t = t0 + i / RATE
        lines.append(_line(t, 0x200, struct.pack("<3hxx", *np.rint(f[i] / 0.002).astype(int))))
        lines.append(
            _line(t + 0.0005, 0x201, struct.pack("<3hxx", *np.rint(w[i] / 0.01).astype(int)))
        )
        if i % 5 == 0:
            lines.append(_line(t + 0.001, 0x202, struct.pack("<H", round(v[i] / 0.01))))
        lines.append(_line(t + 0.002, 0x100 + i % 7, bytes([i & 0xFF] * 8)))  # not ours
    (folder / "shuttle.log").write_text("\n".join(lines) + "\n")
    return folder / "shuttle.yaml"


def _line(t: float, can_id: int, data: bytes) -> str:
    return f"({t:.6f}) can0 {can_id:03X}#{data.hex().upper()}"
