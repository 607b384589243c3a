"""Compare a person's rough statement of how the sensor sits with the rotation that was found.

The mirror image of a drive (all signs of the accelerometer turned) reverses up and forward. A drive
that goes backwards reverses forward and left. Both are 180 deg from the truth. A rough statement of
which axis points up, or forward, is therefore enough to rule them out.

An axis within 60 deg of the stated direction confirms the rotation; one beyond 120 deg contradicts
it.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imucald.config.calibration import OrientationSettings, SensorAxis
from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3

CLEAR = 0.5
"""Part of an axis along the stated direction from which it confirms, within 60 deg.

With the other sign it contradicts. In between, the axis is nearer to level (or across) than up or
down.
"""
FORWARD, UP = 0, 2
Stated = Literal["up", "forward"]


class StatedOrientation:
    """The sensor's axes that point up and forward, as far as a person has stated them."""

    def __init__(self, stated: OrientationSettings) -> None:
        given = {UP: stated.up, FORWARD: stated.forward}
        self._axes = {row: unit_vector(axis) for row, axis in given.items() if axis is not None}
        self._mount: Matrix3 | None = None

    def take_mount(self, R: Matrix3) -> None:
        """Take the whole mount that a person states.

        If it is not the one found, it confirms nothing.
        """
        self._mount = R

    def contradicted(self, R: Matrix3, yaw_known: bool) -> Stated | None:
        """Return the key whose axis points the other way in R_vehicle_from_sensor; up before
        forward.
        """
        rows: tuple[tuple[int, Stated], ...] = ((UP, "up"), (FORWARD, "forward"))
        for row, key in rows if yaw_known else rows[:1]:
            if row in self._axes and float(R[row] @ self._axes[row]) < -CLEAR:
                return key
        return None

    def confirms_up(self, R: Matrix3) -> bool:
        """True if a person stated the same direction up."""
        return self._confirms(R, UP)

    def confirms_forward(self, R: Matrix3) -> bool:
        """True if a person stated the same direction forward."""
        return self._confirms(R, FORWARD)

    def _confirms(self, R: Matrix3, row: int) -> bool:
        axes = [self._axes[row]] if row in self._axes else []
        axes += [] if self._mount is None else [self._mount[row]]
        return any(float(R[row] @ axis) > CLEAR for axis in axes)


def unit_vector(axis: SensorAxis) -> Array:
    """Return the vector (3,) of "x", "-z" and so on in sensor axes."""
    out = np.zeros(3)
    out["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return out
