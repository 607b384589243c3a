"""Errors that the spread of the data does not show: sources of angles whose variances are
increased.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from imucald.mount.evidence_rows import SAME_NOISE
from imucald.mount.road_segments import AngleEvidence

NO_GYRO_SHARE = 1.5
"""Factor on the variances without a gyroscope, because slopes stay in the force."""
PRINCIPAL_STD = 0.008
"""Error of the principal axis [rad]: the force across the vehicle is not only noise."""
SILENT = 1e4
"""A source whose variance is this many times larger has no weight."""


def widened(
    sources: Mapping[str, AngleEvidence], own_gyro: bool, without_speed: bool
) -> dict[str, AngleEvidence]:
    """Return the sources of the responses with corrected variances.

    own_gyro: the sensor has a gyroscope. without_speed: the vehicle's speed is unknown.
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
