"""What a drive's signals should show: the physics, and nothing of statistics.

Gravity is carried by the gyroscope. In a block, with vehicle axes x forward, y left, z up, rates w
and heading psi, the horizontal part u = u_x + i u_y of the vertical in the body obeys
u' = -w_y + i w_x - i w_z u (Wu et al. 2011, to first order in the tilt):

    u(t) = e^(-i psi) (z0 + integral of e^(i psi) (-w_y + i w_x) dt)
    f_x = dv/dt - r v_y + g u_x,   f_y = v r + dv_y/dt + g u_y,   v_y = l_r r - kappa v |v| r

z0, the tilt at the middle of the block, is free; so slope, cross fall and lean need not be known.
Each equation is a residual, measured less predicted, on the grid. A column of the fit is how the
residual changes with a parameter, found by evaluating it again: there the slope of the speed is
that of the accelerometer, so that no column is made of the noise that stands in its equation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.diagnosis.model_file import (
    Changes,
    age,
    along_vehicle,
    mounts,
    rear_slip,
    sensor_of,
    value,
)
from imucald.diagnosis.signals import STEP_S, Array, Drive, Mask
from imucald.model.model import VehicleModel

REFERENCE_DEGC = 25.0
SLOW_MPS = 2.5
"""Below this play and tyres decide on the yaw rate, not the steering angle."""
RELAXATION_S = 0.03
"""A tyre of 0.5 m relaxation length at 15 m/s."""
SMOOTH_STEPS = 5
"""Angular acceleration is the slope over so many steps: it is mostly noise above 1 Hz."""
UNITS: Mapping[str, str] = {
    "accel_x": "m/s^2", "accel_y": "m/s^2", "accel_z": "m/s^2", "gyro_x": "rad/s",
    "gyro_y": "rad/s", "gyro_z": "rad/s", "yaw_rate": "rad/s", "lateral_accel": "m/s^2",
    "longitudinal_accel": "m/s^2", "speed": "m/s",
}  # fmt: skip


@dataclass(frozen=True)
class Residuals:
    """One evaluation. Arrays (B, n): blocks and rows in them."""

    of: Mapping[str, Array]
    tilt: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    """Of an equation with gravity in it: how it changes with the two parts of z0."""


class Forward:
    """Residuals of one drive against a model file, block by block."""

    def __init__(self, drive: Drive, model: VehicleModel, rows: int) -> None:
        self.drive, self.model = drive, model
        self.rows = rows
        self.blocks = len(drive.t) // rows
        spare = len(drive.t) - self.blocks * rows
        self.t = drive.t[spare // 2 : spare // 2 + self.blocks * rows]
        self.has_gravity = drive.has("gyro")
        self.has_turning = drive.has("gyro") or drive.has("yaw_rate")
        self.middle_s = float(self.t[len(self.t) // 2]) if self.blocks else 0.0
        self._read: dict[tuple[str, float], Array] = {}
        self.knots = drive.knots.t
        self._reference: _Reference | None = None

    # reading -------------------------------------------------------------------------------------

    def _raw(self, name: str, later: float) -> Array:
        key = (name, round(later, 6))
        if key not in self._read:
            self._read[key] = self.drive.channels[name].means(self.t + later)
        return self._read[key]

    def _age(self, name: str, changes: Changes) -> float:
        return age(self.model, name) + changes.get(f"{name}.delay_s", 0.0)

    def _triad(self, name: str, changes: Changes, force: Array | None = None) -> Array:
        """(N, 3) along the vehicle's axes, with the model file's errors taken off.

        force: (N, 3) along the vehicle's axes that takes the place of the measured one.
        """
        sensor = sensor_of(self.model, name, changes)
        if force is None:
            raw = self._raw(name, self._age(name, changes)) - sensor.bias
        else:
            raw = self._in_sensor(force, changes.get(f"{name}.delay_s", 0.0), name)
        warm = self._warmth() if self.drive.has("temperature") else None
        if warm is not None and sensor.per_kelvin.any() and force is None:
            raw = raw - warm[:, None] * sensor.per_kelvin
        if sensor.per_force.any():
            stated = np.array(self.model.gyro.g_sensitivity)
            raw = raw - stated * self._raw("accel", self._age("accel", changes))
            if (sensor.per_force != stated).any():
                level = self._in_sensor(np.tile([0.0, 0.0, GRAVITY], (len(self.t), 1)), 0.0, name)
                felt = self._raw("accel", self._age("accel", changes)) - level
                raw = raw - (sensor.per_force - stated) * felt
        true = raw @ np.linalg.inv(sensor.gain).T
        if name == "accel" and any(_is_gain(key) for key in changes):
            # A gain turns about one g upright; what it makes of that is a zero error.
            level = self._in_sensor(np.tile([0.0, 0.0, GRAVITY], (len(self.t), 1)), 0.0, name)
            stated = np.linalg.inv(sensor_of(self.model, name, {}).gain)
            true += level @ (stated - np.linalg.inv(sensor.gain)).T
        made = np.empty_like(true)
        turn = rotation_from_vector(along_vehicle(changes, "mount.turn"))
        for start, R in mounts(self.model):
            after = self.t >= start
            made[after] = true[after] @ (turn @ R).T
        made -= along_vehicle(changes, f"{name}.bias")
        drift = along_vehicle(changes, f"{name}.bias_temperature")
        if warm is not None and drift.any():
            made -= warm[:, None] * drift
        return made

    def _in_sensor(self, force: Array, later: float, name: str) -> Array:
        """What a triad without a zero error would say of a force (N, 3) at a later time."""
        if later:
            force = np.column_stack([np.interp(self.t + later, self.t, x) for x in force.T])
        turned = np.empty_like(force)
        for start, R in mounts(self.model):
            after = self.t >= start
            turned[after] = force[after] @ R
        return np.asarray(turned @ sensor_of(self.model, name, {}).gain.T)

    def _warmth(self) -> Array:
        return np.asarray(self._raw("temperature", 0.0) - REFERENCE_DEGC)

    def _scalar(self, name: str, changes: Changes) -> Array:
        part = getattr(self.model, name)
        offset = part.offset + changes.get(f"{name}.offset", 0.0)
        scale = part.scale + changes.get(f"{name}.scale", 0.0)
        return np.asarray((self._raw(name, self._age(name, changes)) - offset) / (1.0 + scale))

    # evaluation ----------------------------------------------------------------------------------

    def residuals(self, changes: Changes, by_inertia: bool = False) -> Residuals:
        """Measured less predicted with a changed model file, of every equation there is.

        by_inertia: for columns, with the signals of `settle`.
        """
        motion = _Motion(self, changes, by_inertia)
        found: dict[str, Array] = {}
        tilt: dict[str, tuple[Array, Array]] = {}
        motion.longitudinal(found, tilt)
        if self.has_turning:
            motion.lateral(found, tilt)
        if self.has_gravity:
            motion.vertical(found)
            motion.turning(found)
        motion.vehicle(found)
        return Residuals({k: self._blocks(v) for k, v in found.items()}, tilt)

    def _blocks(self, x: Array) -> Array:
        return x.reshape(self.blocks, self.rows)

    def settle(self, tilt: Array) -> None:
        """Choose the signals that columns are made of. tilt: (B, 2) z0 of each block."""
        self._reference = _Motion(self, {}, False).reference(tilt)

    def tilts(self, base: Residuals, masks: Mapping[str, Mask]) -> Array:
        """(B, 2) tilt of each block by plain least squares."""
        tilt = np.zeros((self.blocks, 2))
        for b in range(self.blocks):
            rows, values = [], []
            for name, (first, second) in base.tilt.items():
                good = masks[name][b]
                rows.append(np.column_stack([first[b][good], second[b][good]]))
                values.append(base.of[name][b][good])
            if sum(map(len, values)) > 10:
                A, y = np.concatenate(rows), np.concatenate(values)
                tilt[b] = np.linalg.lstsq(A, y, rcond=None)[0]
        return tilt

    def yaw_rate(self) -> Array:
        """(N,) yaw rate of the vehicle that the equations use [rad/s]."""
        return np.asarray(_Motion(self, {}, False).r)

    def measured(self) -> dict[str, Array]:
        """What each equation's sensor says, with the model file's errors taken off."""
        m = _Motion(self, {}, False)
        found = {f"accel_{axis}": m.force[:, i] for i, axis in enumerate("xyz")}
        found["accel_x"] = m._as_speed_sees(m.force[:, 0])
        if m.rate is not None:
            found |= {f"gyro_{axis}": m.rate[:, i] for i, axis in enumerate("xyz")}
        if self.has_turning:
            found["yaw_rate"] = m._yaw_rate()
        for name in ("lateral_accel", "longitudinal_accel"):
            if self.drive.has(name):
                found[name] = self._scalar(name, {})
        found["speed"] = np.abs(m.v)
        return found

    def levels(self) -> Array:
        """(B, 2) mean of u over each block as the forces tell it, without the gyroscope's carry."""
        motion = _Motion(self, {}, False)
        x = motion.force[:, 0] + motion.r * motion.v_y - motion._held(motion.slopes)
        y = motion.force[:, 1] - motion.v * motion.r - np.gradient(motion.v_y, STEP_S)
        means = [self._blocks(part).mean(axis=1) / GRAVITY for part in (x, y)]
        return np.column_stack(means)

    def usable(self) -> dict[str, Mask]:
        """(B, n) rows of each equation in which all of its signals were there."""
        there = {
            name: channel.present(self.t + self._age_or_0(name))
            for name, channel in self.drive.channels.items()
        }
        speed = np.interp(self.t, self.knots, np.abs(self.drive.knots.values))
        drive, base = self.drive, there["accel"] & there["speed"]
        yaw = there["yaw_rate"] if drive.has("yaw_rate") else np.ones(len(self.t), dtype=bool)
        turning = there["gyro"] if drive.has("gyro") else yaw
        inertial = there["accel"] & turning
        masks = {
            "accel_x": (base & turning if self.has_turning else base) & self._knots_inside(),
            "accel_y": base & turning, "accel_z": base & turning, "gyro_x": inertial & base,
            "gyro_y": inertial & base, "gyro_z": yaw & turning,
        }  # fmt: skip
        if drive.has("steering") and self.has_turning:
            masks["yaw_rate"] = base & turning & yaw & there["steering"] & (speed > SLOW_MPS)
        for name in ("lateral_accel", "longitudinal_accel"):
            if drive.has(name):
                masks[name] = there[name] & inertial
        if drive.has("wheel_speeds"):
            masks["speed"] = there["speed"] & there["wheel_speeds"] & (speed > SLOW_MPS)
        return {name: mask.reshape(self.blocks, self.rows) for name, mask in masks.items()}

    def _age_or_0(self, name: str) -> float:
        return age(self.model, name) if hasattr(getattr(self.model, name, None), "delay_s") else 0.0

    def _knots_inside(self) -> Mask:
        """Rows between two knots of the speed that lie in the same block."""
        late = age(self.model, "speed") + self.model.speed.delay_rate * self.knots
        knots = self.knots - late
        index = np.searchsorted(knots, self.t)
        inside = (index > 0) & (index < len(knots))
        block = np.arange(len(self.t)) // self.rows
        left = knots[np.clip(index - 1, 0, None)]
        right = knots[np.clip(index, 0, len(knots) - 1)]
        start = self.t[block * self.rows]
        stop = self.t[np.minimum((block + 1) * self.rows, len(self.t)) - 1]
        slack = STEP_S
        return np.asarray(inside & (left >= start - slack) & (right <= stop + slack))


@dataclass(frozen=True)
class _Reference:
    """Signals for columns, each without the noise of the equation in which it stands."""

    slopes: Array
    """Of the speed between its knots, by the accelerometer."""
    force: Array
    """(N, 3) along the vehicle: forward as measured, sideways as predicted, upward gravity."""


class _Motion:
    """The signals of one evaluation, along the vehicle's axes."""

    def __init__(self, forward: Forward, changes: Changes, by_inertia: bool) -> None:
        self.f, self.changes = forward, changes
        drive, model = forward.drive, forward.model
        late = forward._age("speed", changes) + model.speed.delay_rate * forward.knots
        late += changes.get("speed.delay_rate", 0.0) * (forward.knots - forward.middle_s)
        self.knots = forward.knots - late
        scale = model.speed.scale + changes.get("speed.scale", 0.0)
        slip = changes.get("_speed.driven_slip", 0.0)
        v = drive.knots.values / (1.0 + scale)
        self.v = np.interp(forward.t, self.knots, v)
        reference = forward._reference if by_inertia else None
        self.force = forward._triad("accel", changes, reference.force if reference else None)
        self.rate = forward._triad("gyro", changes) if drive.has("gyro") else None
        self.measured: Array | None = None
        if reference is not None and self.rate is not None:
            # The gain of a rate is not told by that rate itself.
            ungained = {k: x for k, x in changes.items() if not k.startswith("gyro.scale")}
            self.measured = forward._triad("gyro", ungained)
        if self.rate is not None:
            self.r = self.rate[:, 2]
            lever = np.array(model.mount.lever_arm_m) * float(model.mount.lever_arm)
            lever += np.array([changes.get(f"mount.lever_arm_m.{i}", 0.0) for i in range(3)])
            if reference is not None:
                lever -= np.array(model.mount.lever_arm_m) * float(model.mount.lever_arm)
            if lever.any():
                self.force = self.force - self._lever(lever)
        elif drive.has("yaw_rate"):
            self.r = forward._scalar("yaw_rate", changes)
        else:
            self.r = np.zeros(len(forward.t))
        kappa = rear_slip(model) + changes.get("_tyre.rear_slip", 0.0)
        self.v_y = model.chassis.cg_to_rear_m * self.r - kappa * self.v * np.abs(self.v) * self.r
        slopes = np.diff(drive.knots.values) / np.diff(forward.knots)
        if reference is not None:
            slopes = reference.slopes
        self.slopes = slopes / (1.0 + scale)
        if slip:
            # Driven wheels turn faster than the vehicle moves: v_wheel = v (1 + c a).
            lead = self.v * self._held(self.slopes)
            self.slopes = self.slopes - slip * self._mean_slopes(np.gradient(lead, STEP_S))

    def _lever(self, lever: Array) -> Array:
        """Acceleration of a point at `lever` against the body's reference: w' x l + w x (w x l)."""
        assert self.rate is not None
        w = self.rate
        turning = np.empty_like(w)
        for i in range(3):
            turning[:, i] = np.convolve(np.gradient(w[:, i], STEP_S), SMOOTHER, "same")
        made: Array = np.cross(turning, lever) + np.cross(w, np.cross(w, lever))
        return made

    # operators -----------------------------------------------------------------------------------

    def _mean_slopes(self, x: Array) -> Array:
        """Mean of x between each two knots of the speed: what these say of an acceleration."""
        t, area = self.f.t, np.cumsum(x) * STEP_S
        at = np.interp(self.knots, t + 0.5 * STEP_S, area)
        return np.diff(at) / np.diff(self.knots)

    def _held(self, slopes: Array) -> Array:
        """A value between each two knots, on the grid."""
        index = np.clip(np.searchsorted(self.knots, self.f.t) - 1, 0, len(slopes) - 1)
        return np.asarray(slopes[index])

    def _as_speed_sees(self, x: Array) -> Array:
        return self._held(self._mean_slopes(x))

    def _gravity(self) -> tuple[Array, Array]:
        """u with z0 = 0, and e^(-i psi) by which z0 counts; complex (N,), by blocks."""
        f = self.f
        assert self.rate is not None
        p, q, r = (self.rate[:, i].reshape(f.blocks, f.rows) for i in range(3))
        psi = _from_middle(r)
        turned = np.exp(1j * psi)
        return (_from_middle(turned * (-q + 1j * p)) / turned).ravel(), (1.0 / turned).ravel()

    def reference(self, tilt: Array) -> _Reference:
        """Signals for columns, with the tilt (B, 2) of each block."""
        f, force = self.f, self.force.copy()
        x = force[:, 0]
        if self.f.has_turning:
            force[:, 1] = self.v * self.r + np.gradient(self.v_y, STEP_S)
        if self.rate is not None:
            u, turned = self._gravity()
            u = u + np.repeat(tilt[:, 0] + 1j * tilt[:, 1], f.rows) * turned
            x = x - GRAVITY * u.real
            force[:, 1] += GRAVITY * u.imag
        force[:, 2] = GRAVITY
        slopes = self._mean_slopes(x + self.r * self.v_y) * (1.0 + f.model.speed.scale)
        return _Reference(slopes, force)

    # equations -----------------------------------------------------------------------------------

    def longitudinal(self, found: dict[str, Array], tilt: dict[str, tuple[Array, Array]]) -> None:
        """Forward force against the speed's slope."""
        f, x = self.f, self.force[:, 0] + self.r * self.v_y
        if self.rate is None:
            one = np.ones(len(x))
            tilt["accel_x"] = self._two(-GRAVITY * self._as_speed_sees(one), 0.0 * one)
        else:
            u, turned = self._gravity()
            x = x - GRAVITY * u.real
            parts = (turned.real, -turned.imag)
            tilt["accel_x"] = self._two(*(self._as_speed_sees(-GRAVITY * z) for z in parts))
        found["accel_x"] = self._as_speed_sees(x) - self._held(self.slopes)
        if f.drive.has("longitudinal_accel"):
            found["longitudinal_accel"] = (
                f._scalar("longitudinal_accel", self.changes) - self.force[:, 0]
            )

    def _two(self, first: Array, second: Array) -> tuple[Array, Array]:
        return self.f._blocks(first), self.f._blocks(second)

    def lateral(self, found: dict[str, Array], tilt: dict[str, tuple[Array, Array]]) -> None:
        """Sideways force against speed times yaw rate."""
        y = self.force[:, 1] - self.v * self.r - np.gradient(self.v_y, STEP_S)
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
        along, across = self._slow(self._held(self.slopes)), self._slow(self.v * self.r)
        roll = s.roll_gradient * float(s.body_roll) + c.get("suspension.roll_gradient", 0.0)
        squat = s.squat_gradient * float(s.squat_dive) + c.get("suspension.squat_gradient", 0.0)
        dive = s.dive_gradient * float(s.squat_dive) + c.get("suspension.dive_gradient", 0.0)
        nose_up = squat * np.maximum(along, 0.0) + dive * np.minimum(along, 0.0)
        rate = self.rate if self.measured is None else self.measured
        found["gyro_x"] = rate[:, 0] - np.gradient(roll * across, STEP_S)
        found["gyro_y"] = rate[:, 1] + np.gradient(nose_up, STEP_S)
        if self.f.drive.has("yaw_rate"):
            found["gyro_z"] = self.r - self.f._scalar("yaw_rate", self.changes)

    def _slow(self, x: Array) -> Array:
        return np.asarray(np.convolve(x, SMOOTHER, "same"))

    def vehicle(self, found: dict[str, Array]) -> None:
        """What the vehicle's own sensors say beside each other."""
        f, drive = self.f, self.f.drive
        if drive.has("lateral_accel") and self.f.has_turning:
            found["lateral_accel"] = f._scalar("lateral_accel", self.changes) - self.force[:, 1]
        if drive.has("wheel_speeds"):
            own = np.array(f.model.wheel_speeds.scale)
            # Wheels and speed come of one unit, and are late together.
            late = age(f.model, "wheel_speeds") + self.changes.get("speed.delay_s", 0.0)
            wheels = f._raw("wheel_speeds", late) / (1.0 + own)
            # Tyres that are smaller than stated make wheels and speed too fast alike.
            scale = 1.0 + self.changes.get("wheel_speeds.scale", 0.0)
            scale *= 1.0 + self.changes.get("speed.scale", 0.0)
            found["speed"] = np.abs(self.v) - wheels[:, 2:].mean(axis=1) / scale
        if drive.has("steering") and f.has_turning:
            found["yaw_rate"] = self._yaw_rate() - self._by_steering()

    def _yaw_rate(self) -> Array:
        if self.f.drive.has("yaw_rate"):
            return self.f._scalar("yaw_rate", self.changes)
        return np.asarray(self.r)

    def _by_steering(self) -> Array:
        """Single track, quasi-static and late by its lag: r = v (delta - K (f_y - v r))/(L + K v^2)
        (Rajamani, Vehicle Dynamics and Control, ch. 2, 3)."""
        f, c = self.f, self.f.model.chassis
        ratio = c.steering_ratio + self.changes.get("chassis.steering_ratio", 0.0)
        gradient = c.understeer_gradient + self.changes.get("chassis.understeer_gradient", 0.0)
        v = np.abs(self.v)
        steer = f._scalar("steering", self.changes)
        steer = np.interp(f.t - self._lag(v, gradient), f.t, steer)
        leaning = self.force[:, 1] - self.v * self.r
        turn = np.tan(np.clip(steer / ratio, -1.2, 1.2)) - gradient * self._slow(leaning)
        return np.asarray(self.v * turn / np.maximum(c.wheelbase_m + gradient * v * v, 0.3))

    def _lag(self, v: Array, gradient: float) -> Array:
        """From steering to yaw rate: 2 zeta/omega - T_z of the single track, and the tyres' [s]."""
        c = self.f.model.chassis
        rear, length, m = c.rear_cornering_stiffness_npr, c.wheelbase_m, c.mass_kg
        a, b, inertia = c.cg_to_front_m, c.cg_to_rear_m, c.yaw_inertia_kgm2
        front = b / max(gradient * length / m + a / rear, 1e-9)
        v = np.maximum(v, SLOW_MPS)
        damping = (front + rear) / (m * v) + (a * a * front + b * b * rear) / (inertia * v)
        square = front * rear * length * (length + gradient * v * v) / (m * inertia * v * v)
        return np.asarray(damping / square - m * a * v / (rear * length) + RELAXATION_S)


def _is_gain(key: str) -> bool:
    return key.startswith(("accel.scale", "accel.cross_axis"))


SMOOTHER = np.ones(SMOOTH_STEPS) / SMOOTH_STEPS


def _from_middle(x: Array) -> Array:
    """Integral from the middle of each block; (B, n), trapezoids."""
    area = np.cumsum(0.5 * (x[:, 1:] + x[:, :-1]), axis=1) * STEP_S
    area = np.concatenate([np.zeros_like(x[:, :1]), area], axis=1)
    made: Array = area - area[:, x.shape[1] // 2, None]
    return made


def steps_of(model: VehicleModel, key: str, size: float) -> float:
    """By how much a parameter is moved for its column: its tolerance, never nothing."""
    return size if math.isfinite(size) and size > 0.0 else max(abs(value(model, key)), 1e-3) * 1e-2
