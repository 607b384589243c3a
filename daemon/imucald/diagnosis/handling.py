"""Linear single-track vehicle: sideslip and yaw response from a chassis' parameters.

With a11 = (C_f + C_r) / (m v), a22 = (l_f^2 C_f + l_r^2 C_r) / (I v),
a12 = v + (l_f C_f - l_r C_r) / (m v), a21 = (l_f C_f - l_r C_r) / (I v), the yaw rate answers the
road-wheel angle as (l_f C_f / I s + l_f C_f / I a11 - a21 C_f / m) /
(s^2 + (a11 + a22) s + a11 a22 - a12 a21) (Rajamani, Vehicle Dynamics and Control, ch. 2).
"""

from __future__ import annotations

import msgspec
import numpy as np

from imucald.diagnosis.grid import Array
from imucald.diagnosis.state import Response, Spectrum
from imucald.model.vehicle import Chassis

NODES_MPS = (4.0, 10.0, 18.0, 30.0)
"""Speeds at which the response is computed."""

TURNING_IN_HZ = 1.5
"""Drivers turn in more slowly; above this the yaw rate's noise would be differentiated twice."""


class Handling:
    """Sideslip and yaw response of one chassis."""

    def __init__(self, chassis: Chassis) -> None:
        self._c = chassis

    def lateral_velocity(self, speed: Array, yaw_rate: Array) -> Array:
        """Lateral velocity of the centre of gravity in a steady turn [m/s], (N,)."""
        c = self._c
        slip = c.mass_kg * c.cg_to_front_m / (c.wheelbase_m * c.rear_cornering_stiffness_npr)
        sideways: Array = yaw_rate * (c.cg_to_rear_m - slip * speed * speed)
        return sideways

    def turning_in(
        self, speed: Array, sideways: Array, yaw_rate: Array, spectrum: Spectrum
    ) -> Array:
        """Return what the lateral velocity is more than in a steady turn [m/s], (N,).

        The rear axle carries (l_f m a_y - I r') / L: while the vehicle turns in, the yaw inertia
        takes part of its force, and so of its slip.
        """
        c = self._c
        rate = spectrum.s * spectrum.smooth(TURNING_IN_HZ)
        force = c.yaw_inertia_kgm2 * spectrum.apply(yaw_rate, rate)
        force = force - c.mass_kg * c.cg_to_front_m * spectrum.apply(sideways, rate)
        more: Array = speed / (c.wheelbase_m * c.rear_cornering_stiffness_npr) * force
        return more

    def answered(
        self, wanted: Array, speed: Array, spectrum: Spectrum, gradient: float | None = None
    ) -> Array:
        """Yaw rate (N,) that follows the quasi-static one (N,), by responses at a few speeds.

        gradient: understeer gradient [rad/(m/s^2)] if not the chassis'.
        """
        v = np.clip(np.abs(speed), NODES_MPS[0], NODES_MPS[-1])
        answers = spectrum.apply_all(
            wanted, [self.response(node, spectrum.s, gradient) for node in NODES_MPS]
        )
        result = np.zeros(len(wanted))
        for i, answer in enumerate(answers):
            weight = np.interp(v, NODES_MPS, np.eye(len(NODES_MPS))[i])
            result += weight * answer
        return result

    def response(self, v: float, s: Response, gradient: float | None = None) -> Response:
        """Yaw rate over its quasi-static value at speed v [m/s], along Laplace variables s.

        What understeers more has softer front tyres, and answers later.
        """
        c = self._c
        if gradient is not None:
            c = msgspec.structs.replace(c, understeer_gradient=gradient)
        m, inertia, lf, lr = c.mass_kg, c.yaw_inertia_kgm2, c.cg_to_front_m, c.cg_to_rear_m
        cf, cr = c.front_cornering_stiffness_npr, c.rear_cornering_stiffness_npr
        moment = lf * cf - lr * cr
        a11, a22 = (cf + cr) / (m * v), (lf * lf * cf + lr * lr * cr) / (inertia * v)
        a12, a21 = v + moment / (m * v), moment / (inertia * v)
        static = lf * cf / inertia * a11 - a21 * cf / m
        steady = a11 * a22 - a12 * a21
        gain = 1.0 + s * (lf * cf / inertia / static)
        return gain / (1.0 + s * ((a11 + a22) / steady) + s * s / steady)
