"""The equations of one drive: what its signals should show of each other.

Gravity is carried by the gyroscope. In a block, with vehicle axes x forward, y left, z up, rates w
and heading psi, the horizontal part u = u_x + i u_y of the vertical in the body obeys
u' = -w_y + i w_x - i w_z u (Wu et al. 2011, to first order in the tilt):

    u(t) = e^(-i psi) (z0 + integral of e^(i psi) (-w_y + i w_x) dt)
    f_x = dv/dt - r v_y + g u_x,   f_y = v r + dv_y/dt + g u_y,   v_y = l_r r - kappa v |v| r

z0, the tilt at the middle of the block, is free; so slope, cross fall and lean need not be known.
"""

from __future__ import annotations

import numpy as np

from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause_keys import Changes, age, along_vehicle, rear_slip
from imucald.diagnosis.reading import Reader, Reference
from imucald.diagnosis.signals import STEP_S, Array
from imucald.diagnosis.single_track import SLOW_MPS, followed_angle, slip_delay

SMOOTH_STEPS = 5
"""What comes of the speed's slopes, and the road's lean, are smoothed over so many steps."""
SMOOTHER = np.ones(SMOOTH_STEPS) / SMOOTH_STEPS
TRANSITION_S = 2.0
"""Superelevation is built up along the transition curve: two seconds of travel (desirable length
of a spiral, AASHTO, A Policy on Geometric Design of Highways and Streets)."""
TRANSITION = np.hanning(round(TRANSITION_S / STEP_S) + 1)
TRANSITION /= TRANSITION.sum()


class VehicleMotion:
    """The signals of one evaluation, along the vehicle's axes."""

    def __init__(self, reader: Reader, changes: Changes, by_inertia: bool) -> None:
        self.f, self.changes = reader, changes
        drive, model = reader.drive, reader.model
        late = reader.age("speed", changes) + model.speed.delay_rate * reader.knots
        late += changes.get("speed.delay_rate", 0.0) * (reader.knots - reader.middle_s)
        self.knots = reader.knots - late
        scale = model.speed.scale + changes.get("speed.scale", 0.0)
        driven = changes.get("_speed.driven_slip", 0.0)
        v = drive.knots.values / (1.0 + scale)
        self.v = np.interp(reader.t, self.knots, v)
        self.settled = reference = reader.reference if by_inertia else None
        self.force = reader.triad("accel", changes, reference.force if reference else None)
        self.rate = reader.triad("gyro", changes) if drive.has("gyro") else None
        self.measured: Array | None = None
        if reference is not None and self.rate is not None:
            # The gain of a rate is not shown by that rate itself.
            ungained = {k: x for k, x in changes.items() if not k.startswith("gyro.scale")}
            self.measured = reader.triad("gyro", ungained)
        if self.rate is not None:
            self.r = self.rate[:, 2]
            lever = np.array(model.mount.lever_arm_m) * float(model.mount.lever_arm)
            lever += np.array([changes.get(f"mount.lever_arm_m.{i}", 0.0) for i in range(3)])
            if reference is not None:
                lever -= np.array(model.mount.lever_arm_m) * float(model.mount.lever_arm)
            if lever.any():
                self.force = self.force - self._lever(lever)
        elif drive.has("yaw_rate"):
            self.r = reader.scalar("yaw_rate", changes)
        else:
            self.r = np.zeros(len(reader.t))
        kappa = rear_slip(model) + changes.get("_tyre.rear_slip", 0.0)
        slip = kappa * np.abs(self.v)
        late = slip_delay(self.v, slip, model.chassis)
        self.v_y = model.chassis.cg_to_rear_m * self.r
        self.v_y = self.v_y - slip * self.v * np.interp(reader.t - late, reader.t, self.r)
        slopes = np.diff(drive.knots.values) / np.diff(reader.knots)
        if reference is not None:
            slopes = reference.slopes
        self.slopes = slopes / (1.0 + scale)
        if driven:
            # Driven wheels turn faster than the vehicle moves: v_wheel = v (1 + c a).
            lead = self.v * self.held(self.slopes)
            self.slopes = self.slopes - driven * self._mean_slopes(np.gradient(lead, STEP_S))

    def _lever(self, lever: Array) -> Array:
        """Acceleration of a point at `lever` against the body's reference: w' x l + w x (w x l)."""
        assert self.rate is not None
        w = self.rate
        turning = np.empty_like(w)
        for i in range(3):
            turning[:, i] = slope(w[:, i])
        made: Array = np.cross(turning, lever) + np.cross(w, np.cross(w, lever))
        return made

    # operators -----------------------------------------------------------------------------------

    def _mean_slopes(self, x: Array) -> Array:
        """Mean of x between each two knots of the speed: what these say of an acceleration."""
        t, area = self.f.t, np.cumsum(x) * STEP_S
        at = np.interp(self.knots, t + 0.5 * STEP_S, area)
        return np.diff(at) / np.diff(self.knots)

    def held(self, slopes: Array) -> Array:
        """A value between each two knots, on the grid."""
        index = np.clip(np.searchsorted(self.knots, self.f.t) - 1, 0, len(slopes) - 1)
        return np.asarray(slopes[index])

    def as_speed_sees(self, x: Array) -> Array:
        """Means of x between two knots of the speed, on the grid."""
        return self.held(self._mean_slopes(x))

    def _gravity(self) -> tuple[Array, Array]:
        """u with z0 = 0, and e^(-i psi) by which z0 counts; complex (N,), by blocks."""
        f = self.f
        assert self.rate is not None
        p, q, r = (self.rate[:, i].reshape(f.blocks, f.rows) for i in range(3))
        psi = _from_middle(r)
        turned = np.exp(1j * psi)
        return (_from_middle(turned * (-q + 1j * p)) / turned).ravel(), (1.0 / turned).ravel()

    def reference(self, tilt: Array, inertial: Array) -> Reference:
        """Signals for columns, with the tilt (B, 2) of each block. inertial: (B,) share of the
        accelerometer in the slope of the speed; all of it where the vehicle hardly moves, and
        speeds jump to 0."""
        f, force = self.f, self.force.copy()
        x = force[:, 0]
        if self.f.has_turning:
            force[:, 1] = self.v * self.r + slope(self.v_y)
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
        rate = None if self.rate is None else self.rate.copy()
        if rate is not None and f.drive.has("yaw_rate"):
            rate[:, 2] = f.scalar("yaw_rate", {})
        steered = self._by_steering() if f.drive.has("steering") and f.has_turning else None
        return Reference(slopes, force, self.force[:, 1] - self.v * self.r, rate, steered)

    # equations -----------------------------------------------------------------------------------

    def longitudinal(self, found: dict[str, Array], tilt: dict[str, tuple[Array, Array]]) -> None:
        """Forward force against the speed's slope."""
        f, x = self.f, self.force[:, 0] + self.r * self.v_y
        if self.rate is None:
            one = np.ones(len(x))
            tilt["accel_x"] = self._two(-GRAVITY * self.as_speed_sees(one), 0.0 * one)
        else:
            u, turned = self._gravity()
            x = x - GRAVITY * u.real
            parts = (turned.real, -turned.imag)
            tilt["accel_x"] = self._two(*(self.as_speed_sees(-GRAVITY * z) for z in parts))
        found["accel_x"] = self.as_speed_sees(x) - self.held(self.slopes)
        if f.drive.has("longitudinal_accel"):
            found["longitudinal_accel"] = self._felt("longitudinal_accel", 0) - self.force[:, 0]

    def _in_blocks(self, x: Array) -> Array:
        return x.reshape(self.f.blocks, self.f.rows)

    def _two(self, first: Array, second: Array) -> tuple[Array, Array]:
        return self._in_blocks(first), self._in_blocks(second)

    def lateral(self, found: dict[str, Array], tilt: dict[str, tuple[Array, Array]]) -> None:
        """Sideways force against speed times yaw rate."""
        y = self.force[:, 1] - self.v * self.r - slope(self.v_y)
        if self.rate is None:
            one = np.ones(len(y))
            tilt["accel_y"] = self._two(0.0 * one, -GRAVITY * one)
        else:
            u, turned = self._gravity()
            y = y - GRAVITY * u.imag
            tilt["accel_y"] = self._two(-GRAVITY * turned.imag, -GRAVITY * turned.real)
        found["accel_y"] = y

    def vertical(self, found: dict[str, Array]) -> None:
        """Upward force; on a vertical curve the vehicle pitches as it goes."""
        assert self.rate is not None
        if not self.f.drive.planar:
            found["accel_z"] = self.force[:, 2] - GRAVITY + self.v * self.rate[:, 1]

    def turning(self, found: dict[str, Array]) -> None:
        """Rates of roll and pitch: the springs' part is known, the road's is noise."""
        assert self.rate is not None
        s, c = self.f.model.suspension, self.changes
        # Of motion alone: gravity's part of the force turns with the rates themselves.
        along, across = self._slow(self.held(self.slopes)), self._slow(self.v * self.r)
        roll = s.roll_gradient * float(s.body_roll) + c.get("suspension.roll_gradient", 0.0)
        squat = s.squat_gradient * float(s.squat_dive) + c.get("suspension.squat_gradient", 0.0)
        dive = s.dive_gradient * float(s.squat_dive) + c.get("suspension.dive_gradient", 0.0)
        nose_up = squat * np.maximum(along, 0.0) + dive * np.minimum(along, 0.0)
        rate = self.rate if self.measured is None else self.measured
        leaning = roll * self._later(across, s.roll_damping, s.roll_frequency_hz)
        # A curve's road leans inward with its curvature, which a transition curve spreads out.
        leaning -= c.get("_road.superelevation", 0.0) * np.convolve(across, TRANSITION, "same")
        nose_up = self._later(nose_up, s.pitch_damping, s.pitch_frequency_hz)
        found["gyro_x"] = rate[:, 0] - np.gradient(leaning, STEP_S)
        found["gyro_y"] = rate[:, 1] + np.gradient(nose_up, STEP_S)
        if self.f.drive.has("yaw_rate"):
            true = None if self.settled is None else self.settled.rate
            found["gyro_z"] = self._turning(true) - self._own_yaw_rate(true)

    def _later(self, x: Array, damping: float, hz: float) -> Array:
        """The body follows as a damped spring: late by 2 zeta / omega well below its own motion."""
        t = self.f.t
        return np.asarray(np.interp(t - damping / (np.pi * hz), t, x))

    def _slow(self, x: Array) -> Array:
        return np.asarray(np.convolve(x, SMOOTHER, "same"))

    def vehicle(self, found: dict[str, Array]) -> None:
        """What the vehicle's own sensors say beside each other."""
        f, drive = self.f, self.f.drive
        if drive.has("lateral_accel") and self.f.has_turning:
            found["lateral_accel"] = self._felt("lateral_accel", 1) - self.force[:, 1]
        if drive.has("wheel_speeds"):
            own = np.array(f.model.wheel_speeds.scale)
            # Wheels and speed come of one unit, and are late together.
            late = age(f.model, "wheel_speeds") + self.changes.get("speed.delay_s", 0.0)
            wheels = f.raw("wheel_speeds", late) / (1.0 + own)
            # Tyres that are smaller than stated make wheels and speed too fast by the same factor.
            scale = 1.0 + self.changes.get("wheel_speeds.scale", 0.0)
            scale *= 1.0 + self.changes.get("speed.scale", 0.0)
            found["speed"] = np.abs(self.v) - wheels[:, 2:].mean(axis=1) / scale
        if drive.has("steering") and f.has_turning:
            found["yaw_rate"] = self.yaw_rate() - self._by_steering()

    def yaw_rate(self) -> Array:
        """The vehicle's own yaw rate, else the gyroscope's [rad/s]."""
        true, s = None, self.settled
        if s is not None and s.steered is not None:
            # Of two gains of one equation, each made of its own signal, the difference is the
            # equation itself, with its noise: both are made of the same.
            rate = np.zeros((len(s.steered), 3)) if s.rate is None else s.rate
            true = np.column_stack([rate[:, :2], s.steered])
        if self.f.drive.has("yaw_rate"):
            return self._own_yaw_rate(true)
        return self._turning(true)

    def _own_yaw_rate(self, true: Array | None) -> Array:
        """The vehicle's own yaw rate. true: (N, 3) of turning that takes its place."""
        z = None if true is None else true[:, 2]
        return self.f.scalar("yaw_rate", self.changes, z)

    def _turning(self, true: Array | None) -> Array:
        """The gyroscope's yaw rate. true: (N, 3) of turning that takes its place."""
        if true is None:
            return np.asarray(self.r)
        return self.f.triad("gyro", self.changes, true)[:, 2]

    def _felt(self, name: str, axis: int) -> Array:
        """An acceleration by the vehicle's own sensor; for columns, of the force of `settle`."""
        force = None if self.settled is None else self.settled.force[:, axis]
        return self.f.scalar(name, self.changes, force)

    def _by_steering(self) -> Array:
        """Single track: r = v (delta - K (f_y - v r))/(L + K v^2), where delta is the angle as the
        vehicle follows it (Rajamani, Vehicle Dynamics and Control, ch. 2, 3)."""
        f, c = self.f, self.f.model.chassis
        ratio = c.steering_ratio + self.changes.get("chassis.steering_ratio", 0.0)
        gradient = c.understeer_gradient + self.changes.get("chassis.understeer_gradient", 0.0)
        v = np.abs(self.v)
        steer = f.scalar("steering", self.changes)
        steer = followed_angle(steer, v, c, gradient)
        leaning = self._leaning()
        angle = np.clip(steer / ratio, -1.2, 1.2)
        angle = angle + self.changes.get("_steering.variable_ratio", 0.0) * angle**3
        turn = np.tan(angle) - gradient * self._slow(leaning)
        return np.asarray(self.v * turn / np.maximum(c.wheelbase_m + gradient * v * v, 0.3))

    def _leaning(self) -> Array:
        """Sideways force that the road's lean brings [m/s^2].

        It acts through the understeer gradient, which nobody knows to a tenth: zeros and the mount
        move it, but gains are not to be read from it.
        """
        if self.settled is None:
            return np.asarray(self.force[:, 1] - self.v * self.r)
        moved = along_vehicle(self.changes, "accel.bias")[1]
        moved += GRAVITY * along_vehicle(self.changes, "mount.turn")[0]
        return np.asarray(self.settled.leaning - moved)


def slope(x: Array) -> Array:
    """Slope of x (N,) on the grid [1/s], to fourth order: right to 0.5 % up to 1 Hz, where the
    difference of two neighbours loses 6.5 %."""
    padded = np.concatenate([x[:1], x[:1], x, x[-1:], x[-1:]])
    near, far = padded[3:-1] - padded[1:-3], padded[4:] - padded[:-4]
    return np.asarray((8.0 * near - far) / (12.0 * STEP_S))


def _from_middle(x: Array) -> Array:
    """Integral from the middle of each block; (B, n), trapezoids."""
    area = np.cumsum(0.5 * (x[:, 1:] + x[:, :-1]), axis=1) * STEP_S
    area = np.concatenate([np.zeros_like(x[:, :1]), area], axis=1)
    made: Array = area - area[:, x.shape[1] // 2, None]
    return made
