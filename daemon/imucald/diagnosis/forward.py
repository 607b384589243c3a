"""Forward model: what a drive's signals should show, from its speed, steering and yaw rate.

Chain: inputs (speed, steering, yaw rate, corrected) -> motion -> road -> body on its springs ->
the sensor's place -> mount -> bandwidth and delay -> gain -> offset. Causes act in it through
their hooks; with every parameter at the model file's value it is the simulation's own chain,
without what the log cannot tell (road, vibration, noise).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause import STAGES, Cause, Values
from imucald.diagnosis.forward_mount import mount_of
from imucald.diagnosis.grid import Array, Track
from imucald.diagnosis.handling import Handling
from imucald.diagnosis.keys import model_value
from imucald.diagnosis.state import Spectrum, State
from imucald.model.model import VehicleModel

SIGNALS = (
    "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z",
    "yaw_rate", "lateral_accel", "longitudinal_accel",
)  # fmt: skip
"""Predicted signals; the triads along the vehicle's axes, as the model's mount has them."""
UNITS: Mapping[str, str] = {
    name: "rad/s" if name.startswith(("gyro", "yaw")) else "m/s^2" for name in SIGNALS
}
Hook = Callable[[State, Values], None]
DERIVED_HZ = 2.8
"""What is differentiated (speed, angular rates) is smoothed above: there it is mostly noise."""
SLOW_MPS = 2.5
"""Below this the steering says little about the yaw rate: tyres and play decide."""


class Forward:
    """Predicts one drive's signals for values of the causes' parameters.

    causes: in the order in which they act within a stage.
    """

    def __init__(self, track: Track, model: VehicleModel, causes: Sequence[Cause]) -> None:
        self.track, self.model = track, model
        self.causes = [cause for cause in causes if cause.parameters]
        self._handling = Handling(model.chassis)
        self._hooks = {stage: _overriding(self.causes, stage) for stage in STAGES}
        self.spectrum = Spectrum(len(track.t))
        self.R_vehicle_from_sensor = mount_of(model)
        self.names = _available(track)
        speed = track.scalars["speed"]
        self._rolling = speed * speed / (speed * speed + 1.0)
        self.measured = self._measured()
        self.usable = self._usable()

    def base(self) -> dict[str, float]:
        """Return every parameter's value in the model file."""
        return {p.key: model_value(self.model, p.key) for c in self.causes for p in c.parameters}

    def derivative(self, x: Array) -> Array:
        """Time derivative of a record of this drive (..., N)."""
        return self.spectrum.derivative(x)

    def predict(self, values: Mapping[str, float]) -> Array:
        """Predict the signals of `names`: (C, N), SI, triads in the model's vehicle axes."""
        s = State(self.track, self.model, self.spectrum)
        self._run("inputs", s, values)
        self._take_inputs(s)
        self._run("road", s, values)
        self._steer(s, values)
        self._run("motion", s, values)
        self._force(s)
        self._run("body", s, values)
        self._lean(s)
        self._run("place", s, values)
        self._run("mount", s, values)
        self._turn(s)
        self._run("response", s, values)
        self._respond(s)
        self._run("gain", s, values)
        self._run("offset", s, values)
        return self._gathered(s)

    # stages ------------------------------------------------------------------------------

    def _run(self, stage: str, s: State, values: Mapping[str, float]) -> None:
        for hook in self._hooks[stage]:
            hook(s, values)

    def _take_inputs(self, s: State) -> None:
        spectrum, track = s.spectrum, self.track
        for name, lead in s.advance.items():
            if lead == 0.0:
                continue
            shift = spectrum.delay(-lead)
            if name == "speed":
                s.speed = np.where(track.standing, 0.0, spectrum.apply(s.speed, shift))
            elif name == "steering" and s.steer is not None:
                s.steer = spectrum.apply(s.steer, shift)
            elif name == "yaw_rate" and s.yaw_in is not None:
                s.yaw_in = spectrum.apply(s.yaw_in, shift)
            elif name == "gyro" and s.gyro_in is not None:
                s.gyro_in = spectrum.apply(s.gyro_in, shift)
        R = self.R_vehicle_from_sensor
        smooth = spectrum.smooth(DERIVED_HZ)
        if s.gyro_in is not None:
            s.rate_in = spectrum.apply(R @ s.gyro_in, smooth)
        s.yaw_rate = (
            s.yaw_in
            if s.yaw_in is not None
            else (np.zeros(s.n) if s.gyro_in is None else (R @ s.gyro_in)[2])
        )
        if s.yaw_in is not None:
            s.rate_in = np.array([s.rate_in[0], s.rate_in[1], spectrum.apply(s.yaw_in, smooth)])
        sideways = self._handling.lateral_velocity(s.speed, s.yaw_rate)
        sideways += self._handling.turning_in(s.speed, sideways, s.yaw_rate, spectrum)
        s.ax = spectrum.apply(s.speed, s.spectrum.s * smooth) - s.yaw_rate * sideways
        s.ay = s.speed * s.yaw_rate + spectrum.apply(sideways, s.spectrum.s * smooth)

    def _steer(self, s: State, values: Values) -> None:
        """Yaw rate that the steering asks for: quasi-static single track, with its lag."""
        if s.steer is None:
            return
        chassis = self.model.chassis
        ratio = values.get("chassis.steering_ratio", chassis.steering_ratio)
        gradient = values.get("chassis.understeer_gradient", chassis.understeer_gradient)
        v = s.speed
        # Part of the angle holds the vehicle against the cross fall.
        angle = s.steer / ratio - gradient * GRAVITY * s.road_roll * self._rolling
        angle = np.clip(angle, -1.2, 1.2)
        # Linear as in the simulation's tyre; geometry at low speed asks for the tangent.
        turn = angle + values.get("_tyre.tangent", 0.0) * (np.tan(angle) - angle)
        wanted = v * turn / np.maximum(chassis.wheelbase_m + gradient * v * v, 0.3)
        s.yaw_from_steering = self._handling.answered(wanted, v, s.spectrum, gradient)

    def _force(self, s: State) -> None:
        """Specific force and rate at the body's reference, in road axes."""
        up = np.full(s.n, GRAVITY)
        s.force = np.array([s.ax - GRAVITY * s.road_pitch, s.ay + GRAVITY * s.road_roll, up])
        # The road's own turning, and the vertical's, about which the vehicle turns, in road axes.
        wx, wy = (s.spectrum.derivative(x) if x.any() else x for x in (s.road_roll, s.road_pitch))
        wx, wy = wx - s.road_pitch * s.yaw_rate, wy + s.road_roll * s.yaw_rate
        s.rate = np.array([wx, wy, s.yaw_rate])

    def _lean(self, s: State) -> None:
        """Turn into the body's axes; the springs' own rates are added."""
        p, r = s.lean_pitch, s.lean_roll
        sp, cp, sr, cr = np.sin(p), np.cos(p), np.sin(r), np.cos(r)
        fx, fy, fz = s.force
        x, z = cp * fx - sp * fz, cp * fz + sp * fx
        s.force = np.array([x, cr * fy + sr * z, cr * z - sr * fy])
        wx, wy, w = s.rate
        derivative = s.spectrum.derivative
        s.rate = np.array([wx + derivative(r) - p * w, wy + derivative(p) + r * w, w])
        s.at_reference = s.force

    def _turn(self, s: State) -> None:
        """Into sensor axes: the model's mount, and what causes put before it."""
        whole: Array = s.force
        rates: Array = s.rate
        for start, R in s.turns:
            turned = self.track.t >= start if start > -math.inf else None
            whole = _rotated(whole, R, turned)
            rates = _rotated(rates, R, turned)
        R_sensor_from_vehicle = self.R_vehicle_from_sensor.T
        s.accel = R_sensor_from_vehicle @ whole
        s.gyro = R_sensor_from_vehicle @ rates
        s.signals["lateral_accel"] = s.at_reference[1].copy()
        s.signals["longitudinal_accel"] = s.at_reference[0].copy()
        if s.yaw_from_steering is not None:
            s.signals["yaw_rate"] = s.yaw_from_steering

    def _respond(self, s: State) -> None:
        for name, response in s.filters.items():
            if name == "accel":
                s.accel = s.spectrum.apply(s.accel, response)
            elif name == "gyro":
                s.gyro = s.spectrum.apply(s.gyro, response)
            elif name in s.signals:
                s.signals[name] = s.spectrum.apply(s.signals[name], response)

    def _gathered(self, s: State) -> Array:
        R = self.R_vehicle_from_sensor
        accel, gyro = R @ s.accel, R @ s.gyro
        rows: list[Array] = []
        for name in self.names:
            kind, _, axis = name.rpartition("_")
            if kind == "accel" and axis in "xyz":
                rows.append(accel["xyz".index(axis)])
            elif kind == "gyro":
                rows.append(gyro["xyz".index(axis)])
            else:
                rows.append(s.signals[name])
        return np.array(rows)

    # measured -----------------------------------------------------------------------------

    def _measured(self) -> Array:
        R, track = self.R_vehicle_from_sensor, self.track
        accel = R @ track.accel
        gyro = None if track.gyro is None else R @ track.gyro
        rows: list[Array] = []
        for name in self.names:
            if name.startswith("accel_"):
                rows.append(accel["xyz".index(name[-1])])
            elif name.startswith("gyro_") and gyro is not None:
                rows.append(gyro["xyz".index(name[-1])])
            else:
                rows.append(track.scalars[name])
        return np.array(rows)

    def _usable(self) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """(C, N) rows in which a signal and what predicts it were there."""
        usable = self.track.usable
        motion = usable["speed"].copy()
        for name in ("yaw_rate",) if "yaw_rate" in usable else ("gyro",):
            if name in usable:
                motion &= usable[name]
        speed = np.abs(self.track.scalars["speed"])
        rows = []
        for name in self.names:
            triad = name[:-2]
            row = motion & usable[triad if triad in usable else name]
            if name == "yaw_rate":
                row = row & usable["steering"] & (self.track.standing | (speed > SLOW_MPS))
            rows.append(row)
        return np.array(rows)


def _rotated(
    x: Array, R: Matrix3, where: np.ndarray[tuple[int], np.dtype[np.bool_]] | None
) -> Array:
    turned: Array = R @ x
    return turned if where is None else np.where(where, turned, x)


def _overriding(causes: Sequence[Cause], stage: str) -> list[Hook]:
    """Hooks of a stage that a cause really has."""
    return [
        getattr(cause, stage)
        for cause in causes
        if getattr(type(cause), stage) is not getattr(Cause, stage)
    ]


def _available(track: Track) -> tuple[str, ...]:
    """Signals that the drive has and that something else predicts."""
    has_yaw = "yaw_rate" in track.scalars
    turning = has_yaw or track.gyro is not None
    names = ["accel_x"] + (["accel_y"] if turning else []) + ([] if track.planar else ["accel_z"])
    if track.gyro is not None:
        names += ["gyro_x", "gyro_y"] + (["gyro_z"] if has_yaw else [])
    if "steering" in track.scalars and has_yaw:
        names.append("yaw_rate")
    if turning and "lateral_accel" in track.scalars:
        names.append("lateral_accel")
    if "longitudinal_accel" in track.scalars:
        names.append("longitudinal_accel")
    return tuple(names)
