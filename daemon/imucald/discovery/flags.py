"""Find reverse, brake and the sensor's temperature."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.message import Signal
from imucald.config_check.judgement import REVERSE_SPEED
from imucald.config_check.motion import SMOOTH, Motion
from imucald.config_check.relation import BELIEVED_NATS
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal, words
from imucald.discovery.names import hint, same_family
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, source_of
from imucald.discovery.reference import KnownMotion
from imucald.inputs.units import find_unit

CREEP = 0.2
BRAKING = 0.7
"""Deceleration that needs a brake [m/s^2]. Drag and engine braking cause less than about 0.6."""
COASTING = 0.3
"""Deceleration below which the brake is not in use [m/s^2]."""
ENGINE_WARM = 75.0
"""Temperature that coolant and oil exceed [degC]. Thermostats open at 80 to 95 degC."""
CLEAR_MATTHEWS = 0.6
"""Smallest Matthews correlation between a switch and braking at which the switch is the brake."""
_LEVER_WORDS = frozenset(("gear", "gang", "lever", "selector", "prnd", "getriebe", "reverse"))


def find_reverse(reference: KnownMotion, candidates: Sequence[SeenSignal]) -> Choice | None:
    """Find a value of a switch or gear lever that means reverse: the force is then opposite to the
    change of speed."""
    found = sorted(_reversing(reference, candidates), key=lambda f: -f.nats)
    sure = [f for f in found if f.nats >= BELIEVED_NATS + math.log(len(found))]
    if sure:
        best = sure[0]
        text = (
            f"when it is {best.level:g}, accelerometer and change of speed have opposite "
            f"signs (correlation {best.correlation:+.2f}); it is never on above "
            f"{REVERSE_SPEED:g} m/s"
        )
        others = [
            Alternative({"": source_of(f.candidate, equals=(f.level,))}, "the same")
            for f in sure
            if f.candidate is not best.candidate
        ]
        chosen = source_of(best.candidate, equals=(best.level,))
        return Choice("reverse", {"": chosen}, text, "", others[:MAX_ALTERNATIVES])
    return _reverse_by_name(candidates)


@dataclass(frozen=True, eq=False)
class _Level:
    """A value of a switch or gear lever. nats: log likelihood ratio of driving backwards to driving
    forwards."""

    candidate: SeenSignal
    level: float
    correlation: float
    nats: float


def _reversing(reference: KnownMotion, candidates: Sequence[SeenSignal]) -> list[_Level]:
    """Return every value that occurs only at low speed, with its likelihood ratio.

    When driving forwards, the acceleration along the vehicle equals the change of speed. When
    driving backwards, both have opposite signs. The assumed noise is the noise of the whole drive
    (including slopes). The mean of each segment is subtracted, because a mean may be a sensor
    offset or a slope.
    """
    speed, change, along = reference.motion.speed, reference.motion.change, reference.motion.along
    if speed is None or change is None or along is None:
        return []
    if reference.speed is None or not reference.speed.relation.is_believed_of(1):
        return []
    v = np.abs(speed)
    known = np.isfinite(along) & np.isfinite(change) & (np.nan_to_num(v) > CREEP)
    noise = float(np.var((along - change)[known])) if known.any() else 0.0
    found = []
    for c in candidates:
        if c.held is None or c.is_constant or not noise > 0.0:
            continue
        for level in c.levels:
            at = (c.held == level) & known
            if np.count_nonzero(at) < SMOOTH or float(v[at].max()) > REVERSE_SPEED:
                continue
            a, b = _less_their_means(along, at), _less_their_means(change, at)
            product, sizes = float(a @ b), float(a @ a) * float(b @ b)
            correlation = product / math.sqrt(sizes) if sizes > 0.0 else 0.0
            found.append(_Level(c, level, correlation, -2.0 * product / noise / SMOOTH))
    return found


def _less_their_means(x: Array, at: NDArray[np.bool_]) -> Array:
    """Return the values in the ticks that `at` marks, minus the mean of each contiguous segment."""
    rows = np.flatnonzero(at)
    parts = np.split(x[rows], np.flatnonzero(np.diff(rows) > 1) + 1)
    return np.concatenate([part - part.mean() for part in parts])


def _names_reverse(signal: Signal) -> float | None:
    """Return the physical value that the value table calls reverse, or None."""
    for raw, name in signal.choices.items():
        if name.strip().lower() in ("r", "reverse", "rev", "backward", "rueckwaerts", "rückwärts"):
            return float(raw * signal.scale + signal.offset)
    return None


def _reverse_by_name(candidates: Sequence[SeenSignal]) -> Choice | None:
    why = "chosen by its name only: the vehicle reverses too little in the recording to confirm it"
    options = []
    for c in candidates:
        value = _names_reverse(c.signal)
        if value is not None:
            options.append(
                (0, c, source_of(c, equals=(value,)), "its value table contains 'reverse'")
            )
        elif (
            hint("reverse", c) in ("reverse", "ruecklicht", "rueckwaerts") and c.signal.length <= 2
        ):
            options.append((1, c, source_of(c, equals=(1.0,)), f"named {c.signal.name}"))
    options.sort(key=lambda o: o[0])
    if not options:
        return None
    others = [Alternative({"": o[2]}, o[3]) for o in options[1 : 1 + MAX_ALTERNATIVES]]
    return Choice("reverse", {"": options[0][2]}, options[0][3], why, others)


def unseen_reverse(candidates: Sequence[SeenSignal]) -> Iterator[str]:
    """Yield a note if the gear lever was not in reverse and no name shows the value of reverse."""
    levers = [
        c.path
        for c in candidates
        if c.has_no_unit and _LEVER_WORDS & {*words(c.signal.name), *words(c.message.name)}
    ]
    if levers:
        yield (
            f"reverse: not used in the recording. If {' or '.join(levers[:MAX_ALTERNATIVES])} "
            f"shows the reverse gear, add 'reverse: {{signal: {levers[0]}, equals: VALUE}}' "
            "under 'signals'."
        )


def find_brake(motion: Motion, candidates: Sequence[SeenSignal]) -> Choice | None:
    """Find a switch (or pressure) that is on when the vehicle brakes."""
    if motion.speed is None or motion.change is None:
        return None
    change = motion.change
    moving = np.nan_to_num(np.abs(motion.speed)) > 1.0
    judged = moving & (np.nan_to_num(change) < -BRAKING) | moving & (change > -COASTING)
    braking = np.nan_to_num(change) < -BRAKING
    if min(np.count_nonzero(judged & braking), np.count_nonzero(judged & ~braking)) < 50:
        return _brake_by_name(candidates)
    found = []
    for c in candidates:
        if c.is_constant or any(c.states(d) for d in ("speed", "acceleration", "angular_rate")):
            continue
        for on, settings in _switches(c):
            rows = judged & np.isfinite(on)
            score = _matthews(on[rows] > 0.5, braking[rows])
            if score > CLEAR_MATTHEWS:
                found.append((score, c, settings))
    if not found:
        return _brake_by_name(candidates)
    found.sort(key=lambda f: (hint("brake", f[1]) is None, -f[0]))
    score, best, settings = found[0]
    named = hint("brake", best)
    text = f"on when slowing down by more than {BRAKING:g} m/s2 (correlation {score:.2f})"
    doubt = ""
    if not named and (score < 0.8 or (len(found) > 1 and found[1][0] > score - 0.05)):
        doubt = "its name does not contain 'brake', and other signals change with braking too"
    others = [
        Alternative({"": source_of(c, **s)}, f"correlation {one:.2f}")
        for one, c, s in found[1:]
        if c is not best
    ]
    chosen = source_of(best, **settings)
    return Choice("brake", {"": chosen}, text, doubt, others[:MAX_ALTERNATIVES])


def _switches(c: SeenSignal) -> list[tuple[Array, dict[str, Any]]]:
    """Return the possible ways to read a signal as on or off, each with its settings."""
    if c.held is not None:
        if len(c.levels) == 2:
            if 0.0 in c.levels and max(c.levels) > 0.0:
                return [((c.held != 0.0).astype(float), {})]
            return [((c.held == v).astype(float), {"equals": (v,)}) for v in c.levels]
        return [((c.held == v).astype(float), {"equals": (v,)}) for v in c.levels]
    low = float(np.nanquantile(c.x, 0.05))
    threshold = low + 0.02 * (c.largest - c.least)
    digits = 1 - math.floor(math.log10(max(abs(threshold), 1e-9)))
    threshold = round(threshold, max(digits, 0))
    on = np.where(np.isfinite(c.x), (c.x > threshold).astype(float), np.nan)
    return [(on, {"above": threshold})]


def _matthews(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    if not len(a) or not 0 < np.count_nonzero(a) < len(a):
        return 0.0
    return float(np.corrcoef(a.astype(float), b.astype(float))[0, 1])


def _brake_by_name(candidates: Sequence[SeenSignal]) -> Choice | None:
    named = [c for c in candidates if hint("brake", c) and not c.is_constant]
    if not named:
        return None
    named.sort(key=lambda c: not c.levels)
    best = named[0]
    settings = _switches(best)[0][1] if len(best.levels) <= 2 else {}
    why = "chosen by its name only: the recording does not show braking well enough"
    return Choice("brake", {"": source_of(best, **settings)}, f"named {best.signal.name}", why)


def _is_an_engine(c: SeenSignal) -> bool:
    """True if a temperature gets as high as the temperature of an engine. The limit of a sensor is
    85 degC."""
    unit = find_unit(c.unit, "temperature")
    return c.largest * unit.factor + unit.offset > ENGINE_WARM


def find_temperature(reference: KnownMotion, candidates: Sequence[SeenSignal]) -> Choice | None:
    """Find the temperature of the sensor. A signal in the sensor's messages is preferred."""
    usable = [c for c in candidates if c.states("temperature")]
    triad = reference.accelerometer
    if not usable or triad is None:
        return None
    own = triad.messages[0]
    usable.sort(
        key=lambda c: (
            c.message.name not in triad.messages,
            not same_family(c.message.name, own),
            _is_an_engine(c),
        )
    )
    best = usable[0]
    near = best.message.name in triad.messages or same_family(best.message.name, own)
    doubt = "" if near else "a temperature, perhaps of another part than the sensor"
    text = f"a temperature of {best.least:g} to {best.largest:g} {best.unit}"
    if near:
        text += f", and the name of its message {best.message.name} is like {own}"
    others = [Alternative({"": source_of(c)}, "another temperature") for c in usable[1:]]
    return Choice("temperature", {"": source_of(best)}, text, doubt, others[:MAX_ALTERNATIVES])
