"""JSON schemas of the messages in an MCAP file.

sensor_msgs/Imu and MagneticField: the message definitions of ROS 2 (common_interfaces), field by
field. foxglove.FrameTransform and foxglove.Log: the JSON schemas that Foxglove publishes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_NUMBER = {"type": ["number", "null"]}
_INTEGER = {"type": "integer"}
_TEXT = {"type": "string"}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    found: dict[str, Any] = {"type": "object", "properties": properties}
    return {"title": title, **found} if title else found


_STAMP = _object("", sec=_INTEGER, nanosec=_INTEGER)
TIMESTAMP = _object("time", sec=_INTEGER, nsec=_INTEGER)
_HEADER = _object("", stamp=_STAMP, frame_id=_TEXT)
_VECTOR = _object("", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COVARIANCE = {"type": "array", "items": {"type": "number"}, "minItems": 9, "maxItems": 9}

SCHEMAS: Mapping[str, Mapping[str, Any]] = {
    "sensor_msgs/Imu": _object(
        "sensor_msgs/Imu",
        header=_HEADER,
        orientation=_QUATERNION,
        orientation_covariance=_COVARIANCE,
        angular_velocity=_VECTOR,
        angular_velocity_covariance=_COVARIANCE,
        linear_acceleration=_VECTOR,
        linear_acceleration_covariance=_COVARIANCE,
    ),
    "sensor_msgs/MagneticField": _object(
        "sensor_msgs/MagneticField",
        header=_HEADER,
        magnetic_field=_VECTOR,
        magnetic_field_covariance=_COVARIANCE,
    ),
    "foxglove.FrameTransform": _object(
        "foxglove.FrameTransform",
        timestamp=TIMESTAMP,
        parent_frame_id=_TEXT,
        child_frame_id=_TEXT,
        translation=_VECTOR,
        rotation=_QUATERNION,
    ),
    "foxglove.Log": _object(
        "foxglove.Log",
        timestamp=TIMESTAMP,
        level=_INTEGER,
        message=_TEXT,
        name=_TEXT,
        file=_TEXT,
        line=_INTEGER,
    ),
}
