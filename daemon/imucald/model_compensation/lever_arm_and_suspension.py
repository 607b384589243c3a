"""Remove the terms that need the mount from corrected samples. The result is samples in road axes.

Lever arm: the force at the body's centre of rotation is the force at the sensor minus dw/dt x l + w
x (w x l). Only the vertical component of dw/dt is used (see `filters`). Suspension: the
corrected samples are rotated from body axes to road axes, and the body's angular rate relative to
the road is subtracted from the rates (see `filters`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.model.section import Vector3
from imucald.model_compensation.filters import (
    GAP_S,
    UPRIGHT,
    SuspensionAttitude,
    SuspensionFilter,
    YawAcceleration,
)
from imucald.model_compensation.terms import Terms

Number = TypeVar("Number", float, Array)

STALE_S = 0.25
"""Age of an angular rate above which it is not used for the present force [s]."""
Turning = tuple[float, Vector3, float]
"""Time [s], angular rate [rad/s] and yaw acceleration [rad/s^2], in vehicle axes."""
NO_TURNING: Turning = (-math.inf, (0.0, 0.0, 0.0), 0.0)


@dataclass(frozen=True, eq=False)
class Corrected:
    """Corrected samples of one channel, as columns.

    order: (N,) order of arrival, ascending; samples with equal numbers came in one frame. t: (N,)
    [s]. values: (N, 3) in vehicle axes; NaN if the mount is not known.
    """

    order: NDArray[np.int64] | Array
    t: Array
    values: Array


class VehicleCorrection:
    """Removes the effects of lever arm and suspension from corrected samples.

    In one frame, the gyroscope is processed first and the accelerometer last. rates: channels that
    are angular rates.
    """

    def __init__(
        self, terms: Terms, suspension: bool = True, rates: Collection[str] = ("gyro",)
    ) -> None:
        self._arm = terms.lever_arm
        self._levers = any(terms.lever_arm)
        self._leans = suspension and not terms.suspension.neutral
        self._rates = frozenset(rates)
        self._yaw = YawAcceleration()
        self._turning = NO_TURNING
        self._suspension = SuspensionFilter(terms.suspension)

    @property
    def neutral(self) -> bool:
        """True if the correction changes no sample."""
        return not (self._levers or self._leans)

    def gap(self) -> None:
        """Restart the filters after a jump of time."""
        self._yaw.restart()
        self._turning = NO_TURNING
        self._suspension.restart()

    # one frame -----------------------------------------------------------------------------

    def frame(self, t: float, turned: dict[str, Vector3 | None]) -> dict[str, Vector3 | None]:
        """Correct the samples of one frame at stream time t [s]. A sample of None means that the
        mount is not known."""
        out: dict[str, Vector3 | None] = {}
        if "gyro" in turned and self._levers:
            self._turn(t, turned["gyro"])
        for channel, v in turned.items():
            if channel != "accel":
                out[channel] = v if v is None else self._on_road(t, channel, v)
        if "accel" in turned:
            v = turned["accel"]
            if v is None:
                self._suspension.restart()
            else:
                v = self._accel(t, v)
            out["accel"] = v
        return out

    def _turn(self, t: float, rate: Vector3 | None) -> None:
        if rate is None:
            self._yaw.restart()
            self._turning = NO_TURNING
        else:
            self._turning = t, rate, self._yaw.push(t, rate[2])

    def _accel(self, t: float, v: Vector3) -> Vector3:
        x, y, z = v
        if self._levers:
            when, (p, q, r), change = self._turning
            if t - when <= STALE_S:
                a, b, c = carried(self._arm, p, q, r, change)
                x, y, z = x - a, y - b, z - c
        if self._leans:
            self._suspension.push(t, x, y)
            return on_road(self._suspension.attitude, x, y, z)
        return x, y, z

    def _on_road(self, t: float, channel: str, v: Vector3) -> Vector3:
        if not self._leans:
            return v
        lean = self._suspension.at(t)
        return on_road(lean, *(less_suspension_rate(lean, *v) if channel in self._rates else v))

    # columns -------------------------------------------------------------------------------

    def columns(self, turned: Mapping[str, Corrected]) -> dict[str, Array]:
        """Correct columns (N, 3). The results are bit-equal to the results of `frame`."""
        accel = turned.get("accel")
        forces = None if accel is None else [accel.values[:, i] for i in range(3)]
        if self._levers:
            turnings = self._turnings(turned.get("gyro"))
            if accel is not None and forces is not None:
                forces = self._less_lever(accel, forces, turnings)
        out: dict[str, Array] = {}
        if not self._leans:
            out = {channel: one.values for channel, one in turned.items()}
            if forces is not None:
                out["accel"] = np.stack(forces, axis=1)
            return out
        times = np.array([self._suspension.t, *(() if accel is None else accel.t)])
        leans = np.array(self._leans_of(accel, forces))
        order = np.zeros(0) if accel is None else accel.order
        for channel, one in turned.items():
            if channel == "accel" and forces is not None:
                lean, axes = leans[1:], forces
            else:
                last = np.searchsorted(order, one.order, side="left")
                fresh = one.t - times[last] <= GAP_S
                lean = np.where(fresh[:, None], leans[last], UPRIGHT)
                axes = [one.values[:, i] for i in range(3)]
            now: tuple[Array, Array, Array, Array] = (
                lean[:, 0], lean[:, 1], lean[:, 2], lean[:, 3],
            )  # fmt: skip
            x, y, z = axes
            if channel in self._rates:
                x, y, z = less_suspension_rate(now, x, y, z)
            out[channel] = np.stack(on_road(now, x, y, z), axis=1)
        return out

    def _turnings(self, gyro: Corrected | None) -> tuple[NDArray[np.int64] | Array, Array]:
        """Return the order of the gyroscope samples, and rows (M + 1, 5) of time, rates and yaw
        acceleration. The first row is the last row of the previous call."""
        when, rate, change = self._turning
        rows = [(when, *rate, change)]
        if gyro is None:
            return np.zeros(0), np.array(rows)
        push = self._yaw.push
        for t, (p, q, r) in zip(gyro.t.tolist(), gyro.values.tolist(), strict=True):
            change = push(t, r)
            rows.append((-math.inf if math.isnan(r) else t, p, q, r, change))
        t, p, q, r, change = rows[-1]
        self._turning = NO_TURNING if math.isnan(r) else (t, (p, q, r), change)
        return gyro.order, np.array(rows)

    def _less_lever(
        self,
        accel: Corrected,
        forces: list[Array],
        turnings: tuple[NDArray[np.int64] | Array, Array],
    ) -> list[Array]:
        order, rows = turnings
        known = rows[np.searchsorted(order, accel.order, side="right")]
        fresh = accel.t - known[:, 0] <= STALE_S
        taken = carried(self._arm, known[:, 1], known[:, 2], known[:, 3], known[:, 4])
        return [np.where(fresh, f - c, f) for f, c in zip(forces, taken, strict=True)]

    def _leans_of(
        self, accel: Corrected | None, forces: list[Array] | None
    ) -> list[SuspensionAttitude]:
        """Return the attitude of the body before the first force and after each force."""
        found = [self._suspension.attitude]
        if accel is not None and forces is not None:
            push = self._suspension.push
            x, y = forces[0].tolist(), forces[1].tolist()
            found += [push(t, a, b) for t, a, b in zip(accel.t.tolist(), x, y, strict=True)]
        return found


def carried(
    arm: Vector3, p: Number, q: Number, r: Number, change: Number
) -> tuple[Number, Number, Number]:
    """Return the additional force at the end of the arm [m] relative to its begin [m/s^2], from
    rates [rad/s] and dr/dt."""
    lx, ly, lz = arm
    along = p * lx + q * ly + r * lz
    square = p * p + q * q + r * r
    return (
        p * along - square * lx - change * ly,
        q * along - square * ly + change * lx,
        r * along - square * lz,
    )


def on_road(
    lean: tuple[Number, Number, Number, Number], x: Number, y: Number, z: Number
) -> tuple[Number, Number, Number]:
    """Rotate a vector from body axes to road axes: R_y(pitch) R_x(roll), for small angles."""
    roll, pitch = lean[0], lean[1]
    s, c = roll - roll * roll * roll / 6.0, 1.0 - 0.5 * (roll * roll)
    y, z = c * y - s * z, s * y + c * z
    s, c = pitch - pitch * pitch * pitch / 6.0, 1.0 - 0.5 * (pitch * pitch)
    return c * x + s * z, y, c * z - s * x


def less_suspension_rate(
    lean: tuple[Number, Number, Number, Number], x: Number, y: Number, z: Number
) -> tuple[Number, Number, Number]:
    """Return rates in body axes minus the body's angular rate relative to the road."""
    roll, _, roll_rate, pitch_rate = lean
    return x - roll_rate, y - pitch_rate, z + pitch_rate * roll
