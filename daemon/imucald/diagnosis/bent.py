"""Causes that are far from linear: a delay, a low-pass.

Their derivatives near the model file's values mislead, so they are tried where a search finds the
residual's spectra least.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from imucald.diagnosis.cause import Variant
from imucald.diagnosis.linear import residual_blocks
from imucald.diagnosis.spectra import OVERLAP_WEIGHT
from imucald.diagnosis.trial import ACCEPT, Found, Trial, signal_of, within

if TYPE_CHECKING:
    from imucald.diagnosis.search import Search

STARTS: Mapping[str, tuple[float, ...]] = {
    "signal_delay": (-0.45, -0.35, -0.25, -0.15, -0.07, 0.07, 0.15, 0.25, 0.35, 0.45),
    "sensor_lowpass": (0.1, 0.2, 0.35, 0.55, 0.8, 1.1, 1.5, 2.1),
}
"""Departures at which causes that are far from linear are tried as well."""
NARROWED = 2
"""Times that the best departure's neighbourhood is halved."""
FAR_FROM = -5.0
"""Log posterior odds near the point from which on starting values far from it are tried."""
SAME_SIGNAL = 150.0
"""What a delay must be worth beside a low-pass of the same signal, or the reverse: the two shapes
are hardly told apart."""


def far_trials(search: Search, found: Found, trials: Sequence[Trial]) -> list[Trial]:
    """Try bent causes where they leave the quietest residual; those that help, best first.

    What is far from the point in a parameter shows near it as well, in it or in its like.
    """
    near = {trial.variant: trial.score for trial in trials if trial.variant.cause in STARTS}
    moved = {signal_of(k) for v, score in near.items() if score > FAR_FROM for k in v.keys}
    here = found.point.quietness_of([found.point.residual])
    weight = OVERLAP_WEIGHT * len(found.point.present)
    tried = []
    for variant in near:
        if moved & {signal_of(key) for key in variant.keys}:
            values, quiet = _quietest(search, found, variant)
            score = weight * (here - quiet) + search.prior(variant)
            tried.append(Trial(variant, score, {key: values[key] for key in variant.keys}))
    good = [trial for trial in tried if trial.score > ACCEPT]
    return sorted(good, key=lambda trial: -trial.score)


def _quietest(search: Search, found: Found, variant: Variant) -> tuple[dict[str, float], float]:
    """Move a bent cause to where the residual's spectra are least, by a search on a grid."""

    def at(departure: float) -> dict[str, float]:
        values = dict(found.point.values)
        for key in variant.keys:
            p = search.parameter(key)
            values[key] = within(p, values[key] + departure)
        return values

    def loud(departure: float) -> float:
        whole = [residual_blocks(f, at(departure)) for f in search.forwards]
        return found.point.quietness_of(whole)

    grid = STARTS[variant.cause]
    said = {x: loud(x) for x in grid}
    best = min(said, key=lambda x: said[x])
    i = grid.index(best)
    step = 0.5 * (grid[min(i + 1, len(grid) - 1)] - grid[max(i - 1, 0)])
    for _ in range(NARROWED):
        step *= 0.5
        said |= {x: loud(x) for x in (best - step, best + step)}
        best = min(said, key=lambda x: said[x])
    return at(best), said[best]


def hurdle(active: Sequence[Variant]) -> float:
    """Log posterior odds that the newest of some causes must have."""
    *others, newest = active
    bent = {signal_of(k) for v in others if v.cause in STARTS for k in v.keys}
    same = newest.cause in STARTS and bent & {signal_of(key) for key in newest.keys}
    return SAME_SIGNAL if same else ACCEPT
