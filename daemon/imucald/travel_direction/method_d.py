"""Method D exactly as published (CN103543289A); angles in radians.

Terminal axes: x to the right, y to the upper edge, z out of the screen. The compass is the
clockwise angle from north to the horizontal projection of the y axis ([0003]). The tilt angle
begins at this projection. Formulas (3) to (5) project to the level frame. The correlation angle
begins at the y axis of *the level frame* ([0127], [0139]). Parts that the publication lacks are
marked as *reconstructed*.

The publication has two pairs of formulas for terminals with different axes. [0070], [0079]:
(atan2(roll, pitch) + 180) % 360 is the clockwise angle from the y axis to the raised edge, and
angle + compass is clockwise from north. [0072], [0081]: (atan2(pitch, roll) + 180) % 360 is the
counter-clockwise angle from the x axis, and angle - compass is counter-clockwise from east. Both
pairs fit an accelerometer whose output is -g on the axis that points up. Tests show that both pairs
give the same direction, so this module uses one pair. Samples of terminals with another sign or
another counting direction are converted on input: `travel_direction.convention`, `.compass`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imucald.config.attitude import ChoiceSettings
from imucald.core.arrays import Array
from imucald.travel_direction.certainty import MIN_HORIZONTAL
from imucald.travel_direction.step_cycles import POINTS, StepCycle


def tilt(mean: Array) -> tuple[float, float]:
    """Return pitch and roll of the publication (*reconstructed*) from a mean acceleration (3,)."""
    x, y, z = (float(c) for c in mean)
    return math.atan2(y, math.hypot(x, z)), math.atan2(x, math.hypot(y, z))


def tilt_angle(pitch: float, roll: float) -> float:
    """Return the clockwise angle from the y axis to the raised edge, by [0070] [0, 2 pi).

    pitch, roll: from an accelerometer whose output is -g on the axis that points up.
    """
    return (math.atan2(roll, pitch) + math.pi) % math.tau


def tilt_heading(pitch: float, roll: float, compass: float) -> float:
    """Return the tilt heading (method D, step 3) by [0079], clockwise from north [0, 2 pi)."""
    return (tilt_angle(pitch, roll) + compass + math.tau) % math.tau


def levelling_angles(mean: Array) -> tuple[float, float]:
    """Return a and b of the projection that rotates the mean (3,) to +z (*reconstructed*).

    [0093] of the publication uses the angles of the y axis and the x axis instead. With the angles
    of the publication, the projection does not level: the error is 28 deg at a lean of 20 deg. With
    the angles of this function, the projection levels: b makes (4) zero, then a makes (3) zero.
    """
    x, y, z = (float(c) for c in mean)
    return math.atan2(-x, math.hypot(y, z)), math.atan2(y, z)


def projected(vectors: Array, a: float, b: float) -> Array:
    """Return the publication's projection of vectors (..., 3) to the horizontal plane."""
    X, Y, Z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    ca, sa, cb, sb = math.cos(a), math.sin(a), math.cos(b), math.sin(b)
    ax = X * ca + Y * sa * sb + Z * cb * sa
    ay = Y * cb - Z * sb
    az = -X * sa + Y * ca * sb + Z * cb * ca
    return np.stack([ax, ay, az], axis=-1)


def y_angle(mean: Array) -> float | None:
    """Return the clockwise angle from the level frame's y axis to the projection of the terminal's
    y axis.

    mean: acceleration (3,). Returns None if the terminal's y axis is (nearly) vertical.
    """
    x, y, _ = projected(np.array([0.0, 1.0, 0.0]), *levelling_angles(mean))
    return math.atan2(float(x), float(y)) if math.hypot(x, y) >= MIN_HORIZONTAL else None


def level_heading(field: Array, mean: Array) -> float | None:
    """Return the clockwise angle from magnetic north to the level frame's y axis [0, 2 pi).

    field: magnetic field (3,). mean: acceleration (3,). Returns None if the field is vertical.
    """
    x, y, _ = projected(field, *levelling_angles(mean))
    return math.atan2(-float(x), float(y)) % math.tau if x != 0.0 or y != 0.0 else None


def correlation_angle(accel: Array) -> float | None:
    """Return the acceleration-correlation angle (method D, step 4), clockwise from the level
    frame's y axis.

    The range is [0, 2 pi). accel: (POINTS, 3) over one cycle, +g for an axis that points up.
    R_hz(tau) = sum h(t) z(t + tau) is the circular correlation over the cycle. The difference
    R(+tau) - R(-tau) (*reconstructed*) is positive for the direction of travel: the body is braked
    after its lowest point, where z is largest. Returns None if no lag shows a direction.
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
        return inside if d_xz >= 0.0 else (math.tau - inside) % math.tau
    return math.pi - inside if d_xz >= 0.0 else math.pi + inside


class PublishedResult(NamedTuple):
    """Headings of one cycle [rad, clockwise from north], which heading was chosen, and whether the
    cycle was a turn.

    compass and tilt_heading are None if the terminal's y axis is vertical.
    """

    heading: float | None
    compass: float | None
    tilt_heading: float | None
    correlation_heading: float | None
    used_tilt: bool
    is_turn: bool
    pitch: float
    roll: float


class PublishedDirection:
    """Steps 2 to 5 of method D, cycle by cycle."""

    def __init__(self, choice: ChoiceSettings) -> None:
        self.choice = choice
        self.restart()

    def restart(self) -> None:
        """Forget the last cycle."""
        self._compass: float | None = None
        self._contradicted = False

    def take_cycle(self, cycle: StepCycle, level: float) -> PublishedResult:
        """Process a cycle and return its headings. The acceleration of the cycle is +g for an axis
        that points up.

        level: clockwise angle from north to the y axis of the level frame [rad].
        """
        c = self.choice
        mean = cycle.accel.mean(axis=0)
        pitch, roll = tilt(-mean)
        to_y = y_angle(mean)
        compass = None if to_y is None else (level + to_y) % math.tau
        by_tilt = None if compass is None else tilt_heading(pitch, roll, compass)
        angle = correlation_angle(cycle.accel)
        by_waves = None if angle is None else (angle + level) % math.tau
        is_turn = apart(compass, self._compass) > c.turn
        has_both = by_tilt is not None and by_waves is not None
        contradicts = has_both and apart(by_waves, by_tilt) >= c.differ
        steepest = max(abs(pitch), abs(roll))
        if is_turn:
            use_tilt = steepest >= c.tilt_on_turn
        elif contradicts and self._contradicted:
            use_tilt = False
        else:
            use_tilt = steepest >= c.tilt
        self._compass, self._contradicted = compass, contradicts
        use_tilt = use_tilt and by_tilt is not None
        heading = by_tilt if use_tilt or by_waves is None else by_waves
        return PublishedResult(heading, compass, by_tilt, by_waves, use_tilt, is_turn, pitch, roll)


def apart(a: float | None, b: float | None) -> float:
    """Return the absolute difference of two angles [rad]; zero if one angle is not known."""
    return 0.0 if a is None or b is None else difference(a, b)


def difference(a: float, b: float) -> float:
    """Return the absolute difference of two angles, at most pi [rad]."""
    return abs(math.remainder(a - b, math.tau))
