"""Foxglove: a server of the Foxglove WebSocket protocol. Topics: IMU (corrected, raw), attitude,
mount, status.

Topics, fields and frames are the same as in an MCAP file of `replay --write`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from imucald.core.angles import RAD_PER_DEG
from imucald.core.rotations import quaternion_from_rotation, rotation_from_angles
from imucald.feeds.corrected_frames import Triple
from imucald.feeds.daemon_source import Reading, Say, status_content
from imucald.feeds.feed_loop import ReceiverError

_NUMBER = {"type": ["number", "null"]}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _numbers(title: str, *names: str) -> dict[str, Any]:
    return _object(title, **dict.fromkeys(names, _NUMBER))


_IMU = _object(
    "imucald.Imu",
    frame_id={"type": "string"},
    linear_acceleration=_numbers("m/s^2", *"xyz"),
    angular_velocity=_numbers("rad/s", *"xyz"),
)
SCHEMAS: Mapping[str, Mapping[str, Any]] = {
    "/imu/data": _IMU,
    "/imu/data_raw": _IMU,
    "/attitude": _numbers("imucald.Attitude", "roll_deg", "pitch_deg", "heading_deg"),
    "/mount": _object(
        "imucald.Mount",
        **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), _NUMBER),
        angle_plus_minus_deg=_numbers("95 %", "roll", "pitch", "yaw"),
        plus_minus_deg=_numbers("95 %, about the vehicle's axes", *"xyz"),
        quaternion_wxyz={"type": ["array", "null"], "items": {"type": "number"}},
        sits={"type": ["string", "null"]},
    ),
    "/status": _object(
        "imucald.Status",
        running={"type": "boolean"},
        held={"type": "boolean"},
        **{key: {"type": "string"} for key in ("state", "quality", "bus")},
        waiting_for={"type": "object"},
        alarms={"type": "array", "items": {"type": "string"}},
    ),
}
"""JSON schemas of the topics. The value null means *not available*."""


@dataclass(frozen=True)
class FoxgloveSettings:
    """Settings of the server. host, port: address of the server; port 0 means any free port."""

    host: str
    port: int


class FoxgloveReceiver:
    """A receiver that publishes with a server of foxglove-sdk. Threads of the server handle the
    connections."""

    def __init__(self, settings: FoxgloveSettings, say: Say) -> None:
        import foxglove  # noqa: PLC0415 - an extra
        from foxglove import channels, messages  # noqa: PLC0415

        foxglove.set_log_level("ERROR")
        self._library, self._messages = foxglove, messages
        self._settings = settings
        self._say = say
        self._server: Any = None
        context = foxglove.Context()
        self._context = context
        self._channels = {
            topic: foxglove.Channel(topic, schema=dict(schema), context=context)
            for topic, schema in SCHEMAS.items()
        }
        self._transforms = channels.FrameTransformChannel("/tf", context=context)

    @property
    def port(self) -> int:
        """The port of the running server."""
        return int(self._server.port)

    def connect(self) -> None:
        """Start the server."""
        host, port = self._settings.host, self._settings.port
        try:
            self._server = self._library.start_server(
                name="imucald", host=host, port=port, context=self._context
            )
        except Exception as error:  # of several kinds
            raise ReceiverError(f"cannot listen on {host}:{port}: {error}") from None
        self._say(f"open ws://{host}:{self.port} in Foxglove (Foxglove WebSocket)")

    def publish(self, reading: Reading) -> None:
        """Send a reading to the connected clients."""
        at = round(reading.at * 1e9)
        for topic, content in contents(reading).items():
            self._channels[topic].log(content, log_time=at)
        for (parent, child), (w, x, y, z) in transforms(reading).items():
            transform = self._messages.FrameTransform(
                timestamp=self._messages.Timestamp(*divmod(at, 10**9)),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=self._messages.Vector3(x=0.0, y=0.0, z=0.0),
                rotation=self._messages.Quaternion(x=x, y=y, z=z, w=w),
            )
            self._transforms.log(transform, log_time=at)

    def disconnect(self) -> None:
        """Do nothing, because clients connect and disconnect by themselves."""

    def close(self) -> None:
        """Close the connections."""
        if self._server is not None:
            self._server.stop()


def contents(reading: Reading) -> dict[str, dict[str, Any]]:
    """Return the messages by topic. Messages for mount and status are returned only if the status
    is new."""
    found: dict[str, dict[str, Any]] = {}
    for topic, frame, vectors in (
        ("/imu/data", "vehicle", reading.corrected),
        ("/imu/data_raw", "sensor", reading.raw),
    ):
        if vectors:
            found[topic] = {
                "frame_id": frame,
                "linear_acceleration": _vector(vectors.get("acceleration"), 1.0),
                "angular_velocity": _vector(vectors.get("angular_rate"), RAD_PER_DEG),
            }
    if reading.attitude is not None:
        names = SCHEMAS["/attitude"]["properties"]
        found["/attitude"] = dict(zip(names, reading.attitude, strict=True))
    if reading.is_new:
        status = status_content(reading.at, reading.status)
        if "mount" in status:
            found["/mount"] = status.pop("mount")
        found["/status"] = status
    return found


def _vector(values: Triple | None, factor: float) -> dict[str, float | None]:
    x, y, z = (None, None, None) if values is None else (v * factor for v in values)
    return {"x": x, "y": y, "z": z}


def transforms(reading: Reading) -> dict[tuple[str, str], tuple[float, float, float, float]]:
    """Return the quaternions w, x, y, z from child frame to parent frame, by (parent, child).

    The result contains the sensor frame in the vehicle frame if the mount is known. The result
    contains the vehicle frame in the level frame if the attitude is known (heading 0 if the heading
    is not known).
    """
    found: dict[tuple[str, str], tuple[float, float, float, float]] = {}
    if reading.is_new and reading.status is not None:
        quaternion = reading.status["mount"]["quaternion_wxyz"]
        if quaternion is not None:
            found["vehicle", "sensor"] = tuple(quaternion)
    if reading.attitude is not None:
        roll, pitch, heading = (math.radians(v or 0.0) for v in reading.attitude)
        found["level", "vehicle"] = quaternion_from_rotation(
            rotation_from_angles(roll, pitch, -heading)
        )
    return found
