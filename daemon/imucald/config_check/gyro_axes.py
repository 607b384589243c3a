"""Find the relation between the axes of a gyroscope and the axes of an accelerometer: order, signs
and unit.

Two facts show this relation for any mount. In turns, speed times the rate about the vertical is the
acceleration to the left. While the body pitches and rolls, gravity moves in the accelerometer's
axes with g' = -omega x g. Each order of the axes of a right-handed sensor is compared with both
facts, by likelihood. Offsets and accelerations due to the speed are fitted, so they have
no effect. `fit_gyroscope` is for `init`, which does not know the unit.

`tilt_ratio` judges axes in a known unit, with the judge of the daemon (`mount.log_ratios`)
over the whole recording. `check` asks it about the configured axes, `init` about the axes that it
found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucald.config_check.finding import Finding
from imucald.config_check.motion import SMOOTH, Motion, shifted, smooth
from imucald.config_check.relation import BELIEVED_NATS, Relation, relation
from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_RATE
from imucald.mount.contradictions import MOVING
from imucald.mount.log_ratios import MOST, TO_ACCUSE, TO_BE_FINE, TRIED, gyro_energies, ratios_of
from imucald.mount.signal_blocks import BLOCK_TICKS

WINDOW = 10
"""Window in which the change of gravity is compared [ticks of 0.1 s]: one second, the time scale of
pitching."""
STEADY_UP = 0.97
"""Smallest mean resultant length of the force's direction at which gravity counts as constant in
sensor axes. With slopes and manoeuvres, the direction in a vehicle stays within 15 deg."""

TILTS_DIFFERENTLY = (
    "does not tilt as the accelerometer does: one axis of the gyroscope or of the accelerometer "
    "has the wrong sign, two axes are exchanged, or the sensor moves in its holder"
)

Order = tuple[tuple[int, int, int], int]
"""Which gyroscope axes are x, y, z, and the sign of all axes."""

AS_IT_IS: Order = ((0, 1, 2), 1)
CYCLIC = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
RIGHT_HANDED: tuple[Order, ...] = tuple((axes, sign) for axes in CYCLIC for sign in (1, -1))
"""The orders of axes of a right-handed sensor, also with all signs reversed. A left-handed
gyroscope cannot be distinguished from a left-handed accelerometer."""


@dataclass(frozen=True)
class GyroFit:
    """The most likely order of a gyroscope's axes among those that were tried, with its evidence.

    nats: log likelihood of each right-handed order, relative to no relation. turning: relation
    between the acceleration to the left and speed times rate. carried: relation between the change
    of gravity and the rates.
    """

    order: Order
    nats: dict[Order, float]
    turning: Relation
    carried: Relation

    def is_decided(self, orders: Sequence[Order]) -> bool:
        """True if the order is certainly more likely than the other orders in `orders`."""
        others = [self.nats[o] for o in orders if o != self.order]
        return self.nats[self.order] - max(others, default=-math.inf) >= BELIEVED_NATS

    @property
    def is_believed(self) -> bool:
        """True if the rates are certainly related to the accelerometer."""
        return self.turning.is_believed or self.carried.is_believed


def signed(gyro: Array, order: Order) -> Array:
    """Return the rates (n, 3) in another order of axes, with its sign."""
    return order[1] * gyro[:, list(order[0])]


def fit_gyroscope(gyro: Array, motion: Motion, tried: Sequence[Order]) -> GyroFit | None:
    """Compare a gyroscope's axes with the accelerometer; None if there is no accelerometer.

    gyro: rates (n, 3) at ticks, in any unit. motion: its speed has no delay.
    """
    if motion.accel is None or motion.up is None:
        return None
    turning, carried = _turning(smooth(gyro), motion), _carried(gyro, motion)
    of_turns = {order: _nats(turning[order]) for order in RIGHT_HANDED}
    nats = {order: of_turns[order] + _nats(carried[order]) for order in RIGHT_HANDED}
    # the mount is found from turns, so gravity decides only between orders that fit the turns
    most = max(of_turns[order] for order in tried)
    open_ones = [order for order in tried if of_turns[order] > most - BELIEVED_NATS]
    best = max(open_ones, key=lambda order: nats[order])
    return GyroFit(best, nats, turning[best], carried[best])


def _nats(found: Relation) -> float:
    """Return the log likelihood of a relation with any positive gain, relative to no relation."""
    part = max(found.correlation, 0.0) ** 2
    return -0.5 * found.independent * math.log1p(-min(part, 1.0 - 1e-12))


def _of_orders(found: Iterable[Relation]) -> dict[Order, Relation]:
    """Return the relation of each right-handed order, from the relations of the cyclic orders."""
    return {
        (axes, sign): replace(one, correlation=sign * one.correlation)
        for axes, one in zip(CYCLIC, found, strict=True)
        for sign in (1, -1)
    }


def _turning(gyro: Array, motion: Motion) -> dict[Order, Relation]:
    """Compare speed times rate about the vertical with the acceleration to the left."""
    lateral, v, up = motion.lateral, motion.moving, motion.up
    if lateral is None or v is None or up is None:
        return _of_orders([Relation()] * len(CYCLIC))
    return _of_orders(relation(v * (gyro[:, list(axes)] @ up), lateral) for axes in CYCLIC)


def _carried(gyro: Array, motion: Motion) -> dict[Order, Relation]:
    """Compare the changes of gravity in windows of a second with the rates."""
    force = motion.accel
    assert force is not None, "asked before"
    gravity = _gravity(force)
    target = shifted(force, WINDOW) - force
    moved = _accelerations(motion)
    predicted = [_integrated(np.cross(gravity, gyro[:, list(axes)])) for axes in CYCLIC]
    rows = np.isfinite(np.column_stack([target, moved, *predicted])).all(axis=1)
    count = int(np.count_nonzero(rows))
    if count < 20 * (WINDOW + SMOOTH):
        return _of_orders([Relation()] * len(CYCLIC))
    basis = np.linalg.qr(np.column_stack([np.ones(count), moved[rows]]))[0]
    target, *predicted = (x[rows] - basis @ (basis.T @ x[rows]) for x in (target, *predicted))
    independent = 2.0 * count / (WINDOW + SMOOTH)  # two horizontal axes in each window
    return _of_orders(_held_against(target, one, independent) for one in predicted)


def _gravity(force: Array) -> Array:
    """Return gravity in sensor axes (n, 3): constant for a sensor in a vehicle, the force itself
    for a sensor in a hand."""
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    if np.linalg.norm(np.nanmean(direction, axis=0)) < STEADY_UP:
        return force
    return np.broadcast_to(np.nanmean(force, axis=0), force.shape)


def _accelerations(motion: Motion) -> Array:
    """Return the changes (n, k) of accelerations due to the speed in a window. k is 0 without a
    speed."""
    known = []
    if motion.speed is not None and motion.change is not None:
        known.append(_windowed(motion.change))
        if motion.turn is not None:
            known.append(_windowed(motion.speed * motion.turn))
    rows = 0 if motion.accel is None else len(motion.accel)
    return np.column_stack(known) if known else np.zeros((rows, 0))


def _held_against(target: Array, predicted: Array, independent: float) -> Relation:
    """Return the relation of a predicted change of gravity (m, 3) to the change (m, 3)."""
    dot, size = float((target * predicted).sum()), float((predicted * predicted).sum())
    total = float((target * target).sum())
    if not (size > 0.0 and total > 0.0 and dot != 0.0):
        return Relation()
    root = max(min(dot / math.sqrt(size * total), 1.0 - 1e-9), 1e-9 - 1.0)
    return Relation(root, independent, abs(dot) / size, total / abs(dot))


def _windowed(x: Array) -> Array:
    return np.asarray(shifted(x, WINDOW) - x)


def _integrated(rate: Array) -> Array:
    """Integrate a rate (n, 3) [1/s] over a window, with the same smoothing as the force."""
    known = np.where(np.isfinite(rate), rate, 0.0)
    whole = smooth(np.cumsum(known, axis=0) / TICK_RATE)
    return np.where(np.isfinite(rate), shifted(whole, WINDOW) - whole, np.nan)


def tilt_findings(motion: Motion) -> Iterator[Finding]:
    """Check that gyroscope and accelerometer show the same changes of the vertical's direction."""
    ratio = tilt_ratio(motion)
    if ratio is None:
        return
    if ratio < -TO_ACCUSE:
        yield Finding("error", "gyroscope", TILTS_DIFFERENTLY)
    elif ratio > TO_BE_FINE:
        yield Finding("ok", "gyroscope", "tilts as the accelerometer does")
    elif motion.standing is None:
        text = (
            "not checked: the sign of each axis of the gyroscope (the drive has no stop, so "
            "its zero error is unknown)"
        )
        yield Finding("note", "check", text)


def tilt_ratio(motion: Motion) -> float | None:
    """Return the log likelihood ratio of the gyroscope's axes to the best of `TRIED` alternatives:
    another order, or other signs. Negative: an alternative is likelier. None without evidence.

    Both sensors and the speed must be in SI, and the direction forward must be known
    (`Motion.facing`).
    """
    accel, gravity, up, forward = motion.accel, motion.gravity, motion.up, motion.forward
    if "gyro" not in motion.grid or motion.speed is None or motion.change is None:
        return None
    if accel is None or gravity is None or up is None or forward is None:
        return None
    rate = smooth(motion.grid["gyro"])
    R = np.array([forward, np.cross(up, forward), up])
    force = (accel - gravity) @ R.T
    columns = np.column_stack([force[:, :2], motion.change, motion.speed, rate])
    blocks = [
        block
        for block in np.array_split(columns, max(len(columns) // BLOCK_TICKS, 1))
        if np.isfinite(block).all() and np.abs(block[:, 3]).min() > MOVING
    ]
    if not blocks:
        return None
    zeros = _zeros(motion, rate, np.concatenate(blocks)[:, 4:], up)
    total = np.zeros(len(TRIED) - 1)
    for block in blocks:
        ahead, across = (block[:, 0] - block[:, 2]) / GRAVITY, block[:, 1] / GRAVITY
        energies = [
            gyro_energies(ahead, across, block[:, 4:] - zero, block[:, 3], R) for zero in zeros
        ]
        if len(zeros) > 1:  # of each assignment with its own zero error
            energies = [np.array([one[k] for k, one in enumerate(energies)])]
        total += np.clip(ratios_of(energies[0]), -MOST, MOST)
    return float(total.min())


def _zeros(motion: Motion, rate: Array, moving: Array, up: Array) -> list[Array]:
    """Return the gyroscope's zero error (3,) [rad/s]: the mean rate at rest.

    In a drive without a stop, the zero error is fitted for each tried assignment (order and signs)
    of its axes: the total rotation about the horizontal axes is zero in any drive, so the mean rate
    about them is the zero error. rate, moving: (n, 3), rates of the whole drive and of the judged
    part.
    """
    if motion.standing is not None:
        return [np.asarray(np.nanmean(rate[motion.standing], axis=0))]
    level = np.eye(3) - np.outer(up, up)
    return [S.T @ level @ S @ moving.mean(axis=0) for S in TRIED]
