"""The equations of one drive, which predict its signals from each other.

The direction of gravity is integrated with the gyroscope. The vehicle axes are x forward, y left, z
up, the rates are w, the heading is psi. In a block, the horizontal part u = u_x + i u_y of the
vertical in vehicle axes obeys
u' = -w_y + i w_x - i w_z u (Wu et al. 2011, to first order in the tilt):

    u(t) = e^(-i psi) (z0 + integral of e^(i psi) (-w_y + i w_x) dt)
    f_x = dv/dt - r v_y + g u_x,   f_y = v r + dv_y/dt + g u_y,   v_y = l_r r - kappa v |v| r

The tilt z0 at the middle of the block is a free parameter, so slope, cross fall and body lean need
not be known.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause_keys import Changes, age, along_vehicle, rear_slip
from imucald.diagnosis.equations.reading import Once, Reader, Reference, column
from imucald.diagnosis.signals import STEP_S
from imucald.drive import equations as eq
from imucald.drive import single_track as tyres
from imucald.drive.equations import Axes, Complex
from imucald.drive.single_track import SLOW_MPS
from imucald.model.vehicle import Chassis

NONE: Mapping[str, Array] = {}


class VehicleMotion:
    """The signals of one evaluation, along the vehicle's axes.

    added: for each signal, an error that is added to the measured values, (N,) or (N, 3) along the
    vehicle's axes. Signals that the changes do not affect stay the same array objects, see `Once`.
    """

    def __init__(
        self, reader: Reader, changes: Changes, by_inertia: bool, added: Mapping[str, Array] = NONE
    ) -> None:
        self.f, self.changes, self.added = reader, changes, added
        self.once = once = Once(reader.known, not changes and not added)
        drive, model = reader.drive, reader.model
        late, rate = reader.age("speed", changes), changes.get("speed.delay_rate", 0.0)
        self.knots = once(reader.knots_at, late, rate)
        scale = model.speed.scale + changes.get("speed.scale", 0.0)
        driven = changes.get("_speed.driven_slip", 0.0)
        self.v = once(eq.speed, reader.t, self.knots, drive.knots.values, scale)
        self.settled = reference = reader.reference if by_inertia else None
        self.is_column = reference is not None or bool(added)
        self.force = reader.triad("accel", changes, reference.force if reference else None)
        self.rate = reader.triad("gyro", changes) if drive.has("gyro") else None
        if "speed" in added:
            self.v = self.v + added["speed"]
        if "accel" in added:
            self.force = _more(self.force, added["accel"])
        if self.rate is not None and "gyro" in added:
            self.rate = _more(self.rate, added["gyro"])
        self.measured = self.rate
        if reference is not None and any(k.startswith("gyro.scale") for k in changes):
            # A rate does not show its own gain.
            ungained = {k: x for k, x in changes.items() if not k.startswith("gyro.scale")}
            self.measured = reader.triad("gyro", ungained)
        if self.rate is not None:
            self.r = self.rate[2]
            lever = np.array(model.mount.lever_arm_m) * float(model.mount.lever_arm)
            lever += np.array([changes.get(f"mount.lever_arm_m.{i}", 0.0) for i in range(3)])
            if reference is not None:
                lever -= np.array(model.mount.lever_arm_m) * float(model.mount.lever_arm)
            if lever.any():
                x, y, z = once(_of_lever, *self.rate, tuple(lever))
                forward, left, upward = self.force
                self.force = self._apart(forward, x), self._apart(left, y), self._apart(upward, z)
        elif drive.has("yaw_rate"):
            self.r = self._scalar("yaw_rate")
        else:
            self.r = once(np.zeros, len(reader.t))
        slopes = once(eq.mean_slope, drive.knots.values, reader.knots)
        if reference is not None:
            slopes = reference.slopes
        self.slopes = once(np.divide, slopes, 1.0 + scale)
        if "speed" in added:
            at_knots = np.interp(self.knots, reader.t, added["speed"])
            self.slopes = self.slopes + eq.mean_slope(at_knots, reader.knots)
        if driven:
            # Driven wheels turn faster than the vehicle moves: v_wheel = v (1 + c a).
            lead = self.v * self.held(self.slopes)
            self.slopes = self.slopes - driven * self._mean_slopes(np.gradient(lead, STEP_S))
        self.kappa = rear_slip(model) + changes.get("_tyre.rear_slip", 0.0)
        self.height = changes.get("_tyre.loaded_height", 0.0)
        self.ahead = once(eq.slow, self.held(self.slopes))
        self.v_y = once(
            tyres.sideways, self.v, self.r, reader.t, self.kappa, self.ahead, self.height,
            model.chassis,
        )  # fmt: skip

    def _scalar(self, name: str, true: Array | None = None) -> Array:
        shown = self.f.scalar(name, self.changes, true)
        return shown + self.added[name] if name in self.added else shown

    # operators -----------------------------------------------------------------------------------

    def _mean_slopes(self, x: Array) -> Array:
        """Return the mean of x between successive knots of the speed. A speed shows the mean
        acceleration between its knots."""
        return self.once(eq.between_knots, x, self.knots, self.f.t)

    def held(self, slopes: Array) -> Array:
        """Return values between successive knots as values on the grid, constant between two
        knots."""
        return self.once(np.take, slopes, self.once(eq.step_of, self.knots, self.f.t))

    def as_speed_sees(self, x: Array) -> Array:
        """Return the means of x between successive knots of the speed, on the grid."""
        return self.held(self._mean_slopes(x))

    def _gravity(self) -> tuple[Complex, Complex]:
        """Return u (N,) for z0 = 0, and e^(-i psi) (N,), which is the factor of z0. Both arrays are
        complex and computed block by block."""
        assert self.rate is not None
        p, q, r = self.rate
        turned, back = self.once(eq.turned, r, self.f.rows)
        return self.once(eq.carried, p, q, turned), back

    def reference(self, tilt: Array, inertial: Array) -> Reference:
        """Return the signals for columns, with the tilt (B, 2) of each block.

        inertial: (B,) share of the accelerometer in the slope of the speed. The share is 1 where
        the vehicle hardly moves, because a measured speed jumps to 0 there."""
        f, force = self.f, np.column_stack(self.force)
        x = force[:, 0]
        if self.f.has_turning:
            force[:, 1] = self.v * self.r + eq.slope(self.v_y)
        if self.rate is not None:
            u, turned = self._gravity()
            u = u + np.repeat(tilt[:, 0] + 1j * tilt[:, 1], f.rows) * turned
            x = x - GRAVITY * u.real
            force[:, 1] += GRAVITY * u.imag
        force[:, 2] = GRAVITY
        along = x + self.r * self.v_y
        by_speed = np.where(np.abs(self.v) > SLOW_MPS, np.repeat(1.0 - inertial, f.rows), 0.0)
        moved = by_speed * (self.held(self.slopes) - along)
        force[:, 0] += moved
        slopes = self._mean_slopes(along + moved) * (1.0 + f.model.speed.scale)
        rate = None if self.rate is None else np.column_stack(self.rate)
        if rate is not None and f.drive.has("yaw_rate"):
            rate[:, 2] = f.scalar("yaw_rate", {})
        steered = self._by_steering() if f.drive.has("steering") and f.has_turning else None
        return Reference(slopes, force, self.force[1] - self.v * self.r, rate, steered)

    # equations -----------------------------------------------------------------------------------

    def longitudinal(self, found: dict[str, Array], tilt: dict[str, tuple[Array, Array]]) -> None:
        """Compute the residual of the forward force against the slope of the speed. Columns use the
        tilt of the evaluation without changes."""
        f, u = self.f, None
        if self.rate is None:
            one = np.ones(len(f.t))
            tilt["accel_x"] = self._two(-GRAVITY * self.as_speed_sees(one), 0.0 * one)
        else:
            u, turned = self._gravity()
            if not self.is_column:
                parts = (turned.real, -turned.imag)
                tilt["accel_x"] = self._two(*(self.as_speed_sees(-GRAVITY * z) for z in parts))
        along = self.once(eq.along, self.force[0], self.r, self.v_y, u)
        found["accel_x"] = self._apart(self.as_speed_sees(along), self.held(self.slopes))
        if f.drive.has("longitudinal_accel"):
            found["longitudinal_accel"] = self._felt("longitudinal_accel", 0)

    def _two(self, first: Array, second: Array) -> tuple[Array, Array]:
        return self.f.in_blocks(first), self.f.in_blocks(second)

    def _apart(self, first: Array, second: Array) -> Array:
        return self.once(np.subtract, first, second)

    def lateral(self, found: dict[str, Array], tilt: dict[str, tuple[Array, Array]]) -> None:
        """Compute the residual of the sideways force against speed times yaw rate."""
        u = None
        if self.rate is None:
            one = np.ones(len(self.f.t))
            tilt["accel_y"] = self._two(0.0 * one, -GRAVITY * one)
        else:
            u, turned = self._gravity()
            if not self.is_column:
                tilt["accel_y"] = self._two(-GRAVITY * turned.imag, -GRAVITY * turned.real)
        found["accel_y"] = self.once(eq.across, self.force[1], self.v, self.r, self.v_y, u)

    def vertical(self, found: dict[str, Array]) -> None:
        """Compute the residual of the upward force. On a vertical curve, the vehicle pitches with
        the road."""
        assert self.rate is not None
        if not self.f.drive.planar:
            found["accel_z"] = self.once(eq.upward, self.force[2], self.v, self.rate[1])

    def turning(self, found: dict[str, Array]) -> None:
        """Compute the residuals of roll rate and pitch rate. The effect of the springs is known,
        and the effect of the road is noise."""
        assert self.measured is not None
        s, c, t, once = self.f.model.suspension, self.changes, self.f.t, self.once
        # Only motion is used, because gravity's part of the force changes with the rates
        # themselves.
        across = once(eq.slow, once(np.multiply, self.v, self.r))
        roll = s.roll_gradient * float(s.body_roll) + c.get("suspension.roll_gradient", 0.0)
        squat = s.squat_gradient * float(s.squat_dive) + c.get("suspension.squat_gradient", 0.0)
        dive = s.dive_gradient * float(s.squat_dive) + c.get("suspension.dive_gradient", 0.0)
        late = s.roll_damping / (np.pi * s.roll_frequency_hz) + c.get("_suspension.roll_lag", 0.0)
        superelevation = c.get("_road.superelevation", 0.0)
        rolling = once(eq.rolling, across, roll, superelevation, t, late)
        found["gyro_x"] = self._apart(self.measured[0], rolling)
        late = s.pitch_damping / (np.pi * s.pitch_frequency_hz)
        pitching = once(eq.pitching, self.ahead, squat, dive, t, late)
        found["gyro_y"] = once(np.add, self.measured[1], pitching)
        if self.f.drive.has("yaw_rate"):
            true = None if self.settled is None else self.settled.rate
            found["gyro_z"] = self._apart(self._turning(true), self._own_yaw_rate(true))

    def vehicle(self, found: dict[str, Array]) -> None:
        """Compute the residuals of the vehicle's own sensors, compared with each other."""
        f, drive = self.f, self.f.drive
        if drive.has("lateral_accel") and self.f.has_turning:
            found["lateral_accel"] = self._felt("lateral_accel", 1)
        if drive.has("wheel_speeds"):
            # Wheel speeds and speed come from one unit and have a common delay.
            late = age(f.model, "wheel_speeds") + self.changes.get("speed.delay_s", 0.0)
            # Tyres that are smaller than stated make wheels and speed too fast by the same factor.
            scale = 1.0 + self.changes.get("wheel_speeds.scale", 0.0)
            scale *= 1.0 + self.changes.get("speed.scale", 0.0)
            shown, own = f.raw("wheel_speeds", late), f.model.wheel_speeds.scale
            found["speed"] = self.once(eq.beside_wheels, self.v, shown, own, scale)
        if drive.has("steering") and f.has_turning:
            found["yaw_rate"] = self._apart(self.yaw_rate(), self._by_steering())

    def yaw_rate(self) -> Array:
        """Return the vehicle's own yaw rate, or else the yaw rate of the gyroscope [rad/s]."""
        true, s = None, self.settled
        if s is not None and s.steered is not None:
            # If each gain's column used its own signal, the difference of two columns would be the
            # residual with its noise. So both columns use the same signal.
            true = self.once(_turning_by, s.rate, s.steered)
        if self.f.drive.has("yaw_rate"):
            return self._own_yaw_rate(true)
        return self._turning(true)

    def _own_yaw_rate(self, true: Array | None) -> Array:
        """Return the vehicle's own yaw rate. true: (N, 3) angular rate that replaces the measured
        rate."""
        z = None if true is None else self.once(column, true, 2)
        return self._scalar("yaw_rate", z)

    def _turning(self, true: Array | None) -> Array:
        """Return the yaw rate of the gyroscope. true: (N, 3) angular rate that replaces the
        measured rate."""
        if true is None:
            return np.asarray(self.r)
        return self.f.triad("gyro", self.changes, true)[2]

    def _felt(self, name: str, axis: int) -> Array:
        """Return the acceleration from the vehicle's own sensor minus the force. Columns use the
        force of `settle`."""
        force = None if self.settled is None else self.once(column, self.settled.force, axis)
        own = self._scalar(name, force)
        return self._apart(own, self.force[axis])

    def _by_steering(self) -> Array:
        """Return the yaw rate of the single-track model: r = v (delta - K (f_y - v r))/(L + K v^2).
        delta is the steering angle that the vehicle has followed so far (Rajamani, Vehicle Dynamics
        and Control, ch. 2, 3)."""
        c, once = self.f.model.chassis, self.once
        ratio = c.steering_ratio + self.changes.get("chassis.steering_ratio", 0.0)
        gradient = c.understeer_gradient + self.changes.get("chassis.understeer_gradient", 0.0)
        steer = self._scalar("steering")
        steer = once(self._followed, steer, once(np.abs, self.v), c, gradient)
        varying = self.changes.get("_steering.variable_ratio", 0.0)
        leaning = once(eq.slow, self._leaning())
        transfer = tyres.load_transfer(self.height, self.kappa, gradient, c)
        return once(
            tyres.single_track, self.v, steer, leaning, ratio, gradient, varying, c.wheelbase_m,
            self.ahead, transfer,
        )  # fmt: skip

    def _followed(self, steer: Array, speed: Array, chassis: Chassis, gradient: float) -> Array:
        return tyres.followed_angle(steer, speed, chassis, gradient, self.once)

    def _leaning(self) -> Array:
        """Return the sideways force from the road's lean [m/s^2].

        The lean acts on the yaw rate through the understeer gradient, which is not known to 10 %.
        The lean therefore changes with zero errors and with the mount, but gains must not be
        estimated from it.
        """
        if self.settled is None:
            return self.once(eq.left_of_turn, self.force[1], self.v, self.r)
        moved = along_vehicle(self.changes, "accel.bias")[1]
        moved += GRAVITY * along_vehicle(self.changes, "mount.turn")[0]
        return self._apart(self.settled.leaning, moved)


def _more(axes: Axes, added: Array) -> Axes:
    """Return the axes plus `added` (N, 3). An axis without an addition stays the same array
    object."""
    x, y, z = (c + a if a.any() else c for c, a in zip(axes, added.T, strict=True))
    return x, y, z


def _turning_by(rate: Array | None, steered: Array) -> Array:
    """Return the angular rate (N, 3) with its yaw rate replaced by `steered`."""
    level = np.zeros((len(steered), 2)) if rate is None else rate[:, :2]
    return np.column_stack([level, steered])


def _of_lever(x: Array, y: Array, z: Array, lever: tuple[float, float, float]) -> Axes:
    return eq.of_lever((x, y, z), (eq.slope(x), eq.slope(y), eq.slope(z)), lever)
