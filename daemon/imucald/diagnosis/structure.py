"""Is structure left in the residual that no cause of the catalogue explains?

Looked for, each with its own bar that counts how often was looked: a dependence on an input
(`structure_probes`), a hump in the spectrum below the body's own modes, lateral motion that
neither steering nor yaw rate asks for (`structure_spectra`), one stretch unlike all the others.
A bar has two parts: what chance can do, and what a good model may leave (its unknown dynamics).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from imucald.diagnosis.forward import Forward
from imucald.diagnosis.result import Structure
from imucald.diagnosis.search import Search
from imucald.diagnosis.spectra import windows
from imucald.diagnosis.structure_probes import WORDS, Dependence, dependences, looks
from imucald.diagnosis.structure_spectra import (
    FEWEST_STRETCHES,
    MODE_SHARE,
    Push,
    Spectra,
    predicted_blocks,
    stretch_levels,
)
from imucald.diagnosis.trial import Found

FALSE_ALARM = 0.01
"""Chance by which each kind of test may speak without cause, over all its looks."""
TOGETHER_LOG, PAIR_LOG, ALONE_LOG = math.log(1.95), math.log(2.5), math.log(7.0)
"""Hump's power over that beside it, as the mean over three signals of a sideways motion (roll rate,
yaw rate, lateral acceleration), over two of them, in a single signal."""
LEAST_COHERENCE = 0.4
"""Share of the sideways residual that yaw rate and lateral acceleration must have in common."""
LEAST_EXCESS = 3.0
"""Power of the yaw rate's residual over what the sensor's noise and the model's error may leave."""
UNLIKE = math.log(60.0)
"""A stretch's power over the usual one, allowing for how hard was driven in it."""


def find_structure(search: Search, found: Found) -> list[Structure]:
    """What is left after the best set of causes was fitted; strongest first, empty for nothing."""
    point = found.point
    if len(point.residual) < FEWEST_STRETCHES:
        return []
    left = point.residual - point.columns @ point.evidence.fit(found.keys).x.astype(np.float32)
    forwards = search.forwards
    predicted = predicted_blocks(forwards, [f.predict(point.values) for f in forwards])
    spectra = Spectra(forwards[0].names, left, predicted, point.present)
    made = _humps(spectra, forwards)
    made += _pushes(spectra, known={s.signal for s in made})
    made += _dependences(forwards, found, len(left))
    made += _bursts(spectra, forwards)
    return sorted(made, key=lambda s: -s.size)


# humps ---------------------------------------------------------------------------------------


def _humps(spectra: Spectra, forwards: Sequence[Forward]) -> list[Structure]:
    suspension = forwards[0].model.suspension
    modes = (suspension.roll_frequency_hz, suspension.pitch_frequency_hz)
    top = min(MODE_SHARE * min(modes), forwards[0].track.top_hz)
    names = spectra.names
    sideways: list[str] = [
        name for name in ("gyro_x", "yaw_rate", "lateral_accel") if name in names
    ]
    if "lateral_accel" not in names and "accel_y" in names:
        sideways.append("accel_y")
    made: list[Structure] = []
    if len(sideways) > 1:
        bar = TOGETHER_LOG if len(sideways) > 2 else PAIR_LOG
        made = _peak(spectra, sideways, top, bar, told=("accel_y",))
    told = {s.signal for s in made}
    for name in names:
        if name not in told:
            made += _peak(spectra, [name], top, ALONE_LOG)
    return made


def _peak(
    spectra: Spectra, names: Sequence[str], top: float, bar: float, told: Sequence[str] = ()
) -> list[Structure]:
    """The highest hump that some signals share, if it is above the bar and beyond chance.

    told: signals that are told of beside them if they have the hump as well.
    """
    humps = spectra.humps(names, top)
    if humps is None:
        return []
    # Bands overlap, and neighbours are compared with one another: a sixth are looks of their own.
    looked = max(len(humps.hz) / 6.0, 1.0) * (len(spectra.names) if len(names) == 1 else 1)
    surely = float(student.isf(FALSE_ALARM / looked, max(len(spectra.residual) * 2 // 3, 3)))
    good = (humps.together > bar) & (humps.together > surely * humps.std)
    if not good.any():
        return []
    k = int(np.argmax(np.where(good, humps.together, -np.inf)))
    ratios = dict(zip(names, humps.each[k], strict=True))
    for name in told:
        other = spectra.humps([name], top) if name in spectra.names else None
        if other is not None:
            ratios.setdefault(name, other.together[k])
    hz = float(humps.hz[k])
    return [_hump(n, hz, float(np.exp(x))) for n, x in ratios.items() if x > 0.5 * bar]


def _hump(name: str, hz: float, times: float) -> Structure:
    text = (
        f"{name} swings at {hz:.2f} Hz: its residual there has {times:.1f} times the power of the "
        "frequencies beside. The body's own modes lie higher; a swaying trailer, a load that "
        "swings or a liquid that sloshes would do this."
    )
    return Structure(name, "spectral peak", times, text)


# pushes --------------------------------------------------------------------------------------


def _pushes(spectra: Spectra, known: set[str]) -> list[Structure]:
    """Lateral motion without an input; told once, for the band in which it is strongest."""
    pushes = [
        p for p in spectra.pushes() if p.coherence > LEAST_COHERENCE and p.excess > LEAST_EXCESS
    ]
    if not pushes:
        return []
    strongest = max(pushes, key=lambda p: p.coherence * math.log(p.excess))
    low, high = min(p.hz for p in pushes), max(p.hz for p in pushes)
    signals = [s for s in dict.fromkeys(s for p in pushes for s in p.signals) if s not in known]
    return [_push(name, strongest, low, high) for name in signals]


def _push(name: str, push: Push, low: float, high: float) -> Structure:
    band = f"near {low:.2g} Hz" if high - low < 0.05 else f"from {low:.2g} to {high:.2g} Hz"
    text = (
        f"{name} moves with the vehicle {band} although steering and yaw rate do not ask for it: "
        f"{push.coherence:.0%} of what is left is common to yaw rate and lateral acceleration, "
        f"{push.excess:.0f} times what sensor and model may leave. Something pushes the vehicle "
        "sideways, such as wind or what it tows."
    )
    return Structure(name, "bursts", push.excess, text)


# dependences ---------------------------------------------------------------------------------


def _dependences(forwards: Sequence[Forward], found: Found, stretches: int) -> list[Structure]:
    names = forwards[0].names
    tried = max(looks(names), 1)
    # Half-overlapping stretches: half as many tell the error.
    bar = float(student.isf(0.5 * FALSE_ALARM / tried, max(stretches // 2 - 2, 3)))
    return [_dependence(d) for d in dependences(forwards, found.point) if d.sigma > bar]


def _dependence(d: Dependence) -> Structure:
    unit = "m/s^2" if d.signal.startswith(("accel", "lateral", "longitudinal")) else "rad/s"
    text = (
        f"{d.signal} goes with {WORDS[d.source]}: over its range the signal changes by "
        f"{d.change:+.3g} +- {d.std:.2g} {unit}, and nothing in the catalogue does that."
    )
    if d.source.endswith("vibration"):
        text += " A sensor that rectifies vibration would do this."
    return Structure(d.signal, f"depends on {d.source}", d.sigma, text)


# one stretch unlike the others ---------------------------------------------------------------


def _bursts(spectra: Spectra, forwards: Sequence[Forward]) -> list[Structure]:
    made = []
    levels = stretch_levels(spectra)
    for c, name in enumerate(spectra.names):
        level = levels[:, c]
        if not np.isfinite(level).any():
            continue
        b = int(np.nanargmax(level))
        if level[b] > UNLIKE:
            times, when = float(np.exp(level[b])), _when(forwards, b)
            text = (
                f"{name}: the stretch around {when:.0f} s is unlike all others, its residual has "
                f"{times:.0f} times the usual power. Look at what happened there."
            )
            made.append(Structure(name, "bursts", times, text))
    return made


def _when(forwards: Sequence[Forward], block: int) -> float:
    """Middle of a stretch [s] from its drive's first sample."""
    for forward in forwards:
        first = windows(len(forward.track.t))
        if block < len(first):
            rows = forward.track.t
            return float(
                rows[min(first[block] + (first[1] if len(first) > 1 else 0), len(rows) - 1)]
            )
        block -= len(first)
    return 0.0
