"""Compare the orientation that a person states roughly with the rotation that was found.

The mirror image of a drive (all signs of the accelerometer inverted) reverses up and forward. A
drive in reverse without a reverse signal reverses forward and left. With a mirror image or a drive
in reverse, the rotation is wrong by 180 deg. A rough statement of the axis that points up, or
forward, is therefore enough to rule out a wrong rotation.

An axis within 60 deg of the stated direction confirms the rotation. An axis beyond 120 deg
contradicts the rotation.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imucald.config.calibration import OrientationSettings, SensorAxis
from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3

CLEAR = 0.5
"""Smallest cosine of the angle between an axis and the stated direction at which the axis confirms
the rotation (60 deg).

With a cosine below -CLEAR, the axis contradicts the rotation. With values in between, the axis is
closer to level (or across) than to up or down.
"""
FORWARD, UP = 0, 2
Stated = Literal["up", "forward"]


class StatedOrientation:
    """The sensor's axes that point up and forward, if a person has stated them."""

    def __init__(self, stated: OrientationSettings) -> None:
        given = {UP: stated.up, FORWARD: stated.forward}
        self._axes = {row: unit_vector(axis) for row, axis in given.items() if axis is not None}
        self._mount: Matrix3 | None = None

    def take_mount(self, R: Matrix3) -> None:
        """Use the whole mount that a person states.

        If the mount that is found is another one, the statement confirms nothing.
        """
        self._mount = R

    def contradicted(self, R: Matrix3, yaw_known: bool) -> Stated | None:
        """Return the key, "up" or "forward", whose axis points in the opposite direction in
        R_vehicle_from_sensor. If both axes point in the opposite direction, the result is "up".
        """
        rows: tuple[tuple[int, Stated], ...] = ((UP, "up"), (FORWARD, "forward"))
        for row, key in rows if yaw_known else rows[:1]:
            if row in self._axes and float(R[row] @ self._axes[row]) < -CLEAR:
                return key
        return None

    def confirms_up(self, R: Matrix3) -> bool:
        """True if the direction up in R agrees with a person's statement."""
        return self._confirms(R, UP)

    def confirms_forward(self, R: Matrix3) -> bool:
        """True if the direction forward in R agrees with a person's statement."""
        return self._confirms(R, FORWARD)

    def _confirms(self, R: Matrix3, row: int) -> bool:
        axes = [self._axes[row]] if row in self._axes else []
        axes += [] if self._mount is None else [self._mount[row]]
        return any(float(R[row] @ axis) > CLEAR for axis in axes)


def unit_vector(axis: SensorAxis) -> Array:
    """Return the vector (3,) of an axis such as "x" or "-z" in sensor axes."""
    out = np.zeros(3)
    out["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return out
