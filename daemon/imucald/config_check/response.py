"""The response of an accelerometer to changes of speed and to turns: the direction forward, and the
delay and scale of the speed.

`check` asks it of the configured speed, `init` of each signal that may be a speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.config.base import MIN_SPEED_DELAY
from imucald.config_check.motion import shifted
from imucald.config_check.relation import MIN_VALUES, Relation, relation
from imucald.core.arrays import Array
from imucald.core.rotations import levelling_rotation
from imucald.motion.ticks import TICK_S

LATEST = 2.5
"""Largest delay of the speed at which its scale is judged [s]. Such a delay occurs if a GNSS
receiver smooths its speed, is polled once per second, and its answer waits."""
DELAYS = range(round(MIN_SPEED_DELAY / TICK_S), round(LATEST / TICK_S) + 1)
"""Tried delays of a speed or a course [ticks of 0.1 s]."""
COARSE = 3
"""Step of the first search for the delay [ticks]. The signals are means over a longer time, so
their correlation changes slowly with the delay."""


@dataclass(frozen=True, eq=False)
class Response:
    """The response of the horizontal force, in the axes of the sensor.

    along: (3,) per unit of the change of speed. across: (3,) per unit of speed times yaw rate; zero
    if turns are not known. relation: relation of the force along `along`, without turns, to the
    change of speed. delay: delay of the speed [ticks of 0.1 s].
    """

    along: Array
    across: Array
    relation: Relation
    delay: int

    @property
    def gain(self) -> float:
        """Force along `along` per unit of the change of speed; 1 if both have the right unit."""
        return float(np.linalg.norm(self.along))

    @property
    def forward(self) -> Array:
        """Direction forward: unit vector (3,)."""
        return np.asarray(self.along / self.gain)


def response(
    accel: Array, up: Array, change: Array, others: Array | None = None
) -> Response | None:
    """Fit the horizontal force with the change of speed, at the delay of the speed that explains it
    best. None if too few values are known.

    accel: (n, 3). up: unit vector (3,) in the same axes. change: (n,), in any unit of speed per
    second. others: (n, k), further columns of the fit; the first is speed times yaw rate.
    """
    level = levelling_rotation(up)[:2]
    force = accel @ level.T
    others = np.zeros((len(change), 0)) if others is None else others

    def explained(delay: int) -> float:
        return _fit(force, shifted(change, delay), others)[0]

    at = max(DELAYS[::COARSE], key=explained)
    near = range(max(at - COARSE + 1, DELAYS.start), min(at + COARSE, DELAYS.stop))
    at = max(near, key=explained)
    change = shifted(change, at)
    share, coefficients = _fit(force, change, others)
    if not share > 0.0:
        return None
    along, across = coefficients[0], coefficients[1] if len(coefficients) > 1 else np.zeros(2)
    rest = (force - others @ coefficients[1:]) @ (along / np.linalg.norm(along))
    return Response(along @ level, across @ level, relation(change, rest), at)


def _fit(force: Array, change: Array, others: Array) -> tuple[float, Array]:
    """Fit the horizontal force (n, 2) with the change of speed (n,) and other columns (n, k).

    Returns the share of the force along the vehicle that the change of speed explains, without the
    part of the other columns, and the coefficients (1 + k, 2).
    """
    columns = np.column_stack([change, others])
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(force).all(axis=1)
    if np.count_nonzero(rows) < MIN_VALUES:
        return 0.0, np.zeros((columns.shape[1], 2))
    columns, force = columns[rows], force[rows]
    columns, force = columns - columns.mean(axis=0), force - force.mean(axis=0)
    normal = np.linalg.pinv(columns.T @ columns, hermitian=True)
    coefficients = np.asarray(normal @ (columns.T @ force))
    change, along = columns[:, 0], coefficients[0]
    rest = (force - columns[:, 1:] @ coefficients[1:]) @ along
    sizes = float(rest @ rest) * float(change @ change)
    return float(rest @ change) ** 2 / sizes if sizes > 0.0 else 0.0, coefficients
