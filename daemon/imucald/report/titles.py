"""Readable titles of causes, signals and parameters."""

from __future__ import annotations

from collections.abc import Mapping

from imucald.core import samples

CAUSES: Mapping[str, str] = {
    "accel_bias": "accelerometer bias",
    "accel_scale": "accelerometer scale",
    "accel_cross_axis": "accelerometer cross-axis",
    "accel_bias_temperature": "accelerometer drift with temperature",
    "accel_bias_drift": "accelerometer drift",
    "gyro_bias": "gyroscope bias",
    "gyro_scale": "gyroscope scale",
    "gyro_bias_temperature": "gyroscope drift with temperature",
    "g_sensitivity": "gyroscope g-sensitivity",
    "squat_dive": "squat and dive",
    "wheel_speed_scale": "speed scale (tyre radius)",
    "wheels_against_speed": "wheel speeds against vehicle speed",
    "yaw_rate_scale": "yaw-rate scale",
    "yaw_rate_offset": "yaw-rate offset",
    "steering_offset": "steering-angle offset",
    "delay_rate": "clocks with different rates",
    "dropouts": "drop-outs",
    "duplicated_frames": "doubled frames",
}
"""Titles of causes that differ from the name of the cause with blanks instead of underscores. A new
cause needs no entry."""

PARTS: Mapping[str, str] = {row.channel: row.title for row in samples.QUANTITIES.values()}
SIGNALS: Mapping[str, str] = {**PARTS, samples.SPEED.channel: "speed against the wheels"}
AXES: Mapping[str, Mapping[str, str]] = {
    "vector": {"x": "forward", "y": "left", "z": "up"},
    "sensor": {"0": "sensor x", "1": "sensor y", "2": "sensor z"},
    "turn": {"x": "roll", "y": "pitch", "z": "yaw"},
    "lever_arm_m": {"0": "forward", "1": "left", "2": "up"},
    "cross_axis": {"0": "y in x", "1": "z in x", "2": "x in y", "3": "z in y", "4": "x in z",
                   "5": "y in z"},
}  # fmt: skip
QUANTITIES: Mapping[str, str] = {
    "lever_arm_m": "lever arm", "delay_s": "delay", "delay_rate": "growth of delay",
    "scale": "gain error", "offset": "offset", "turn": "turn", "bias": "zero error",
    "full_scale": "range", "loss": "lost frames", "stuck_s": "stuck for", "doubled": "doubled",
    "clock_drift_ppm": "clock error", "steering_ratio": "steering ratio", "t_s": "time",
    "shifts": "shift", "lowpass_hz": "cut-off", "clipped": "clipped",
}  # fmt: skip


def cause_title(name: str) -> str:
    """Return the title of a cause."""
    return CAUSES.get(name, name.replace("_", " "))


def signal_title(name: str) -> str:
    """Return the title of a signal, such as `accelerometer x` for `accel_x`."""
    if name in SIGNALS:
        return SIGNALS[name]
    sensor, _, axis = name.rpartition("_")
    way = AXES["vector"].get(axis, axis)
    return f"{SIGNALS[sensor]} {way}" if sensor in SIGNALS else name.replace("_", " ")


def key_title(key: str) -> str:
    """Return the title of a parameter, such as `lever arm, forward` for `mount.lever_arm_m.0`."""
    part, _, rest = key.removeprefix("_").partition(".")
    if key == "mount.shifts.t_s":
        return "time of the shift"
    name, _, axis = rest.rpartition(".")
    name = name or rest
    quantity = QUANTITIES.get(name.rpartition(".")[2], name.rpartition(".")[2].replace("_", " "))
    if not rest.endswith(f".{axis}") or axis == rest:
        axis = ""
    kind = name if name in AXES else "sensor" if axis.isdigit() else "vector"
    way = AXES[kind].get(axis, axis.removesuffix("_deg").replace("_", " "))
    title = (
        quantity
        if part in ("mount", "chassis", "suspension")
        else (f"{PARTS.get(part, part.replace('_', ' '))} {quantity}")
    )
    return f"{title}, {way}" if way else title
