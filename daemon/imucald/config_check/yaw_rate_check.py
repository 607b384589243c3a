"""Compare all measurements of the yaw rate with each other, to check their signs and units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from imucald.config_check.finding import (
    Finding,
    gain_guess,
    is_beyond,
    sign_remedy,
    spread,
)
from imucald.config_check.relation import relation
from imucald.core.arrays import Array
from imucald.core.samples import HEADING
from imucald.mount.contradictions import UNLIKE, WRONG_UNIT

MIN_TURNING = 0.008
"""Smallest standard deviation of the yaw rate for a comparison [rad/s]: a drive with bends of a
motorway."""
MIN_TURNING_TO_FOLLOW = 0.04
"""A signal that does not show the same turns is reported only if the standard deviation of the yaw
rate is at least this [rad/s], as in city driving."""
OTHER_RATIO = 2.5
"""A larger gain of the steering angle means a wrong unit, even if steering ratio and wheelbase are
not stated. The steering ratio of a truck is up to 1.3 times the steering ratio of a car; the
wheelbase is up to twice as long."""
_STEERING = "steering_wheel_angle"
_BY_SPEED = (_STEERING, "lateral_acceleration", "accelerometer.y")
"""Measurements of the yaw rate that are computed with the speed."""


def sign_findings(
    rates: Mapping[str, Array], turned: Mapping[str, bool] = MappingProxyType({})
) -> Iterator[Finding]:
    """Compare the signs of all measurements of the yaw rate with the first measurement that shows
    turns.

    turned: for each quantity, whether the configuration reverses the signs of all its axes.
    """
    gains = _gains(rates)
    reference = next(iter(gains), "")
    for name, rate in rates.items():
        if name in gains or spread(rate) <= MIN_TURNING or not reference:
            continue
        if name == HEADING.key:  # a course may be late by more than a bend takes
            continue
        found = relation(rates[reference], rate)
        if abs(found.correlation) < UNLIKE and spread(rates[reference]) > MIN_TURNING_TO_FOLLOW:
            text = f"hardly follows {reference} in turns (correlation {found.correlation:+.2f})"
            yield Finding("error", name, text)
    yield from _signs(gains, turned)


def gain_findings(rates: Mapping[str, Array], unit_advice: Mapping[str, str]) -> Iterator[Finding]:
    """Check the gains of all measurements of the yaw rate. The reference is the median gain of
    three or more measurements, or the first of two measurements."""
    sizes = {name: abs(gain) for name, gain in _gains(rates).items()}
    middle = float(np.median(list(sizes.values()))) if len(sizes) > 2 else 1.0
    for name, size in sizes.items():
        if is_beyond(size / middle, OTHER_RATIO if name == _STEERING else WRONG_UNIT):
            others = tuple(other for other in sizes if other != name)
            guess = gain_guess(size / middle, unit_advice.get(name))
            text = f"compared with {', '.join(others)} in turns {guess}"
            if name in _BY_SPEED:
                advice = unit_advice.get("speed")
                text += "; or the unit of the speed is wrong" + (f": {advice}" if advice else "")
            yield Finding("error", name, text, others)


def _gains(rates: Mapping[str, Array]) -> dict[str, float]:
    """Return the gain of each measurement that agrees with the first measurement that shows
    turns."""
    reference, *others = [n for n, rate in rates.items() if spread(rate) > MIN_TURNING] or [""]
    gains = {reference: 1.0} if reference else {}
    for name in others:
        found = relation(rates[reference], rates[name])
        if found.is_same_motion:
            gains[name] = found.sign * found.gain
    return gains


def _signs(gains: Mapping[str, float], turned: Mapping[str, bool]) -> Iterator[Finding]:
    left = [name for name, gain in gains.items() if gain > 0.0]
    right = [name for name, gain in gains.items() if gain <= 0.0]
    if len(gains) < 2:
        return
    if not right:
        names = (f"{n} (with 'sign: -1')" if turned.get(n) else n for n in left[1:])
        text = f"has the same sign in turns as {', '.join(names)}"
        yield Finding("ok", left[0], text, tuple(left[1:]))
    elif len(left) == len(right):
        text = f"has the opposite sign of {', '.join(right)} in turns; left turns must be positive"
        yield Finding("error", left[0], text, tuple(gains))
    else:
        few, many = (left, right) if len(left) < len(right) else (right, left)
        for name in few:
            hint = _sign_hint(name)
            text = f"has the opposite sign of {', '.join(many)} in turns{hint}"
            yield Finding("error", name, text, tuple(gains))


def _sign_hint(name: str) -> str:
    if name == "wheel_speeds":
        return ": left and right may be exchanged"
    if name == "gyroscope":
        return (
            ": set 'sign: -1' on all three of its axes, or on all three axes of the "
            "accelerometer (or remove it if it is set)"
        )
    return f": {sign_remedy(name)}"
