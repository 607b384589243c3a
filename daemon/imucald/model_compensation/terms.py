"""The terms of a model file that can be removed from signals while driving.

Every term is the inverse of the same term in the simulation. The simulation converts the true value
into the sensor's reading, and this package converts the reading into the true value. Values are in
SI units and ISO 8855 axes. Neutral values have no effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from imucald.model.section import ZERO, Vector3
from imucald.model.vehicle import Suspension

Matrix9 = tuple[float, float, float, float, float, float, float, float, float]
"""Matrix (3, 3), row by row."""

IDENTITY: Matrix9 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
NO_RAIL = (math.inf, math.inf)
_SPRINGS = Suspension()


@dataclass(frozen=True)
class TriadTerms:
    """Three axes: measured = gain @ true + bias + bias_temperature * (T - 25 degC).

    inverse: inverse of the gain. rail: limits of the absolute value between which a raw value was
    clipped.
    """

    inverse: Matrix9 = IDENTITY
    bias: Vector3 = ZERO
    bias_temperature: Vector3 = ZERO
    rail: tuple[float, float] = NO_RAIL

    @property
    def neutral(self) -> bool:
        """True if the terms have no effect."""
        return self == TriadTerms()


@dataclass(frozen=True)
class ScalarTerms:
    """Signal with one component: measured = (1 + scale) * true + offset. rail: as in
    `TriadTerms`."""

    scale: float = 0.0
    offset: float = 0.0
    rail: tuple[float, float] = NO_RAIL


@dataclass(frozen=True)
class SuspensionTerms:
    """Lean of the body on its springs: angle per specific force [rad/(m/s^2)], frequency and
    damping.

    Each axis is a second-order system. squat: nose up per forward force. dive: nose down per
    braking force. roll: roll out of the turn per lateral force.
    """

    squat: float = 0.0
    dive: float = 0.0
    pitch_hz: float = _SPRINGS.pitch_frequency_hz
    pitch_damping: float = _SPRINGS.pitch_damping
    roll: float = 0.0
    roll_hz: float = _SPRINGS.roll_frequency_hz
    roll_damping: float = _SPRINGS.roll_damping

    @property
    def neutral(self) -> bool:
        """True if the body does not lean."""
        return self.squat == 0.0 and self.dive == 0.0 and self.roll == 0.0


@dataclass(frozen=True)
class ChassisTerms:
    """Dimensions of the vehicle and its understeer; None if the model file does not state them."""

    wheelbase: float | None = None
    track: float | None = None
    steering_ratio: float | None = None
    understeer: float | None = None


@dataclass(frozen=True)
class Terms:
    """All used terms of a model file.

    g_sensitivity: rate error per specific force on the same sensor axis [(rad/s)/(m/s^2)].
    wheel_scales: scale errors of the four wheel speeds. scalars: terms of signals with one
    component, by channel. lever_arm: vector from the body's centre of rotation to the sensor,
    vehicle axes [m]. latency: by channel, the age of a value when its frame is received [s],
    including filters. crown_mean: cross fall towards the kerb (tangent); None: not stated.
    bank_rms, grade_rms: rms of the road's cross fall and grade (tangents); 0: not stated.
    """

    accel: TriadTerms = TriadTerms()
    gyro: TriadTerms = TriadTerms()
    g_sensitivity: Vector3 = ZERO
    mag: TriadTerms = TriadTerms()
    wheel_scales: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    scalars: Mapping[str, ScalarTerms] = field(default_factory=dict)
    lever_arm: Vector3 = ZERO
    suspension: SuspensionTerms = SuspensionTerms()
    latency: Mapping[str, float] = field(default_factory=dict)
    chassis: ChassisTerms = ChassisTerms()
    crown_mean: float | None = None
    bank_rms: float = 0.0
    grade_rms: float = 0.0


def inverse_gain(scale: Vector3, cross_axis: tuple[float, ...]) -> Matrix9 | None:
    """Return the inverse of the matrix with 1 + scale on the diagonal and xy xz yx yz zx zy off the
    diagonal; None if it is nearly singular."""
    xy, xz, yx, yz, zx, zy = cross_axis
    a, e, i = (1.0 + s for s in scale)
    minors = (e * i - yz * zy, yz * zx - yx * i, yx * zy - e * zx)
    determinant = a * minors[0] + xy * minors[1] + xz * minors[2]
    if not abs(determinant) > MIN_GAIN or min(a, e, i) <= MIN_GAIN:
        return None
    cofactors = (
        minors[0], xz * zy - xy * i, xy * yz - xz * e,
        minors[1], a * i - xz * zx, xz * yx - a * yz,
        minors[2], xy * zx - a * zy, a * e - xy * yx,
    )  # fmt: skip
    m = [c / determinant + 0.0 for c in cofactors]
    return m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]


MIN_GAIN = 0.2
"""Smallest gain of a sensor that is corrected: a fifth of the true value."""


def saved_text(terms: Terms) -> str:
    """Return the text of terms that identifies a saved calibration. The words of this text never
    change.

    Older names in this text: `LeanTerms` and `lean` for the suspension, `lateness` for the latency.
    """
    text = repr(terms)
    for now, then in (
        ("SuspensionTerms(", "LeanTerms("),
        ("suspension=", "lean="),
        ("latency=", "lateness="),
    ):
        text = text.replace(now, then)
    return text
