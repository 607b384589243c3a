"""How a gyroscope's axes lie to an accelerometer's: which is which, sign and unit.

Two facts tell, whatever the mount. In turns speed times the rate about up is the acceleration to
the left. And while the body pitches and rolls, gravity moves through the accelerometer's axes as
the gyroscope says: g' = -omega x g. Each of the 48 ways to name and sign three axes is held against
both, by likelihood; offsets, and acceleration that goes with speed, are fitted and do not count.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from imucald.config_check.motion import SMOOTH, shifted, smooth
from imucald.discovery.candidates import Array
from imucald.discovery.evidence import BELIEVED_NATS, Relation, relation
from imucald.discovery.reference import Reference
from imucald.discovery.triads import Triad
from imucald.motion.ticks import TICK_RATE

WINDOW = 10
"""Ticks over which gravity's change is compared: a second, a pitching body's time."""
STEADY_UP = 0.97
"""Mean resultant length of the force's direction from which gravity is one direction: a vehicle's
slopes and manoeuvres keep within 15 deg of it."""

Order = tuple[tuple[int, int, int], tuple[int, int, int]]
"""Which gyroscope axis is x, y, z, and their signs."""

AS_IT_IS: Order = ((0, 1, 2), (1, 1, 1))


@dataclass(frozen=True)
class GyroFit:
    """The likeliest order of a gyroscope's axes among `tried`, and what supports it.

    nats: log likelihood of each order, relative to none. turning: of the acceleration to the left
    against speed times rate; carried: of gravity's change against the rates.
    """

    order: Order
    nats: dict[Order, float]
    turning: Relation
    carried: Relation

    def ahead(self, orders: list[Order]) -> float:
        """Nats by which the order is ahead of the best other one of some orders."""
        others = [self.nats[o] for o in orders if o != self.order]
        return self.nats[self.order] - max(others, default=-math.inf)

    @property
    def is_believed(self) -> bool:
        """Whether the rates go with the accelerometer at all."""
        return self.turning.is_believed or self.carried.is_believed


def every_order() -> list[Order]:
    """All 48 orders and signs."""
    signs = list(itertools.product((1, -1), repeat=3))
    return [(p, s) for p in itertools.permutations((0, 1, 2)) for s in signs]  # type: ignore[misc]


def right_handed_orders() -> list[Order]:
    """The three cyclic orders, and the same with all signs turned round."""
    cyclic = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    return [(p, s) for p in cyclic for s in ((1, 1, 1), (-1, -1, -1))]


def signed(gyro: Array, order: Order) -> Array:
    """(n, 3) rates in another order."""
    return gyro[:, list(order[0])] * np.array(order[1], np.float64)


def fit_gyroscope(gyro: Triad, reference: Reference, tried: list[Order]) -> GyroFit | None:
    """Hold a gyroscope's axes against the accelerometer; None where there is nothing to hold."""
    accelerometer, up = reference.accelerometer, reference.up
    if accelerometer is None or up is None:
        return None
    rates = gyro.ticks
    orders = every_order()
    turning = _turning(gyro.smooth, reference, orders)
    carried, carried_relation = _carried(rates, accelerometer, reference, orders)
    nats = {o: turning.get(o, (0.0, Relation()))[0] + carried.get(o, 0.0) for o in orders}
    best = max(tried, key=lambda o: nats[o])
    return GyroFit(best, nats, turning.get(best, (0.0, Relation()))[1], carried_relation(best))


def _turning(
    gyro: Array, reference: Reference, orders: list[Order]
) -> dict[Order, tuple[float, Relation]]:
    """Log likelihood of each order from turns."""
    if reference.lateral is None or reference.speed is None or reference.up is None:
        return {}
    v = reference.speed.moving
    found = {}
    for order in orders:
        rate = signed(gyro, order) @ reference.up
        one = relation(v * rate, reference.lateral)
        part = max(one.correlation, 0.0) ** 2
        found[order] = (-0.5 * one.independent * math.log1p(-min(part, 1.0 - 1e-12)), one)
    return found


def _carried(gyro: Array, accelerometer: Triad, reference: Reference, orders: list[Order]):  # type: ignore[no-untyped-def]
    """Log likelihood of each order from gravity's movement through the axes."""
    force = accelerometer.smooth
    gravity = np.broadcast_to(np.nanmean(force, axis=0), force.shape)
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    if np.linalg.norm(np.nanmean(direction, axis=0)) < STEADY_UP:
        gravity = force
    target = shifted(force, WINDOW) - force
    nuisance = []
    if reference.speed is not None:
        nuisance.append(_windowed(reference.speed.change))
        if reference.turn is not None:
            nuisance.append(_windowed(reference.speed.speed * reference.turn))
    terms = np.empty((3, 3), object)
    for i in range(3):
        for p in range(3):
            unit = np.eye(3)[p]
            turned = -np.cross(unit, gravity) * gyro[:, [i]]
            terms[i, p] = _integrated(turned)
    rows = np.isfinite(target).all(axis=1)
    for extra in nuisance:
        rows &= np.isfinite(extra)
    for term in terms.flat:
        rows &= np.isfinite(term).all(axis=1)
    count = int(np.count_nonzero(rows))
    if count < 20 * (WINDOW + SMOOTH):
        return {}, lambda order: Relation()
    known = np.column_stack([np.ones(count), *(extra[rows] for extra in nuisance)])
    basis = np.linalg.qr(known)[0]

    def left_over(x: Array) -> Array:
        y = x[rows]
        return np.asarray(y - basis @ (basis.T @ y))

    goal = left_over(target)
    parts = {(i, p): left_over(terms[i, p]) for i in range(3) for p in range(3)}
    independent = count / (WINDOW + SMOOTH) * 2.0
    total = float((goal * goal).sum())
    projected = {k: float((goal * v).sum()) for k, v in parts.items()}
    gram = {(a, b): float((parts[a] * parts[b]).sum()) for a in parts for b in parts}
    nats, relations = {}, {}
    for order in orders:
        keys = [((axis, p), sign) for p, (axis, sign) in enumerate(zip(*order, strict=True))]
        dot = sum(sign * projected[k] for k, sign in keys)
        size = sum(s * z * gram[k, q] for k, s in keys for q, z in keys)
        part = max(dot, 0.0) ** 2 / (size * total) if size > 0.0 and total > 0.0 else 0.0
        part = min(part, 1.0 - 1e-12)
        nats[order] = -0.5 * independent * math.log1p(-part)
        low = dot / size if size > 0.0 else 0.0
        root = math.copysign(math.sqrt(dot * dot / (size * total)), dot) if size * total else 0.0
        high = total / dot if dot > 0.0 else 0.0
        relations[order] = Relation(root, independent, max(low, 0.0), high)
    return nats, relations.__getitem__


def _windowed(x: Array) -> Array:
    return np.asarray(shifted(x, WINDOW) - x)


def _integrated(rate: Array) -> Array:
    """Change over a window of what goes by a rate (n, 3) [1/s], smoothed as the force is."""
    known = np.where(np.isfinite(rate), rate, 0.0)
    whole = smooth(np.cumsum(known, axis=0) / TICK_RATE)
    return np.where(np.isfinite(rate), shifted(whole, WINDOW) - whole, np.nan)


def is_decided(fit: GyroFit, orders: list[Order]) -> bool:
    """Whether an order is ahead of some others beyond doubt."""
    return fit.ahead(orders) >= BELIEVED_NATS
