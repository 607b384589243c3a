"""MCAP of ROS 2, for `ros2 bag play`, Foxglove and PlotJuggler.

Each table is a topic, and each message of the topic is a row. imucald reads the table again from
this topic. A player that does not know the message definitions skips these topics. The file also
contains standard ROS messages: corrected and raw samples as sensor_msgs/Imu, the mount as a static
transform, events as rcl_interfaces/Log. As defined by sensor_msgs/Imu, a covariance of zeros is not
known, and a covariance that begins with -1 means that the quantity is not measured.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from imucald.api.columns import EVENTS, HISTORY, RAW, Columns, columns_from
from imucald.api.files.imu_samples import ImuSamples, joined, mounts_of
from imucald.api.files.table_file import Tables, given_up, named, unfinished
from imucald.api.interchange import FILE_KEY, library
from imucald.core.errors import ImucaldError

_KINDS = {"float": "float64", "int8": "int8", "bool": "bool", "text": "string", "time": "int64"}
"""ROS types of the kinds of columns. A `time` is stored as whole microseconds since 1970."""
VEHICLE, SENSOR = "vehicle", "sensor"
_IMUS = {
    "/imu/data": ("accel", "gyro", VEHICLE),
    "/imu/data_raw": (f"{RAW}accel", f"{RAW}gyro", SENSOR),
}
"""Topics of REP 145, each with the names of its tables for force and rate, and its frame."""
_LATCHED = """- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""Quality of service in the notation of rosbag2: durability transient_local. Without this quality
of service, no tf2 listener accepts a static transform."""
_NOT_MEASURED = np.array([-1.0] + [0.0] * 8)


class McapTables:
    """Writes MCAP with messages of ROS 2."""

    needs: ClassVar = ("mcap.writer", "mcap")

    def __init__(self, path: Path, tables: Tables) -> None:
        writer = library(*self.needs)
        self._store = _Definitions()
        self._path = path
        self._file = unfinished(path).open("wb")
        self._writer = writer.Writer(self._file)
        self._writer.start(profile="ros2", library="imucald")
        self._schemas: dict[str, int] = {}
        self._topics = {name: _topic(name) for name in tables}
        self._types = self._store.of_tables(tables)
        self._channels = {
            topic: self._channel(topic, self._types[name]) for name, topic in self._topics.items()
        }
        imus = (topic for topic, (force, _, _) in _IMUS.items() if force in tables)
        standard = dict.fromkeys(imus, "sensor_msgs/msg/Imu")
        if EVENTS in tables:
            standard["/rosout"] = "rcl_interfaces/msg/Log"
        if HISTORY in tables:
            standard["/tf_static"] = "tf2_msgs/msg/TFMessage"
        self._channels |= {topic: self._channel(topic, of) for topic, of in standard.items()}
        self._start_us: int | None = None
        self._mounts = np.zeros((0, 10))
        self._mount: tuple[float, ...] | None = None

    def _channel(self, topic: str, of: str) -> int:
        if of not in self._schemas:
            text = self._store.definition(of).encode()
            self._schemas[of] = self._writer.register_schema(of, "ros2msg", text)
        quality = _LATCHED if topic == "/tf_static" else ""
        channel: int = self._writer.register_channel(
            topic, "cdr", self._schemas[of], {"offered_qos_profiles": quality}
        )
        return channel

    def _put(self, topic: str, us: int, of: str, message: Any) -> None:
        """Append a message of the type `of` with the time stamp `us` [us]."""
        stamp = max(us, 0) * 1000
        data = self._store.encoded(message, of)
        self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append a message for each row, and the standard ROS messages made from the rows."""
        for name, rows in part.items():
            topic, of = self._topics[name], self._types[name]
            make = self._store.types[of]
            for cells in zip(*(array.tolist() for array in rows.arrays), strict=True):
                self._put(topic, cells[1], of, make(*cells))
            if self._start_us is None and len(rows):
                self._start_us = int(rows["time"][0])
        if HISTORY in part:
            self._take_mounts(part[HISTORY])
        if EVENTS in part:
            self._put_events(part[EVENTS])
        for topic, (force, rate, frame) in _IMUS.items():
            if force in part:
                mounts = self._mounts if frame == VEHICLE else self._mounts[:0]
                for samples in joined(part[force], part.get(rate), mounts):
                    self._put_imu(topic, frame, samples)

    def _take_mounts(self, rows: Columns) -> None:
        """Store the mounts of new rows. The last of the previous rows is kept, because it is valid
        until the next row."""
        self._mounts = np.concatenate([self._mounts[-1:], mounts_of(rows)])
        quaternions = np.stack([rows[f"q_{part}"] for part in "xyzw"], axis=1)
        known = quaternions[~np.isnan(quaternions).any(axis=1)]
        if len(known):
            self._mount = tuple(known[-1].tolist())

    def _put_events(self, rows: Columns) -> None:
        of = "rcl_interfaces/msg/Log"
        make, no_place = self._store.types[of], ("", "", 0)
        for us, kind, text in zip(rows["time"], rows["kind"], rows["text"], strict=True):
            stamp = self._store.stamp(int(us))
            message = make(stamp, 20, "imucald", f"{kind}: {text}", *no_place)
            self._put("/rosout", int(us), of, message)

    def _put_imu(self, topic: str, frame: str, samples: ImuSamples) -> None:
        of = "sensor_msgs/msg/Imu"
        make = self._store.types[of]
        vector = self._store.types["geometry_msgs/msg/Vector3"]
        nothing, level = vector(0.0, 0.0, 0.0), self._store.quaternion(0.0, 0.0, 0.0, 1.0)
        for us, force, rate, of_force, of_rate in zip(*samples, strict=True):
            measured = vector(*rate.tolist()), of_rate
            if np.isnan(rate[0]):
                measured = nothing, _NOT_MEASURED
            accelerations = vector(*force.tolist()), of_force
            head = self._store.header(int(us), frame)
            message = make(head, level, _NOT_MEASURED, *measured, *accelerations)
            self._put(topic, int(us), of, message)

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the mount and the metadata, and close the file."""
        if self._mount is not None and self._start_us is not None:
            self._put(
                "/tf_static",
                self._start_us,
                "tf2_msgs/msg/TFMessage",
                self._store.transform(self._start_us, VEHICLE, SENSOR, self._mount),
            )
        text = json.dumps({**about, "topics": self._topics}, allow_nan=False, ensure_ascii=False)
        self._writer.add_metadata(FILE_KEY, {FILE_KEY: text})
        self._writer.finish()
        self._file.close()
        return [named(self._path)]

    def abandon(self) -> None:
        """Close and remove the unfinished file."""
        given_up([self._file], [unfinished(self._path)])


def _topic(name: str) -> str:
    if name == HISTORY:
        return "/mount"
    if name.startswith(RAW) or name == EVENTS:
        return f"/{name}"
    return f"/imu/{name}"


class _Definitions:
    """The definitions of the ROS 2 messages and of our own messages for tables."""

    def __init__(self) -> None:
        self._typesys = library("rosbags.typesys", "mcap")
        self._store = self._typesys.get_typestore(self._typesys.Stores.ROS2_HUMBLE)
        self.types: Mapping[str, Any] = self._store.types
        self.quaternion = self.types["geometry_msgs/msg/Quaternion"]

    def of_tables(self, tables: Tables) -> dict[str, str]:
        """Define a message type for each table. Return the name of the type for each table."""
        found: dict[str, str] = {}
        for name, columns in tables.items():
            words = re.findall(r"[A-Za-z0-9]+", name)
            of = f"imucald_msgs/msg/Table{''.join(word.capitalize() for word in words)}"
            while of in found.values():
                of += "Next"
            found[name] = of
            self.define(of, "\n".join(f"{_KINDS[c.kind]} {c.name}" for c in columns))
        return found

    def define(self, of: str, text: str) -> None:
        """Register the definition of a message."""
        self._store.register(self._typesys.get_types_from_msg(text, of))

    def definition(self, of: str) -> str:
        """Return the definition of a message, with the definitions of its parts."""
        text: str = self._store.generate_msgdef(of, ros_version=2)[0]
        return text

    def encoded(self, message: Any, of: str) -> bytes:
        """Encode a message as CDR."""
        return bytes(self._store.serialize_cdr(message, of))

    def decoded(self, data: bytes, of: str) -> Any:
        """Decode a message from CDR."""
        return self._store.deserialize_cdr(data, of)

    def stamp(self, us: int) -> Any:
        """Make a builtin_interfaces/Time from a time [us]."""
        seconds, microseconds = divmod(max(us, 0), 1_000_000)
        return self.types["builtin_interfaces/msg/Time"](seconds, microseconds * 1000)

    def header(self, us: int, frame: str) -> Any:
        """Make a std_msgs/Header."""
        return self.types["std_msgs/msg/Header"](self.stamp(us), frame)

    def transform(self, us: int, parent: str, child: str, xyzw: tuple[float, ...]) -> Any:
        """Make a tf2_msgs/TFMessage with one rotation."""
        types = self.types
        turn = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), self.quaternion(*xyzw)
        )
        one = types["geometry_msgs/msg/TransformStamped"](self.header(us, parent), child, turn)
        return types["tf2_msgs/msg/TFMessage"]([one])


def read_about(path: Path) -> dict[str, Any]:
    """Read the description of the tables from a file. Raises ImucaldError if imucald did not write
    it."""
    with path.open("rb") as file:
        for record in library("mcap.reader", "mcap").make_reader(file).iter_metadata():
            if record.name == FILE_KEY:
                found: dict[str, Any] = json.loads(record.metadata[FILE_KEY])
                return found
    raise ImucaldError(f"{path}: was not written by imucald")


def read_tables(path: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """Read the tables of a file."""
    names = {topic: name for name, topic in about["topics"].items()}
    store, known = _Definitions(), set[str]()
    rows: dict[str, list[list[Any]]] = {name: [[] for _ in cs] for name, cs in tables.items()}
    with path.open("rb") as file:
        reader = library("mcap.reader", "mcap").make_reader(file)
        for schema, channel, message in reader.iter_messages(topics=list(names)):
            if channel.message_encoding != "cdr":
                raise ImucaldError(
                    "an earlier version of imucald wrote its messages as JSON; replay the log again"
                )
            if schema.name not in known:
                store.define(schema.name, schema.data.decode())
                known.add(schema.name)
            name = names[channel.topic]
            found = store.decoded(message.data, schema.name)
            for cells, column in zip(rows[name], tables[name], strict=True):
                cells.append(getattr(found, column.name))
    return {name: columns_from(tables[name], cells) for name, cells in rows.items()}
