"""Definition of the columns of every table: name, type, unit and meaning.

Columns are only appended; they are never renamed and never change their meaning. A file always has
all columns of its version; unknown values are null of the column's type.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

VERSION: Final = 2

Kind = Literal["text", "time", "float", "integer", "short", "flag"]


class Column(NamedTuple):
    """One column. The unit is empty if the column has no unit."""

    name: str
    kind: Kind
    unit: str = ""
    meaning: str = ""


def floats(unit: str, meaning: str, *names: str) -> tuple[Column, ...]:
    """Return columns of numbers with a common unit."""
    return tuple(Column(name, "float", unit, meaning) for name in names)


def texts(**meanings: str) -> tuple[Column, ...]:
    """Return columns of text. meanings: the meaning of each column, by name."""
    return tuple(Column(name, "text", "", meaning) for name, meaning in meanings.items())


AXES: Final = ("x", "y", "z")
PAIRS: Final = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Suffixes of the six elements of a symmetric matrix."""
COVARIANCES: Final = tuple(f"cov_{pair}_deg2" for pair in PAIRS)

QUATERNION: Final = ("q_w", "q_x", "q_y", "q_z")
ANGLE_NAMES: Final = ("roll_deg", "pitch_deg", "yaw_deg")
MOUNT = (
    *floats("", "mount as a unit quaternion, R_vehicle_from_sensor", *QUATERNION),
    *floats("deg", "mount as intrinsic Z-Y-X angles", *ANGLE_NAMES),
)

TABLES: Final[dict[str, tuple[Column, ...]]] = {
    "drives": (
        *texts(
            log_key="SHA-256 of the log's content, 16 hex digits: one row for each",
            run_key="hash of configuration, databases, model file and version",
            vehicle="name of the vehicle, by the rules of fleet.yaml",
            vehicle_type="model of the vehicle; all sensors of a type should have the same mount",
            sensor_serial="serial number of the sensor",
            sensor_batch="production batch of the sensor",
            firmware="firmware of the sensor",
            sources="addresses of the log, a JSON list",
            date="day of the log, or the day that a rule of fleet.yaml gives",
        ),
        Column(
            "start",
            "time",
            "",
            "time of the first frame, UTC; null where the log has no absolute time",
        ),
        Column("end", "time", "", "time of the last configured frame, UTC"),
        *floats("s", "time from the first configured frame to the last", "duration_s"),
        *floats("m", "distance, computed from the speed", "distance_m"),
        *texts(state="state of the calibration at the end"),
        *floats("s", "time from the log's first frame", "first_usable_s", "first_fine_s"),
        *MOUNT,
        *floats(
            "deg^2",
            "covariance of the rotation-vector error about the vehicle's axes",
            *COVARIANCES,
        ),
        *floats(
            "deg",
            "standard deviation of roll due to the road crown, contained in cov_xx; common to all "
            "drives on one side of the road",
            "crown_std_deg",
        ),
        *texts(
            driving_side="left, right or unknown",
            waiting_roll="evidence that roll still needs, in words",
            waiting_pitch="evidence that pitch still needs, in words",
            waiting_yaw="evidence that yaw still needs, in words",
            causes="faults that were seen in the drive, a JSON list of names",
        ),
        Column("frames_read", "integer", "", "frames of the log"),
        Column("frames_used", "integer", "", "frames that gave samples"),
        *texts(rejected="frames rejected by reason, JSON"),
        *floats("Hz", "accepted accelerometer samples per second", "rate_accel_hz"),
        Column("schema_version", "short", "", "version of this table"),
        *texts(
            diagnosed="certain causes that `imucald diagnose` finds in this drive, a JSON list; "
            "null where it did not run or gave no verdict"
        ),
    ),
    "events": (
        *texts(log_key="key of the drive", vehicle="as in drives"),
        Column(
            "time", "time", "", "time of the event, UTC; null where the log has no absolute time"
        ),
        *floats("s", "time from the log's first frame", "t_s"),
        *texts(
            kind="state, shift, contradiction, segment or sensor fault", text="description in words"
        ),
        *floats(
            "deg", "turn of the sensor about the vehicle's axes", "d_x_deg", "d_y_deg", "d_z_deg"
        ),
        Column("schema_version", "short", "", "version of this table"),
    ),
    "failures": (
        *texts(
            source="address of the log",
            vehicle="as in drives",
            log_key="as in drives; null if the content was not read to the end",
            run_key="as in drives",
            kind="kind of failure: unreadable, no_frames, config, storage, timeout, memory, "
            "crashed, bug",
            message="reason in words",
            traceback="traceback of Python, if there is one",
        ),
        Column(
            "exit_code", "integer", "", "exit status of the child process; -N: killed by signal N"
        ),
        Column("attempts", "integer", "", "number of attempts to evaluate the log"),
        Column("schema_version", "short", "", "version of this table"),
    ),
    "sources": (
        *texts(
            source="address of the log",
            fingerprint="etag of the log, or its size and time of change",
            log_key="hash of the log's content; null if the log was not read",
            run_key="as in drives",
            vehicle="as in drives",
            outcome="ok, or the kind of failure",
        ),
        Column("bytes", "integer", "B", "size of the log"),
        Column("schema_version", "short", "", "version of this table"),
    ),
    "costs": (
        *texts(source="address of the log", outcome="ok, or the kind of failure"),
        Column("attempt", "integer", "", "number of the attempt; the first is 1"),
        Column("finished", "time", "", "end of the attempt, UTC"),
        *floats("s", "elapsed time in the worker", "wall_s"),
        *floats("s", "processor time", "cpu_s"),
        Column("peak_memory_bytes", "integer", "B", "largest resident memory of the child process"),
        *texts(worker="machine that evaluated the log"),
        Column("bytes", "integer", "B", "size of the log"),
        Column("schema_version", "short", "", "version of this table"),
    ),
}
"""Tables that `fleet run` writes. The tables of `fleet analyse` are defined in
`analysis_columns`."""

ORDER: Final = {
    "drives": ("vehicle", "start", "date", "sources", "log_key"),
    "events": ("vehicle", "log_key", "t_s", "kind", "text"),
    "failures": ("source",),
    "sources": ("source",),
    "costs": ("finished", "source", "attempt"),
}
"""Columns by which the rows of a finished table are sorted."""


def row_of(table: str, values: dict[str, object]) -> dict[str, object]:
    """Return a row with every column of a table. Missing values are null."""
    found = {column.name: values.get(column.name) for column in TABLES[table]}
    found["schema_version"] = VERSION
    return found
