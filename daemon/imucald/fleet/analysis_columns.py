"""Columns of the tables written by `fleet analyse`."""

from __future__ import annotations

from typing import Final

from imucald.fleet.columns import ANGLE_NAMES, MOUNT, QUATERNION, Column, floats, texts


def _xyz(unit: str, meaning: str, form: str) -> tuple[Column, ...]:
    """Return three columns, one for each axis of the vehicle. form: name of the columns with {} for
    the axis."""
    return floats(unit, meaning, *(form.format(axis) for axis in "xyz"))


_MOUNT = (
    *MOUNT,
    *_xyz("deg", "half of the 95 % interval about the axis, crown included", "ci95_{}_deg"),
)
_OF_ANGLES = (
    "deg",
    "half of the 95 % interval of the angle, crown included; null where the angle is not known",
)
_CI95_OF_ANGLES = floats(*_OF_ANGLES, *(f"ci95_{name}" for name in ANGLE_NAMES))
_TEST = (
    *floats("", "probability that chance alone gives such a difference", "p"),
    *floats("", "share of false findings among all findings with this q or a smaller one", "q"),
)

ANALYSIS: Final[dict[str, tuple[Column, ...]]] = {
    "analysis/types": (
        *texts(vehicle_type="model of the vehicle"),
        Column("vehicles", "integer", "", "vehicles with a known mount"),
        Column("drives", "integer", "", "drives with a known mount"),
        *_MOUNT,
        *_xyz("deg", "standard deviation of the mount from vehicle to vehicle (T)", "tau_{}_deg"),
        *_xyz("deg", "lower end of the 95 % interval of this deviation", "tau_low_{}_deg"),
        *_xyz("deg", "upper end of the 95 % interval of this deviation", "tau_high_{}_deg"),
        *_xyz("deg", "standard deviation of the mount from drive to drive (D)", "drive_{}_deg"),
        *_xyz("deg", "lower end of the 95 % interval of this deviation", "drive_low_{}_deg"),
        *_xyz("deg", "upper end of the 95 % interval of this deviation", "drive_high_{}_deg"),
        *floats(
            "deg",
            "standard deviation of roll due to the road crown, common to all vehicles",
            "crown_std_deg",
        ),
        *_CI95_OF_ANGLES,
    ),
    "analysis/vehicles": (
        *texts(
            vehicle="name of the vehicle",
            vehicle_type="as in drives",
            sensor_serial="as in drives",
            sensor_batch="as in drives",
            firmware="as in drives",
        ),
        Column("drives", "integer", "", "drives with a known mount"),
        Column("drives_unknown", "integer", "", "drives whose mount is not known"),
        Column("segments", "integer", "", "series of drives between remounts"),
        *_MOUNT,
        *floats(
            "",
            "mount, shrunk towards the mount of the type",
            *(f"shrunk_{name}" for name in QUATERNION),
        ),
        *floats(
            "deg",
            "mount, shrunk towards the mount of the type",
            *(f"shrunk_{name}" for name in ANGLE_NAMES),
        ),
        *_xyz(
            "deg", "half of the 95 % interval about the axis, crown included", "shrunk_ci95_{}_deg"
        ),
        *_xyz("", "weight of the vehicle's own data; 1: not shrunk", "weight_{}"),
        *_xyz(
            "deg",
            "mount of the vehicle's first segment relative to its type, bad batches excluded",
            "d_{}_deg",
        ),
        *_TEST,
        Column("outlier", "flag", "", "true if the vehicle differs clearly from its type"),
        *_CI95_OF_ANGLES,
        *floats(*_OF_ANGLES, *(f"shrunk_ci95_{name}" for name in ANGLE_NAMES)),
        Column(
            "drives_unordered",
            "integer",
            "",
            "drives that overlap an earlier drive in time, or have no time: moves before these "
            "drives are not tested",
        ),
    ),
    "analysis/segments": (
        *texts(vehicle="name of the vehicle"),
        Column("segment", "integer", "", "number of the segment; the first is 0"),
        Column("start", "time", "", "start of the first drive of the segment"),
        Column("end", "time", "", "end of the last drive of the segment"),
        *texts(
            first_log_key="first drive of the segment", last_log_key="last drive of the segment"
        ),
        Column("drives", "integer", "", "drives of the segment"),
        *_MOUNT,
        *_CI95_OF_ANGLES,
        *texts(last_state="state at the end of the last drive"),
    ),
    "analysis/remounts": (
        *texts(
            vehicle="name of the vehicle",
            before_log_key="last drive before the move, or the drive in which the sensor was moved",
            after_log_key="first drive after the move, or the drive in which the sensor was moved",
        ),
        Column(
            "before",
            "time",
            "",
            "end of the last drive before the move; start of the drive if the move was within it",
        ),
        Column(
            "after",
            "time",
            "",
            "start of the first drive after the move; time of detection if the move was within a "
            "drive",
        ),
        *_xyz("deg", "turn about the vehicle's axes", "d_{}_deg"),
        *floats("deg", "angle of this turn", "size_deg"),
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
        *texts(
            column="column of drives that defines the groups",
            name="value in this column: the batch",
        ),
        Column("vehicles", "integer", "", "vehicles of the batch"),
        Column("types", "integer", "", "vehicle types with this and other batches"),
        *_xyz("deg", "mount of the batch relative to other vehicles of the same types", "d_{}_deg"),
        *_xyz(
            "deg", "half of the 95 % interval of this difference; the crown cancels", "ci95_{}_deg"
        ),
        *_TEST,
        *texts(verdict="bad, ok, or too few"),
    ),
    "analysis/outliers": (
        *texts(
            vehicle="name of the vehicle", vehicle_type="as in drives", sensor_batch="as in drives"
        ),
        *_xyz(
            "deg",
            "mount of the vehicle's first segment relative to its type, bad batches excluded",
            "d_{}_deg",
        ),
        *floats("deg", "angle of this turn", "size_deg"),
        *_TEST,
    ),
    "analysis/causes": (
        *texts(vehicle_type="model of the vehicle", cause="fault, as in drives"),
        Column("vehicles_with", "integer", "", "vehicles of the type with this fault"),
        Column("vehicles", "integer", "", "all vehicles of the type"),
        *floats("", "share of vehicles with this fault", "rate", "rate_shrunk", "rate_elsewhere"),
        *_TEST,
        *texts(verdict="design or single vehicles"),
    ),
    "analysis/never_usable": (
        *texts(
            vehicle_type="model of the vehicle", reason="reason why the first angle is not known"
        ),
        Column("drives", "integer", "", "drives that never became usable for this reason"),
        Column("vehicles", "integer", "", "vehicles with such drives"),
        *floats("", "share of these drives in all drives of the type", "share"),
    ),
}
"""The columns of each table under `analysis/`. Every analysis writes all these tables again
completely."""
