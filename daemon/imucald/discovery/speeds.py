"""Choose the vehicle's speed among several speeds.

A speedometer may show up to 10 % plus 4 km/h too much (UN Regulation 39). The changes of its speed
appear in the accelerometer as clearly as the changes of the true speed. Only the wheel speeds show
which of the speeds is the true speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucald.config_check.relation import is_better, relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import choose_unit
from imucald.discovery.names import hint
from imucald.discovery.reference import SpeedFit, stated_unit
from imucald.discovery.scalars import SAME_MOTION

NEAR_WHEELS = 0.04
"""Largest relative difference between a speed and the mean wheel speed (worn and wrong tyres,
slip)."""
ONE_UNIT = 0.2
"""Largest relative difference between a speed and the wheel speeds at which both have the same
unit."""


def wheel_mean(wheels: Sequence[SeenSignal] | None) -> Array | None:
    """Return the mean wheel speed (n,) [m/s]; None if the wheels state no unit."""
    unit = stated_unit(wheels[0], "speed") if wheels else None
    if unit is None or wheels is None:
        return None
    return np.asarray(np.column_stack([c.smooth for c in wheels]).mean(axis=1) * unit.factor)


def apart_from(fit: SpeedFit, mean: Array) -> float:
    """Return the relative difference between a speed and the mean wheel speed (rms)."""
    own = np.abs(fit.candidate.smooth * fit.unit.factor)
    rows = np.isfinite(own) & np.isfinite(mean)
    if np.count_nonzero(rows) < 50 or not mean[rows].any():
        return np.inf
    return float(np.sqrt(((own - mean)[rows] ** 2).mean() / (mean[rows] ** 2).mean()))


def best_first(fits: list[SpeedFit], mean: Array | None) -> list[SpeedFit]:
    """Sort speeds: speeds near the wheel speeds first, then stated units, then the best explanation
    of the accelerations.

    If two speeds differ only by chance, a speed with a name of a speed is first, then the speed
    with the shorter cycle. Signals without a unit are kept only if they explain most of the motion.
    """
    fits = [f if mean is None else _in_wheels_unit(f, mean) for f in fits]
    fits = [f for f in fits if f.unit.is_stated or f.relation.explained >= SAME_MOTION]

    def rank(f: SpeedFit) -> tuple[bool, bool]:
        return mean is not None and apart_from(f, mean) > NEAR_WHEELS, not f.unit.is_stated

    fits = sorted(fits, key=lambda f: (*rank(f), -f.relation.explained))
    if not fits:
        return fits
    first = fits[0]
    equal = [
        f for f in fits if rank(f) == rank(first) and not is_better(first.relation, f.relation)
    ]
    equal.sort(key=lambda f: (hint("speed", f.candidate) is None, f.candidate.cycle))
    return equal + [f for f in fits if f not in equal]


def _in_wheels_unit(fit: SpeedFit, mean: Array) -> SpeedFit:
    """Return a speed without a unit, with the unit that makes it equal to the wheel speed."""
    if fit.unit.is_stated:
        return fit
    found = relation(mean, fit.candidate.smooth)
    if not found.low > 0.0:
        return fit
    low, high = (1.0 - ONE_UNIT) / found.gain, (1.0 + ONE_UNIT) / found.gain
    unit = choose_unit("", "speed", low, high)
    if unit is None:
        return fit
    as_wheels = replace(fit, unit=replace(unit, others=()))
    return as_wheels if apart_from(as_wheels, mean) < ONE_UNIT else fit


def speed_doubt(fits: list[SpeedFit], mean: Array | None) -> str:
    """Return the reason why the first of several speeds is not sure; empty if it is sure."""
    best = fits[0]
    if best.unit.doubt:
        return best.unit.doubt
    if mean is not None:
        apart = apart_from(best, mean)
        if apart > ONE_UNIT:
            return "the wheel speeds differ from it"
        return "" if best.unit.is_stated or apart < NEAR_WHEELS else "no unit is stated"
    if not best.unit.is_stated and best.relation.explained < 0.5:
        return "the database states no unit, and half of the accelerations do not fit"
    own = np.abs(best.candidate.smooth * best.unit.factor)
    for other in fits[1:]:
        apart = apart_from(other, own)
        if NEAR_WHEELS < apart < 2.0 * ONE_UNIT and not is_better(best.relation, other.relation):
            return f"{other.candidate.path} differs from it by {100 * apart:.0f} % and fits as well"
    return ""
