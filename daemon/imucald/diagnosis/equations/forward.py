"""Residuals of a drive against a model file, block by block: physics without statistics.

Each equation (see `motion`) gives a residual, measured minus predicted, on the time grid. A column
of a fit is the change of the residual with a parameter, computed by a second evaluation. For
columns, the slope of the speed is the best mean of speed and accelerometer, and the sideways force
is the predicted force. A column therefore does not correlate with the noise of its own equation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import dct

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY, QUANTITIES
from imucald.diagnosis.cause_keys import Changes, age
from imucald.diagnosis.equations.motion import NONE, VehicleMotion
from imucald.diagnosis.equations.reading import Reader
from imucald.diagnosis.signals import STANDING_MPS, STEP_S, Mask
from imucald.drive.equations import slope
from imucald.drive.single_track import SLOW_MPS

STOPPING_MPS2 = 3.4
"""Deceleration that most drivers do not exceed [m/s^2] (AASHTO, Green Book: stopping sight
distance)."""
UNITS: Mapping[str, str] = {
    **{channel: row.unit for channel, row in QUANTITIES.items()},
    **{f"{name}_{axis}": QUANTITIES[name].unit for name in ("accel", "gyro") for axis in "xyz"},
}


@dataclass(frozen=True)
class Residuals:
    """Result of one evaluation. Arrays are (B, n): B blocks with n rows each."""

    of: Mapping[str, Array]
    tilt: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    """For each equation that contains gravity: the change of its residual with the two parts of the
    tilt z0."""


class Forward(Reader):
    """Residuals of one drive against a model file, block by block."""

    # evaluation ----------------------------------------------------------------------------------

    def residuals(
        self, changes: Changes, by_inertia: bool = False, added: Mapping[str, Array] = NONE
    ) -> Residuals:
        """Return measured minus predicted, for every available equation, with a changed model file.

        by_inertia: evaluate for columns, with the signals of `settle`. added: for each signal, an
        error that is added to the signal, (N,) or (N, 3) along the vehicle's axes.
        """
        motion = VehicleMotion(self, changes, by_inertia, added)
        found: dict[str, Array] = {}
        tilt: dict[str, tuple[Array, Array]] = {}
        motion.longitudinal(found, tilt)
        if self.has_turning:
            motion.lateral(found, tilt)
        if self.has_gravity:
            motion.vertical(found)
            motion.turning(found)
        motion.vehicle(found)
        return Residuals({k: motion.once(self.in_blocks, v) for k, v in found.items()}, tilt)

    def settle(self, tilt: Array, inertial: Array) -> None:
        """Choose the signals for the columns. tilt: (B, 2) tilt z0 of each block. inertial: (B,)
        share of the accelerometer in the slope of the speed."""
        self.reference = VehicleMotion(self, {}, False).reference(tilt, inertial)

    def inertial_share(
        self, base: Residuals, masks: Mapping[str, Mask], top_hz: float, tilt: Array
    ) -> Array:
        """Return the share (B,) of the accelerometer in the best slope of the speed.

        The share is the variance of the speed's own noise, divided by the variance of the
        difference between speed and accelerometer, up to a frequency. The best mean of two
        measurements is uncorrelated with their difference, and the equation contains this
        difference. tilt: (B, 2) tilt of each block, from `tilts`.
        """
        left = np.where(masks["accel_x"], _without(base, tilt)["accel_x"], 0.0)
        count = max(1, int(2.0 * self.rows * STEP_S * top_hz))
        power = (dct(left, type=2, axis=1, norm="ortho")[:, :count] ** 2).sum(axis=1) / self.rows
        # Upper limit of the mean square slope of the speed's white noise: a second difference
        # contains six times the noise variance. A spectrum of 2 s^2 T, times (2 pi f)^2, up to
        # top_hz.
        knots = self.drive.knots
        white = float(np.mean(np.diff(knots.values, 2) ** 2)) / 6.0
        noise = 2.0 * white * knots.period_s * (2.0 * np.pi) ** 2 * top_hz**3 / 3.0
        return np.asarray(np.clip(noise / np.maximum(power, 1e-30), 0.0, 1.0))

    def tilts(self, base: Residuals, masks: Mapping[str, Mask]) -> Array:
        """Return the tilt (B, 2) of each block by plain least squares."""
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

    def level(self, found: Residuals, masks: Mapping[str, Mask]) -> dict[str, Array]:
        """Return the residuals (B, n) with the tilt of each block removed."""
        return _without(found, self.tilts(found, masks))

    def yaw_rate(self) -> Array:
        """Return the yaw rate (N,) of the vehicle that the equations use [rad/s]."""
        return np.asarray(VehicleMotion(self, {}, False).r)

    def measured(self) -> dict[str, Array]:
        """Return the measured signal of each equation, without the errors that the model file
        states."""
        m = VehicleMotion(self, {}, False)
        found = {f"accel_{axis}": x for axis, x in zip("xyz", m.force, strict=True)}
        found["accel_x"] = m.as_speed_sees(m.force[0])
        if m.rate is not None:
            found |= {f"gyro_{axis}": x for axis, x in zip("xyz", m.rate, strict=True)}
        if self.has_turning:
            found["yaw_rate"] = m.yaw_rate()
        for name in ("lateral_accel", "longitudinal_accel"):
            if self.drive.has(name):
                found[name] = self.scalar(name, {})
        found["speed"] = np.abs(m.v)
        return found

    def levels(self) -> Array:
        """Return the mean of u (B, 2) over each block, computed from the forces instead of the
        gyroscope."""
        motion = VehicleMotion(self, {}, False)
        x = motion.force[0] + motion.r * motion.v_y - motion.held(motion.slopes)
        y = motion.force[1] - motion.v * motion.r - slope(motion.v_y)
        means = [self.in_blocks(part).mean(axis=1) / GRAVITY for part in (x, y)]
        return np.column_stack(means)

    def usable(self) -> dict[str, Mask]:
        """Return the rows (B, n) of each equation in which all signals of the equation were
        present."""
        there = {
            name: channel.present(self.t + self._age_or_0(name))
            for name, channel in self.drive.channels.items()
        }
        speed = self.amount_of_speed()
        drive, base = self.drive, there["accel"] & there["speed"]
        yaw = there["yaw_rate"] if drive.has("yaw_rate") else np.ones(len(self.t), dtype=bool)
        turning = there["gyro"] if drive.has("gyro") else yaw
        inertial = there["accel"] & turning
        masks = {
            "accel_x": (base & turning if self.has_turning else base)
            & self._knots_inside() & ~self._starts_or_stops(),
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
        """Return flags of the rows that are between two knots of the speed in the same block."""
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

    def _starts_or_stops(self) -> Mask:
        """Return flags of the rows in which the speed jumps from zero or to zero. Speeds below
        about 0.3 m/s are not measured (dead band), so such a jump is not an acceleration of the
        vehicle."""
        speed = self.drive.channels["speed"]
        size = np.abs(speed.values)
        stands, step = size < STANDING_MPS, np.abs(np.diff(size))
        jumps = step > STOPPING_MPS2 * np.diff(speed.t)
        k = np.flatnonzero((stands[1:] != stands[:-1]) & jumps)
        late = age(self.model, "speed") + self.model.speed.delay_rate * speed.t
        t = speed.t - late
        hit = np.zeros(len(self.t), dtype=bool)
        # A knot is a mean over one step, and a row is a mean between knots.
        first = np.searchsorted(self.t, t[k] - 2.0 * STEP_S)
        last = np.searchsorted(self.t, t[k + 1] + 2.0 * STEP_S)
        for a, b in zip(first, last, strict=True):
            hit[a:b] = True
        return hit


def _without(found: Residuals, tilt: Array) -> dict[str, Array]:
    made = dict(found.of)
    for name, (first, second) in found.tilt.items():
        made[name] = made[name] - tilt[:, :1] * first - tilt[:, 1:] * second
    return made
