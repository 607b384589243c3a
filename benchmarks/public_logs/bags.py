"""Converters of recordings made with ROS: topics of bags, or their columns, to messages."""

from __future__ import annotations

import csv
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import (
    NORTHEASTERN,
    ODOMETRY_FUSION,
    ROBOT_LOCALIZATION,
    Repository,
)
from imucald.api.interchange import library


def husky_field(data: Path) -> list[Message]:
    """Skid-steered robot outdoors, 6.6 min at up to 1 m/s: IMU 30 Hz, odometry of wheels 10 Hz."""
    imu, odometry = _topics(
        ROBOT_LOCALIZATION, data, "test/test1.bag", "/imu/data", "/husky_velocity_controller/odom"
    )
    twist = np.array([[m.twist.twist.linear.x, m.twist.twist.angular.z] for m in odometry])
    return [
        *_imu(imu, _stamps(imu)),
        Message(0x60, "ODOM", _stamps(odometry), (
            Signal("linear_x", "m/s", 0.0005, twist[:, 0]),
            Signal("angular_z", "rad/s", 0.0005, twist[:, 1]),
        )),
    ]  # fmt: skip


def kitti_0042(data: Path) -> list[Message]:
    """KITTI 2011_10_03_drive_0042, 2 min of a motorway: the OXTS unit's levelled axes, 10 Hz."""
    imu, velocity = _topics(
        ODOMETRY_FUSION, data, "0042_odom.bag", "/kitti/oxts/imu", "/kitti/oxts/gps/vel"
    )
    q = np.array([[getattr(m.orientation, axis) for axis in "xyzw"] for m in imu])
    yaw = np.arctan2(
        2.0 * (q[:, 3] * q[:, 2] + q[:, 0] * q[:, 1]), 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)
    )
    forward = np.array([m.twist.linear.x for m in velocity])
    return [
        *_imu(imu, _stamps(imu)),
        Message(0x60, "OXTS_VEL", _stamps(velocity), (Signal("vf", "m/s", 0.002, forward),)),
        Message(0x61, "OXTS_POSE", _stamps(imu), (Signal("yaw", "rad", 0.0002, yaw),)),
    ]  # fmt: skip


MOVED = 1.5
"""Metres between two fixes a second apart from which on they have a course."""


def boston_town(data: Path) -> list[Message]:
    """Car in a city, 11 min: IMU 40 Hz; speed and course of the GPS positions, 1 Hz."""
    folder = "lab5/data/first_test"
    imu, fixes = (
        list(csv.DictReader(io.StringIO(NORTHEASTERN.file(data, f"{folder}/{name}").decode())))
        for name in ("town_imu.csv", "town_gps.csv")
    )

    def columns(rows: list[dict[str, str]], *names: str) -> Array:
        return np.array([[float(row[name]) for name in names] for row in rows])

    t = columns(imu, "stamp")[:, 0]
    t_fix = columns(fixes, "stamp")[:, 0]
    steps = np.diff(columns(fixes, "utm_easting", "utm_northing"), axis=0)
    way = np.hypot(steps[:, 0], steps[:, 1])
    course = np.degrees(np.arctan2(steps[:, 0], steps[:, 1])) % 360.0
    has_course = way > MOVED
    return [
        triad(0x50, "VN_ACCEL", "accel_", "m/s^2", 0.001, t,
              columns(imu, "accel_x", "accel_y", "accel_z"), "xyz"),
        triad(0x51, "VN_GYRO", "gyro_", "rad/s", 0.0001, t,
              columns(imu, "gyro_x", "gyro_y", "gyro_z"), "xyz"),
        Message(0x60, "GPS_SPEED", t_fix[1:], (
            Signal("speed", "m/s", 0.01, way / np.diff(t_fix), False),
        )),
        Message(0x61, "GPS_COURSE", t_fix[1:][has_course], (
            Signal("course", "deg", 0.01, course[has_course], False),
        )),
    ]  # fmt: skip


def _imu(imu: list[Any], t: Array) -> list[Message]:
    """Accelerations and rates of sensor_msgs/Imu."""
    acceleration, rates = (
        np.array([[getattr(getattr(m, name), axis) for axis in "xyz"] for m in imu])
        for name in ("linear_acceleration", "angular_velocity")
    )
    return [
        triad(0x50, "IMU_LINEAR", "linear_", "m/s^2", 0.001, t, acceleration, "xyz"),
        triad(0x51, "IMU_ANGULAR", "angular_", "rad/s", 0.0002, t, rates, "xyz"),
    ]


def _stamps(messages: list[Any]) -> Array:
    return np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages])


def _topics(repository: Repository, data: Path, path: str, *topics: str) -> list[list[Any]]:
    """Messages of the topics, topic by topic, in their order."""
    bags, types = (library(f"rosbags.{part}", "public-logs") for part in ("rosbag1", "typesys"))
    store = types.get_typestore(types.Stores.ROS1_NOETIC)
    found: dict[str, list[Any]] = {topic: [] for topic in topics}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recording.bag"
        file.write_bytes(repository.file(data, path))
        with bags.Reader(file) as bag:
            wanted = [connection for connection in bag.connections if connection.topic in found]
            for connection, _, raw in bag.messages(wanted):
                message = store.deserialize_ros1(raw, connection.msgtype)
                found[connection.topic].append(message)
    return [found[topic] for topic in topics]
