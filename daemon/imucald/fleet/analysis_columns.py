"""Columns of the tables written by `fleet analyse`."""

from __future__ import annotations

from typing import Final

from imucald.fleet.columns import Column, floats, texts


def _xyz(unit: str, meaning: str, form: str) -> tuple[Column, ...]:
    """Return three columns, one for each axis of the vehicle. form: name of the columns with {} for
    the axis."""
    return floats(unit, meaning, *(form.format(axis) for axis in "xyz"))


_QUATERNION = ("q_w", "q_x", "q_y", "q_z")
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
_MOUNT = (
    *floats("", "mount as a unit quaternion, R_vehicle_from_sensor", *_QUATERNION),
    *floats("deg", "mount as intrinsic Z-Y-X angles", *_ANGLES),
    *_xyz("deg", "half of its 95 % interval, crown included", "ci95_{}_deg"),
)
_OF_ANGLES = (
    "deg",
    "half of the 95 % interval of the angle itself, crown included; none where it is not known",
)
_CI95_OF_ANGLES = floats(*_OF_ANGLES, *(f"ci95_{name}" for name in _ANGLES))
_TEST = (
    *floats("", "probability of such a difference by chance", "p"),
    *floats("", "share of false findings among all with this q or a smaller one", "q"),
)

ANALYSIS: Final[dict[str, tuple[Column, ...]]] = {
    "analysis/types": (
        *texts(vehicle_type="model of the vehicle"),
        Column("vehicles", "integer", "", "with a known mount"),
        Column("drives", "integer", "", "with a known mount"),
        *_MOUNT,
        *_xyz("deg", "spread from vehicle to vehicle (T)", "tau_{}_deg"),
        *_xyz("deg", "lower end of its 95 % interval", "tau_low_{}_deg"),
        *_xyz("deg", "upper end", "tau_high_{}_deg"),
        *_xyz("deg", "spread from drive to drive (D)", "drive_{}_deg"),
        *_xyz("deg", "lower end of its 95 % interval", "drive_low_{}_deg"),
        *_xyz("deg", "upper end", "drive_high_{}_deg"),
        *floats(
            "deg", "part of the road crown in the roll intervals, common to all", "crown_std_deg"
        ),
        *_CI95_OF_ANGLES,
    ),
    "analysis/vehicles": (
        *texts(
            vehicle="name",
            vehicle_type="as in drives",
            sensor_serial="as in drives",
            sensor_batch="as in drives",
            firmware="as in drives",
        ),
        Column("drives", "integer", "", "with a known mount"),
        Column("drives_unknown", "integer", "", "with a mount that is not known"),
        Column("segments", "integer", "", "between remounts"),
        *_MOUNT,
        *floats(
            "", "mount, drawn towards that of the type", *(f"shrunk_{name}" for name in _QUATERNION)
        ),
        *floats(
            "deg", "mount, drawn towards that of the type", *(f"shrunk_{name}" for name in _ANGLES)
        ),
        *_xyz("deg", "half of its 95 % interval, crown included", "shrunk_ci95_{}_deg"),
        *_xyz("", "weight of the vehicle's own data; 1: not shrunk", "weight_{}"),
        *_xyz("deg", "first segment compared with its type, without bad batches", "d_{}_deg"),
        *_TEST,
        Column("outlier", "flag", "", "differs clearly from its type"),
        *_CI95_OF_ANGLES,
        *floats(*_OF_ANGLES, *(f"shrunk_ci95_{name}" for name in _ANGLES)),
        Column(
            "drives_unordered",
            "integer",
            "",
            "part of `drives` that overlap an earlier drive in time, or have no time: moves "
            "before them are not tested",
        ),
    ),
    "analysis/segments": (
        *texts(vehicle="name"),
        Column("segment", "integer", "", "0 is the first"),
        Column("start", "time", "", "of its first drive"),
        Column("end", "time", "", "of its last drive"),
        *texts(first_log_key="its first drive", last_log_key="its last drive"),
        Column("drives", "integer", "", "of the segment"),
        *_MOUNT,
        *_CI95_OF_ANGLES,
        *texts(last_state="state at the end of its last drive"),
    ),
    "analysis/remounts": (
        *texts(
            vehicle="name",
            before_log_key="last drive before, or the drive in which the sensor was moved",
            after_log_key="first drive after, or the drive in which the sensor was moved",
        ),
        Column("before", "time", "", "end of the last drive before; within a drive, its start"),
        Column(
            "after",
            "time",
            "",
            "start of the first drive after; within a drive, when the move was found",
        ),
        *_xyz("deg", "turn about the vehicle's axes", "d_{}_deg"),
        *floats("deg", "its angle", "size_deg"),
        *_TEST,
        Column(
            "found", "flag", "", "true if q is at most 5 %, or if the move was found within a drive"
        ),
        *floats(
            "s",
            "move within a drive: time from the first frame of the log to the detection",
            "found_s",
        ),
    ),
    "analysis/groups": (
        *texts(column="column of drives", name="the batch"),
        Column("vehicles", "integer", "", "of the batch"),
        Column("types", "integer", "", "vehicles that have other batches too"),
        *_xyz("deg", "compared with other vehicles of its types", "d_{}_deg"),
        *_xyz("deg", "half of its 95 % interval; the crown cancels", "ci95_{}_deg"),
        *_TEST,
        *texts(verdict="bad, ok, or too few"),
    ),
    "analysis/outliers": (
        *texts(vehicle="name", vehicle_type="as in drives", sensor_batch="as in drives"),
        *_xyz("deg", "first segment compared with its type, without bad batches", "d_{}_deg"),
        *floats("deg", "its angle", "size_deg"),
        *_TEST,
    ),
    "analysis/causes": (
        *texts(vehicle_type="model of the vehicle", cause="fault, as in drives"),
        Column("vehicles_with", "integer", "", "vehicles that have it"),
        Column("vehicles", "integer", "", "of the type"),
        *floats("", "share of vehicles", "rate", "rate_shrunk", "rate_elsewhere"),
        *_TEST,
        *texts(verdict="design or single vehicles"),
    ),
    "analysis/never_usable": (
        *texts(
            vehicle_type="model of the vehicle", reason="reason why the first angle is not known"
        ),
        Column("drives", "integer", "", "that never became usable"),
        Column("vehicles", "integer", "", "that have such drives"),
        *floats("", "of the type's drives", "share"),
    ),
}
"""The columns of each table under `analysis/`. Every analysis writes all these tables again
completely."""
