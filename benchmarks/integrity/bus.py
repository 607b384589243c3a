"""The judge's bus: the example bus with whatever a drive has, and two probes.

A probe is a parallel sensor that carries a known vector along the sensor's x and y. What comes out
of it is the first and second column of the rotation that is applied to what is sent, so that the
judge sees that rotation in frames and asks nothing of the daemon's inside.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.measured import made_once
from imucald.can.columns import FrameColumns
from imucald.config import LoadedConfig, parse_config
from imucald.core.samples import Samples, Series
from imucald.simulation import Drive, Truth, VehicleModel, random_model
from imucald.traffic.drive_encoder import BusEncoder
from imucald.traffic.other_units import joined

Array = NDArray[np.float64]

PROBE_IDS = (0x650, 0x651)
"""Frames of the probes as imucald sends them."""
PROBE_S = 1.0
LEAST, SPAN = 30.0, 20.0
"""Length of the probes' vectors [m/s^2]; it varies, so that nothing about them is stuck."""
PROBES = """
BO_ 768 ProbeX: 6 IMU
 SG_ X : 0|16@1- (0.002,0) [-65|65] "m/s^2" GATEWAY
 SG_ Y : 16|16@1- (0.002,0) [-65|65] "m/s^2" GATEWAY
 SG_ Z : 32|16@1- (0.002,0) [-65|65] "m/s^2" GATEWAY

BO_ 769 ProbeY: 6 IMU
 SG_ X : 0|16@1- (0.002,0) [-65|65] "m/s^2" GATEWAY
 SG_ Y : 16|16@1- (0.002,0) [-65|65] "m/s^2" GATEWAY
 SG_ Z : 32|16@1- (0.002,0) [-65|65] "m/s^2" GATEWAY

"""
SIGNALS = {
    "accel": "accelerometer: {x: IMU_Accel.AccelX, y: IMU_Accel.AccelY, z: IMU_Accel.AccelZ}",
    "gyro": "gyroscope: {x: IMU_Gyro.RateX, y: IMU_Gyro.RateY, z: IMU_Gyro.RateZ}",
    "speed": "speed: ESC_Speed.VehicleSpeed",
    "wheel_speeds": "wheel_speeds: {front_left: ESC_WheelSpeeds.WheelFrontLeft, front_right:"
    " ESC_WheelSpeeds.WheelFrontRight, rear_left: ESC_WheelSpeeds.WheelRearLeft, rear_right:"
    " ESC_WheelSpeeds.WheelRearRight}",
    "steering": "steering_wheel_angle: EPS_SteeringAngle.SteeringWheelAngle",
    "yaw_rate": "yaw_rate: ESC_Dynamics.YawRate",
    "lateral_accel": "lateral_acceleration: ESC_Dynamics.LateralAccel",
    "longitudinal_accel": "longitudinal_acceleration: ESC_Dynamics.LongitudinalAccel",
    "reverse": "reverse: {signal: TCU_Gear.GearPosition, equals: 1}",
    "brake": "brake: ESC_Brake.BrakePressed",
    "temperature": "temperature: IMU_Temperature.SensorTemperature",
}
PROTECTED = {
    "accel": ("IMU_Accel", "Accel"),
    "gyro": ("IMU_Gyro", "Gyro"),
    "steering": ("EPS_SteeringAngle", "Steering"),
    "yaw_rate": ("ESC_Dynamics", "Dynamics"),
    "speed": ("ESC_Speed", "Speed"),
}


@cache
def configuration(
    channels: frozenset[str],
    cycles: bool,
    side: str = "right",
    gyro_factor: float = 1.0,
) -> LoadedConfig:
    """The bus of a drive with these channels.

    cycles: whether the database states the example bus's cycle times. gyro_factor: what the
    database multiplies the gyroscope's values by, beside what is right.
    """
    text = _yaml(channels, side, _database(cycles, gyro_factor))
    return parse_config(text)


def _database(cycles: bool, gyro_factor: float) -> Path:
    text = (resources.files("imucald") / "data" / "imucald_example.dbc").read_text("utf-8")
    # The judge's faults multiply speeds: the range must not hide that.
    text = text.replace('[0|400] "km/h"', '[0|655.35] "km/h"')
    text = text.replace("BO_ 496 GW_", PROBES.lstrip() + "BO_ 496 GW_")
    if not cycles:
        text = re.sub(r'BA_ "GenMsgCycleTime" BO_ .*\n', "", text)
    if gyro_factor != 1.0:
        text = re.sub(
            r"( SG_ Rate[XYZ] : \S+) \(0\.01,0\) \[-250\|250\]",
            rf"\g<1> ({0.01 * gyro_factor:.9g},0) [0|0]",
            text,
        )

    def write(path: Path) -> None:
        path.write_text(text, "utf-8")

    return made_once("integrity.dbc", text, write)


def _yaml(channels: Collection[str], side: str, database: Path) -> str:
    lines = [f"database: {database}", f"vehicle: {{driving_side: {side}}}", "signals:"]
    lines += [f"  {text}" for channel, text in SIGNALS.items() if channel in channels]
    lines.append("  parallel:")
    for letter, can_id in zip("XY", PROBE_IDS, strict=True):
        axes = ", ".join(f"{axis.lower()}: Probe{letter}.{axis}" for axis in "XYZ")
        name = f"probe_{letter.lower()}"
        lines.append(f"    - {{name: {name}, kind: acceleration, {axes}, id: {can_id}}}")
    lines.append("messages:")
    for channel, (message, stem) in PROTECTED.items():
        if channel in channels:
            checksum = f"{{kind: crc8_j1850, signal: {stem}Checksum, id_bytes: 2}}"
            lines.append(
                f"  {message}: {{counter: {{signal: {stem}Counter}}, checksum: {checksum}}}"
            )
    return "\n".join(lines)


def probe_lengths(seconds: int) -> Array:
    """Lengths (seconds,) of the probes' vectors [m/s^2]."""
    random: Array = np.random.default_rng(0).random(seconds)
    return LEAST + SPAN * random


def frames(
    samples: Samples, duration_s: float, loaded: LoadedConfig, model: VehicleModel | None, seed: int
) -> FrameColumns:
    """Frames of samples in order of time, the probes' in the middle of each second.

    model, seed: of a simulated drive, whose lost frames the counters count; None for a measured
    one.
    """
    seconds = int(duration_s)
    t: Array = (np.arange(seconds, dtype=np.float64) + 0.5) * PROBE_S
    lengths = probe_lengths(seconds)
    with_probes = dict(samples)
    for axis, name in enumerate(("probe_x", "probe_y")):
        values = np.zeros((seconds, 3))
        values[:, axis] = lengths
        with_probes[f"parallel/{name}"] = Series(t, values)
    drive = Drive(with_probes, _no_truth(duration_s), model or random_model(seed), seed)
    found = joined(list(BusEncoder(loaded).frames(drive)))
    return found.take(np.argsort(found.t, kind="stable"))


def _no_truth(duration_s: float) -> Truth:
    """What the encoder does not look at, but for the length."""
    nothing, nowhere = np.zeros(2), np.zeros((2, 3))
    one = ("speed", "acceleration", "lateral_velocity", "yaw_rate", "steer", "heading")
    two = ("road_pitch", "road_roll", "body_pitch", "body_roll")
    return Truth(
        mounts=((0.0, np.eye(3)),),
        lever_arm_m=(0.0, 0.0, 0.0),
        t=np.array([0.0, duration_s]),
        force=nowhere,
        reference_force=nowhere,
        rate=nowhere,
        **dict.fromkeys(one + two, nothing),
    )
