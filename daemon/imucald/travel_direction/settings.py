"""Settings of method D; the defaults are those of the configuration. SI units, radians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

_DEG = math.pi / 180.0

AxisConvention = Literal["gravity", "force"]
"""What the terminal's accelerometer at rest reads on the axis that points up: -g or +g."""
CompassSense = Literal["clockwise", "counter_clockwise"]
"""Which way the terminal's heading signal counts, seen from above."""


@dataclass(frozen=True)
class StepSettings:
    """Step cycles from vertical acceleration."""

    shortest: float = 0.28
    """Shortest step cycle [s]: a run."""
    longest: float = 1.2
    """Longest [s]: slower is not walking."""
    threshold: float = 0.35
    """The vertical acceleration must swing so far either side of its mean [m/s^2]."""
    corner_hz: float = 3.0
    """Low-pass of the vertical acceleration [Hz]: a brisk step passes, a heel's shock does not."""
    gravity_time: float = 1.5
    """Time constant of the vertical [s]: longer than a stride."""


@dataclass(frozen=True)
class ChoiceSettings:
    """The presets of the text's choice between its two headings."""

    turn: float = 60.0 * _DEG
    """The compass differs from the last cycle's by more: a turn [rad]."""
    tilt_on_turn: float = 5.0 * _DEG
    """On a turn: tilt heading from this pitch or roll on [rad]."""
    differ: float = 30.0 * _DEG
    """The methods contradict each other from this difference on, in two cycles in a row [rad]."""
    tilt: float = 5.0 * _DEG
    """No turn, no contradiction: tilt heading from this pitch or roll on [rad]."""


@dataclass(frozen=True)
class ModernSettings:
    """The alternative: attitude by gyroscope, axis by power, sign by phase."""

    gravity_time: float = 3.0
    """Time constant with which the accelerometer levels the attitude [s]."""
    compass_time: float = 20.0
    """Time constant with which a compass signal turns it [s]; a magnetometer has its own filter."""
    lead: float = 120.0 * _DEG
    """By how much forward leads the vertical acceleration at the step's frequency [rad]: a quarter
    period in the trunk, more in a hand. Only the sign depends on it."""
    memory_steps: float = 20.0
    """Steps after which the direction within the terminal is forgotten to 1/e."""
    carry_change: float = 35.0 * _DEG
    """The vertical moved so far in the terminal: it is carried otherwise, begin anew [rad]."""


@dataclass(frozen=True)
class TravelSettings:
    """All of it."""

    method: Literal["alternative", "published"] = "alternative"
    """Which one is sent; both are computed where their sensors are there."""
    convention: AxisConvention = "force"
    compass: CompassSense = "clockwise"
    declination: float = 0.0
    """Magnetic declination, east positive [rad]."""
    step: StepSettings = StepSettings()
    choice: ChoiceSettings = ChoiceSettings()
    modern: ModernSettings = ModernSettings()
