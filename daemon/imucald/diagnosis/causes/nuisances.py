"""What is never quite as in any model file, and is not worth naming: it moves within tolerance."""

from __future__ import annotations

import numpy as np

from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

SLOWEST_MPS = 2.0
"""Below this a slip angle says nothing."""


class ControlUnitAcceleration(Cause):
    """Offset and scale of the vehicle's own acceleration signals."""

    name = "control_unit_acceleration"
    nuisance = True
    parameters = (
        Parameter("lateral_accel.offset", "m/s^2", 0.08, 0.08, 0.02),
        Parameter("lateral_accel.scale", "1", 0.015, 0.015, 0.005),
        Parameter("longitudinal_accel.offset", "m/s^2", 0.08, 0.08, 0.02),
        Parameter("longitudinal_accel.scale", "1", 0.015, 0.015, 0.005),
    )

    def gain(self, s: State, p: Values) -> None:
        """Scale, then shift."""
        for name in ("lateral_accel", "longitudinal_accel"):
            s.signals[name] = s.signals[name] * (1.0 + p[f"{name}.scale"]) + p[f"{name}.offset"]


class TyreLag(Cause):
    """Lag of the yaw rate behind the steering, its geometry, its fall with lateral acceleration."""

    name = "tyre_lag"
    nuisance = True
    parameters = (
        Parameter("_tyre.lag", "s", 0.02, 0.02, 0.01),
        Parameter("_tyre.tangent", "1", 1.0, 1.0, 0.2),
        Parameter("_tyre.saturation", "1/(m/s^2)^2", 0.004, 0.004, 0.002),
    )

    def motion(self, s: State, p: Values) -> None:
        """Lag, and lose with the square of the lateral acceleration."""
        yaw = s.yaw_from_steering
        if yaw is None:
            return
        loss = p["_tyre.saturation"] * (s.speed * yaw) ** 2
        s.yaw_from_steering = yaw * (1.0 - loss) - p["_tyre.lag"] * s.spectrum.derivative(yaw)


class WheelSlip(Cause):
    """Speed that reads less under braking and more under drive, and its filter's lag."""

    name = "wheel_slip"
    nuisance = True
    parameters = (Parameter("_slip.gain", "1/(m/s^2)", 0.003, 0.003, 0.002),)

    def motion(self, s: State, p: Values) -> None:
        """Change the acceleration by that of the slip speed."""
        if p["_slip.gain"]:
            s.ax = s.ax - s.spectrum.derivative(p["_slip.gain"] * s.speed * s.ax)


class Sideslip(Cause):
    """Compliance of the rear tyres, by which the vehicle slips outwards, and their relaxation.

    A load moves the centre of gravity, too: how far the rear axle is behind it.
    """

    name = "sideslip"
    nuisance = True
    parameters = (
        Parameter("_sideslip.compliance", "1", 0.4, 0.4, 0.1),
        Parameter("_sideslip.relaxation", "m", 0.5, 0.5, 0.1),
        Parameter("_sideslip.reference", "m", 0.15, 0.15, 0.05),
    )

    def motion(self, s: State, p: Values) -> None:
        """Change the lateral velocity, and with it the lateral acceleration."""
        c = s.model.chassis
        slip = c.mass_kg * c.cg_to_front_m / (c.wheelbase_m * c.rear_cornering_stiffness_npr)
        outwards = -slip * s.speed * s.speed * s.yaw_rate
        if p["_sideslip.compliance"]:
            s.ay = s.ay + s.spectrum.derivative(p["_sideslip.compliance"] * outwards)
        if p["_sideslip.reference"]:
            s.ay = s.ay + p["_sideslip.reference"] * s.spectrum.derivative(s.yaw_rate)
        if p["_sideslip.relaxation"]:
            # v_y = l_r r - v (alpha + (s / v) alpha') with the slip angle alpha = -outwards / v.
            angle = -outwards / np.maximum(np.abs(s.speed), SLOWEST_MPS)
            twice = s.spectrum.derivative(s.spectrum.derivative(angle))
            s.ay = s.ay - np.sign(s.speed) * p["_sideslip.relaxation"] * twice


class SuspensionModes(Cause):
    """Frequencies of the body's modes; used where the body leans."""

    name = "suspension_modes"
    nuisance = True
    parameters = (
        Parameter("_pitch_frequency", "1", 0.15, 0.15, 0.05),
        Parameter("_roll_frequency", "1", 0.15, 0.15, 0.05),
    )


class MeanRoad(Cause):
    """Mean slope and cross fall of this drive, and banked curves."""

    name = "mean_road"
    nuisance = True
    parameters = (
        Parameter("road.grade_mean", "1", 0.0015, 0.0015, 0.002),
        Parameter("road.crown_mean", "1", 0.0025, 0.0025, 0.002),
        Parameter("_road.banked_curves", "1", 0.03, 0.03, 0.02),
    )

    def road(self, s: State, p: Values) -> None:
        """Lean the road; crown falls towards the kerb."""
        road = s.model.road
        side = -1.0 if s.model.route.driving_side == "left" else 1.0
        if road.grade:
            s.road_pitch = s.road_pitch - np.sign(s.speed) * p["road.grade_mean"]
        if road.bank:
            s.road_roll = s.road_roll + side * p["road.crown_mean"]
            s.road_roll = s.road_roll - p["_road.banked_curves"] * s.ay / GRAVITY
