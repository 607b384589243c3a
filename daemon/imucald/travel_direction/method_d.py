"""Method D as published (CN103543289A), to the letter; angles in radians.

Terminal axes: x to the right, y to the upper edge, z out of the screen. The compass is the
clockwise angle from north of the y axis' horizontal projection. What the publication lacks is
*reconstructed* and marked so.

The text prints two pairs of formulas for terminals whose axes differ. [0070], [0079]:
(atan2(roll, pitch) + 180) % 360 is the clockwise angle from the y axis to the raised edge, and
angle + compass is clockwise from north. [0072], [0081]: (atan2(pitch, roll) + 180) % 360 is the
counter-clockwise angle from the x axis, and angle - compass is counter-clockwise from east. Both
fit an accelerometer that reads -g on the axis that points up, and both mean the same direction
(tests say so), so one pair is enough here. What a terminal's accelerometer reads upwards and which
way its compass counts is turned where samples come in: `travel_direction.convention`, `.compass`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.config.attitude import ChoiceSettings
from imucald.travel_direction.step_cycles import POINTS, StepCycle

Array = NDArray[np.float64]

TWO_PI = 2.0 * math.pi


def tilt(mean: Array) -> tuple[float, float]:
    """Pitch and roll of the publication (*reconstructed*) from a mean acceleration (3,)."""
    x, y, z = (float(c) for c in mean)
    return math.atan2(y, math.hypot(x, z)), math.atan2(x, math.hypot(y, z))


def tilt_angle(pitch: float, roll: float) -> float:
    """Clockwise angle from the y axis to the raised edge, by [0070] [0, 2 pi).

    pitch, roll: of an accelerometer that reads -g on the axis that points up.
    """
    return (math.atan2(roll, pitch) + math.pi) % TWO_PI


def tilt_heading(pitch: float, roll: float, compass: float) -> float:
    """Tilt heading (method D, step 3) by [0079], clockwise from north [0, 2 pi)."""
    return (tilt_angle(pitch, roll) + compass + TWO_PI) % TWO_PI


def levelling_angles(mean: Array) -> tuple[float, float]:
    """a and b of the projection, such that the mean (3,) lands on +z (*reconstructed*).

    [0093] calls them the angles of the y and the x axis; put in so, the projection does not level
    (28 deg off at a lean of 20). These do: (4) is zero for b, then (3) for a.
    """
    x, y, z = (float(c) for c in mean)
    return math.atan2(-x, math.hypot(y, z)), math.atan2(y, z)


def projected(vectors: Array, a: float, b: float) -> Array:
    """The publication's projection to the horizontal plane; (..., 3) -> (..., 3)."""
    X, Y, Z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    ca, sa, cb, sb = math.cos(a), math.sin(a), math.cos(b), math.sin(b)
    ax = X * ca + Y * sa * sb + Z * cb * sa
    ay = Y * cb - Z * sb
    az = -X * sa + Y * ca * sb + Z * cb * ca
    return np.stack([ax, ay, az], axis=-1)


def compass_of(field: Array, mean: Array) -> float:
    """Clockwise angle from magnetic north of the levelled y axis [0, 2 pi), from a field (3,)."""
    east, north, _ = projected(field, *levelling_angles(mean))
    return math.atan2(-float(east), float(north)) % TWO_PI


def correlation_angle(accel: Array) -> float | None:
    """Acceleration-correlation angle (method D, step 4), clockwise from the y axis [0, 2 pi).

    accel: (POINTS, 3) over one cycle, reading +g upwards. R_hz(tau) = sum h(t) z(t + tau), over the
    cycle as if it repeated; the difference R(+tau) - R(-tau) (*reconstructed*) is positive for the
    direction of travel: the body is braked after it is lowest, where z is largest. None where no
    lag shows anything.
    """
    waves = projected(accel, *levelling_angles(accel.mean(axis=0)))
    waves = waves - waves.mean(axis=0)
    spectra = np.fft.rfft(waves, axis=0)
    across = np.conj(spectra[:, :2]) * spectra[:, 2:]
    R = np.fft.irfft(across, n=POINTS, axis=0)  # R[k] is the lag of k parts, circular
    lags = np.arange(1, POINTS // 2)
    D = R[lags] - R[-lags]
    best = int(np.argmax(np.abs(D).sum(axis=1)))
    d_xz, d_yz = (float(c) for c in D[best])
    if d_xz == 0.0 and d_yz == 0.0:
        return None
    inside = math.atan2(abs(d_xz), abs(d_yz))
    if d_yz >= 0.0:
        return inside if d_xz >= 0.0 else (TWO_PI - inside) % TWO_PI
    return math.pi - inside if d_xz >= 0.0 else math.pi + inside


class PublishedResult(NamedTuple):
    """Headings of one cycle [rad, clockwise from north]; which of the two was chosen; a turn."""

    heading: float
    tilt_heading: float
    correlation_heading: float | None
    used_tilt: bool
    is_turn: bool
    pitch: float
    roll: float


class PublishedDirection:
    """Steps 2 to 5: cycle by cycle."""

    def __init__(self, choice: ChoiceSettings) -> None:
        self.choice = choice
        self.restart()

    def restart(self) -> None:
        """There is no last cycle."""
        self._compass: float | None = None
        self._contradicted = False

    def take(self, cycle: StepCycle, compass: float) -> PublishedResult:
        """Take a cycle (its acceleration reading +g upwards) and its compass [rad]."""
        c = self.choice
        mean = cycle.accel.mean(axis=0)
        pitch, roll = tilt(-mean)
        by_tilt = tilt_heading(pitch, roll, compass)
        angle = correlation_angle(cycle.accel)
        by_waves = None if angle is None else (angle + compass) % TWO_PI
        is_turn = self._compass is not None and difference(compass, self._compass) > c.turn
        contradicts = by_waves is not None and difference(by_waves, by_tilt) >= c.differ
        steepest = max(abs(pitch), abs(roll))
        if is_turn:
            use_tilt = steepest >= c.tilt_on_turn
        elif contradicts and self._contradicted:
            use_tilt = False
        else:
            use_tilt = steepest >= c.tilt
        self._compass, self._contradicted = compass, contradicts
        heading = by_tilt if use_tilt or by_waves is None else by_waves
        return PublishedResult(heading, by_tilt, by_waves, use_tilt, is_turn, pitch, roll)


def difference(a: float, b: float) -> float:
    """Size of the difference of two angles, at most pi [rad]."""
    return abs(math.remainder(a - b, TWO_PI))
