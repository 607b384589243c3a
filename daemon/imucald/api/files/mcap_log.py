"""MCAP with JSON messages, for Foxglove and PlotJuggler: to look at, not to compute with.

Samples are shaped like ROS's sensor_msgs/Imu and sensor_msgs/MagneticField (Foxglove has no schema
of its own for these), the mount is a foxglove.FrameTransform, an event a foxglove.Log. As those
messages ask, the first number of a covariance is -1 where a quantity is not measured. Each message
has more keys than the schema asks for: `t_s`, and the table's other columns.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from imucald.api.columns import EVENTS, HISTORY, RAW, Columns, TableColumn, columns_from
from imucald.api.files.mcap_schemas import SCHEMAS, TIMESTAMP
from imucald.api.files.table_file import Tables, given_up, named, unfinished
from imucald.api.interchange import FILE_KEY, library
from imucald.core.errors import ImucaldError

NOT_MEASURED = [-1.0] + [0.0] * 8
UNKNOWN = [0.0] * 9
"""Covariances, as sensor_msgs/Imu says."""
_XYZ = "xyz"


class McapTables:
    """Writes MCAP: a topic for each table."""

    needs: ClassVar = ("mcap.writer", "mcap")

    def __init__(self, path: Path, tables: Tables) -> None:
        writer = library(*self.needs)
        self._path = path
        self._file = unfinished(path).open("wb")
        self._writer = writer.Writer(self._file)
        self._writer.start(profile="", library="imucald")
        self._topics = {name: _topic(name) for name in tables}
        self._channels: dict[str, int] = {}
        self._messages: dict[str, Callable[[Mapping[str, Any]], bytes]] = {}
        schemas: dict[str, int] = {}
        for name, columns in tables.items():
            schema, self._messages[name] = _message(name, columns)
            if schema not in schemas:
                text = json.dumps(SCHEMAS.get(schema) or _plain_schema(columns)).encode()
                schemas[schema] = self._writer.register_schema(schema, "jsonschema", text)
            self._channels[name] = self._writer.register_channel(
                self._topics[name], "json", schemas[schema]
            )

    def add(self, name: str, rows: Columns) -> None:
        """Append a message for each row."""
        channel, message = self._channels[name], self._messages[name]
        keys = [c.name for c in rows.columns]
        cells = (array.tolist() for array in rows.arrays)
        for row in zip(*cells, strict=True):
            values = dict(zip(keys, row, strict=True))
            stamp = max(values["time"], 0) * 1000
            self._writer.add_message(channel, stamp, message(values), stamp)

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the metadata and close."""
        text = json.dumps({**about, "topics": self._topics}, allow_nan=False, ensure_ascii=False)
        self._writer.add_metadata(FILE_KEY, {FILE_KEY: text})
        self._writer.finish()
        self._file.close()
        return [named(self._path)]

    def abandon(self) -> None:
        """Close and remove."""
        given_up([self._file], [unfinished(self._path)])


def _topic(name: str) -> str:
    if name == HISTORY:
        return "/mount"
    if name.startswith(RAW) or name == EVENTS:
        return f"/{name}"
    return f"/imu/{name}"


# rows as messages --------------------------------------------------------------------------


def _message(
    name: str, columns: tuple[TableColumn, ...]
) -> tuple[str, Callable[[Mapping[str, Any]], bytes]]:
    """Schema of a table's messages, and what makes one of a row."""
    if name == HISTORY:
        return "foxglove.FrameTransform", _transform
    if name == EVENTS:
        return "foxglove.Log", _log
    frame = "sensor" if name.startswith(RAW) else "vehicle"
    axes = tuple(c.name for c in columns[2:5])
    kind = axes[0].removeprefix("raw_").partition("_")[0] if len(axes) == len(_XYZ) else ""
    if kind in ("accel", "gyro"):
        return "sensor_msgs/Imu", lambda row: _imu(row, axes, frame, kind == "gyro")
    if kind == "mag":
        return "sensor_msgs/MagneticField", lambda row: _field(row, axes, frame)
    return f"imucald.{name.removeprefix(RAW)}", _plain_message


def _stamp(row: Mapping[str, Any]) -> tuple[int, int]:
    seconds, microseconds = divmod(max(row["time"], 0), 1_000_000)
    return seconds, microseconds * 1000


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _head(row: Mapping[str, Any], frame: str) -> dict[str, Any]:
    seconds, nanoseconds = _stamp(row)
    found = {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame},
        "t_s": row["t_s"],
    }
    if "quality" in row:
        found["quality"] = row["quality"]
    return found


def _vector(row: Mapping[str, Any], axes: tuple[str, ...]) -> dict[str, float | None]:
    return {axis: _number(row[name]) for axis, name in zip(_XYZ, axes, strict=True)}


_ZERO = dict.fromkeys(_XYZ, 0.0)


def _imu(row: Mapping[str, Any], axes: tuple[str, ...], frame: str, is_rate: bool) -> bytes:
    measured = _vector(row, axes)
    content = {
        **_head(row, frame),
        "orientation": {**_ZERO, "w": 1.0},
        "orientation_covariance": NOT_MEASURED,
        "angular_velocity": measured if is_rate else _ZERO,
        "angular_velocity_covariance": UNKNOWN if is_rate else NOT_MEASURED,
        "linear_acceleration": _ZERO if is_rate else measured,
        "linear_acceleration_covariance": NOT_MEASURED if is_rate else UNKNOWN,
    }
    return msgspec.json.encode(content)


def _field(row: Mapping[str, Any], axes: tuple[str, ...], frame: str) -> bytes:
    content = {
        **_head(row, frame),
        "magnetic_field": _vector(row, axes),
        "magnetic_field_covariance": UNKNOWN,
    }
    return msgspec.json.encode(content)


def _rest(row: Mapping[str, Any], taken: tuple[str, ...]) -> dict[str, Any]:
    return {
        key: _number(value) if isinstance(value, float) else value
        for key, value in row.items()
        if key not in ("time", *taken)
    }


def _timestamp(row: Mapping[str, Any]) -> dict[str, int]:
    seconds, nanoseconds = _stamp(row)
    return {"sec": seconds, "nsec": nanoseconds}


_QUATERNION = ("q_w", "q_x", "q_y", "q_z")


def _transform(row: Mapping[str, Any]) -> bytes:
    known = math.isfinite(row["q_w"])
    rotation = {axis: row[f"q_{axis}"] if known else float(axis == "w") for axis in "xyzw"}
    content = {
        "timestamp": _timestamp(row),
        "parent_frame_id": "vehicle",
        "child_frame_id": "sensor" if known else "sensor_unknown",
        "translation": _ZERO,
        "rotation": rotation,
        **_rest(row, _QUATERNION),
    }
    return msgspec.json.encode(content)


def _log(row: Mapping[str, Any]) -> bytes:
    content = {
        "timestamp": _timestamp(row),
        "level": 2,  # INFO
        "message": f"{row['kind']}: {row['text']}",
        "name": "imucald",
        "file": "",
        "line": 0,
        **_rest(row, ()),
    }
    return msgspec.json.encode(content)


def _plain_message(row: Mapping[str, Any]) -> bytes:
    return msgspec.json.encode({"timestamp": _timestamp(row), **_rest(row, ())})


def _plain_schema(columns: tuple[TableColumn, ...]) -> dict[str, Any]:
    numbers = {c.name: {"type": ["number", "null"]} for c in columns if c.name != "time"}
    return {"type": "object", "properties": {"timestamp": TIMESTAMP, **numbers}}


# messages as rows --------------------------------------------------------------------------


def read_about(path: Path) -> dict[str, Any]:
    """What a file states about itself. Raises ImucaldError for one that imucald did not write."""
    with path.open("rb") as file:
        for record in library("mcap.reader", "mcap").make_reader(file).iter_metadata():
            if record.name == FILE_KEY:
                found: dict[str, Any] = json.loads(record.metadata[FILE_KEY])
                return found
    raise ImucaldError(f"{path}: was not written by imucald")


def read_tables(path: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """The tables of a file."""
    names = {topic: name for name, topic in about["topics"].items()}
    rows: dict[str, list[list[Any]]] = {name: [[] for _ in cs] for name, cs in tables.items()}
    with path.open("rb") as file:
        messages = library("mcap.reader", "mcap").make_reader(file).iter_messages()
        for _, channel, message in messages:
            name = names[channel.topic]
            cells = _cells(
                msgspec.json.decode(message.data), message.log_time // 1000, tables[name]
            )
            for column, cell in zip(rows[name], cells, strict=True):
                column.append(cell)
    return {name: columns_from(tables[name], cells) for name, cells in rows.items()}


_VECTORS = {"accel": "linear_acceleration", "gyro": "angular_velocity", "mag": "magnetic_field"}


def _cells(
    message: Mapping[str, Any], time: int, columns: tuple[TableColumn, ...]
) -> Iterator[Any]:
    for column in columns:
        if column.kind == "time":
            yield time
            continue
        value = message[column.name] if column.name in message else _nested(message, column.name)
        yield math.nan if value is None and column.kind == "float" else value


def _nested(message: Mapping[str, Any], name: str) -> Any:
    """A column's value from where the schema has it."""
    if name in _QUATERNION:
        is_known = message["child_frame_id"] == "sensor"
        return message["rotation"][name[-1]] if is_known else None
    kind, axis = name.removeprefix("raw_").split("_")[:2]
    return message[_VECTORS[kind]][axis]
