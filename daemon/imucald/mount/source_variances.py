"""What is not in the spread of the data: sources of angles whose variances are to be larger."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from imucald.mount.evidence_rows import SAME_NOISE
from imucald.mount.road_segments import AngleEvidence

NO_GYRO_SHARE = 1.5
"""Without a gyroscope slopes stay in the force: variances are so much larger."""
PRINCIPAL_STD = 0.008
"""What the principal axis may be off [rad]: the force across the vehicle is not only noise."""
SILENT = 1e4
"""A source whose variance is so many times larger says nothing."""


def widened(
    sources: Mapping[str, AngleEvidence], own_gyro: bool, without_speed: bool
) -> dict[str, AngleEvidence]:
    """Return the responses' sources with the variances they deserve.

    own_gyro: the sensor has a gyroscope. without_speed: nobody knows the vehicle's speed.
    """
    found = dict(sources)
    if found.keys() >= set(SAME_NOISE):
        worse = max(SAME_NOISE, key=lambda name: found[name].variance)
        one = found[worse]
        found[worse] = AngleEvidence(one.value, one.variance * SILENT, 0.0)
    if not own_gyro:
        for name in {"yaw_dvdt", "yaw_turn", "pitch_dvdt", "roll_turn"} & found.keys():
            found[name] = replace(found[name], variance=NO_GYRO_SHARE * found[name].variance)
    if without_speed and "yaw_dvdt" in found:
        one = found["yaw_dvdt"]
        found["yaw_dvdt"] = replace(one, variance=one.variance + PRINCIPAL_STD**2)
    return found
