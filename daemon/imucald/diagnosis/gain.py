"""What the extended model is worth: residual and likelihood on stretches that its fit left out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imucald.diagnosis.evidence import Evidence, Fit
from imucald.diagnosis.forward import SIGNALS, UNITS, Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.linear import NOISE_ROUNDS, Linearised, residual_blocks, residual_stretches
from imucald.diagnosis.result import Gain, SignalGain
from imucald.diagnosis.search import Search
from imucald.diagnosis.spectra import (
    BLOCK,
    Blocks,
    Complex,
    noise_of,
    normal_equations,
    weighted,
    windows,
)
from imucald.diagnosis.trial import Found

FOLDS = 4
LEAST_HELD = 4
"""Stretches in a row that are held out together, at least: nearly two minutes."""
LEAST_FITTED = 6
"""Stretches that must be left for a fit: two and a half minutes."""


def folds(search: Search, found: Found) -> list[Array]:
    """Weights (B,) of the stretches that each fit may use: whole drives, or parts of the one.

    A single drive is held out in pieces from all over it, so that what begins in it (a shift) or
    grows (warmth) is known from both sides. Stretches beside a held-out one overlap it, and are
    left out as well.
    """
    starts = [len(f.track.t) for f in search.forwards]
    total = len(found.point.present)
    owner = np.repeat(np.arange(len(starts)), _stretches(search, total))
    if len(starts) == 1:
        pieces = FOLDS * max(1, total // (FOLDS * LEAST_HELD))
        owner = (np.arange(total) * pieces // max(total, 1)) % FOLDS
    made = []
    for part in np.unique(owner):
        held = owner == part
        near = held | np.roll(held, 1) | np.roll(held, -1)
        made.append((~near).astype(float))
    return made


def can_hold_out(parts: Sequence[Array]) -> bool:
    """Whether every fit has stretches enough."""
    return min(float(used.sum()) for used in parts) >= LEAST_FITTED


def _stretches(search: Search, total: int) -> list[int]:
    counts = [len(windows(len(f.track.t))) for f in search.forwards]
    if sum(counts) != total:
        counts = [total // len(counts)] * (len(counts) - 1)
        counts.append(total - sum(counts))
    return counts


def measure(
    search: Search,
    found: Found,
    road: Sequence[Complex] | None = None,
    recorded: Sequence[Forward] = (),
) -> tuple[Gain, Mapping[str, SignalGain]]:
    """Likelihood and residual of held-out stretches, model file against extended model.

    road: per drive, what the found roads add to the prediction (B, F, C). recorded: the drives
    with what is faulty in them, where something is: their residual is the one before. Likelihoods
    are compared on sound samples only. Drives too short to hold anything out have no gain (NaN),
    and as residual after what the fit to all of them leaves.
    """
    point = found.point
    before = np.concatenate([residual_blocks(f, search.base) for f in search.forwards])
    extended = bool(found.active) or road is not None or bool(recorded)
    left = point if road is None else _without(point, found.keys, np.concatenate(list(road)))
    fitted = left.evidence.fit(found.keys)
    floor = left.residual - left.columns @ fitted.x.astype(np.float32)
    parts = folds(search, found)
    known = can_hold_out(parts)
    after = before
    if extended:
        after = _held_out_residual(left, found.keys, parts) if known else floor
    gains = _log_likelihood(point, after) - _log_likelihood(point, before)
    total = float(gains.sum())
    # Half-overlapping stretches are worth half as many independent ones.
    spread = 1.96 * math.sqrt(2.0) * float(np.std(gains)) * math.sqrt(len(gains))
    first, first_present = before, point.present
    if recorded:
        whole = [residual_stretches(f, search.base) for f in recorded]
        first = np.concatenate([drive.values[..., 0] for drive in whole])
        first_present = np.concatenate([drive.present for drive in whole])
    signals = {
        name: SignalGain(
            rms_before=_rms(first, first_present, i),
            rms_after=_rms(after, point.present, i),
            noise_floor=_rms(floor, point.present, i),
            unit=UNITS[name],
        )
        for i, name in enumerate(search.forwards[0].names)
        if name in SIGNALS
    }
    if extended and not known:
        return Gain(math.nan, (math.nan, math.nan)), signals
    return Gain(total, (total - spread, total + spread)), signals


def _without(point: Linearised, keys: Sequence[str], explained: Complex) -> Linearised:
    """The point, its residual less what something else explains, and the noise that is left."""
    residual = point.residual - explained
    columns = Blocks(point.columns, point.present, np.zeros(0))
    noise, evidence = point.noise, point.evidence
    for _ in range(NOISE_ROUNDS):
        normal = normal_equations(columns, residual, noise)
        evidence = Evidence(point.parameters, normal, point.evidence.shift)
        left = residual - point.columns @ evidence.fit(keys).x.astype(np.float32)
        noise = noise_of(left, point.present, noise.loud, point.noise.error)
    return replace(point, residual=residual, noise=noise, evidence=evidence)


def gain_of(search: Search, found: Found, keys: Sequence[str]) -> float:
    """Held-out log likelihood by one cause's parameters, against the model file's values."""
    evidence = found.point.evidence
    rest = [key for key in found.keys if key not in keys]
    parts = folds(search, found)
    if not can_hold_out(parts):
        return math.nan
    total = 0.0
    for used in parts:
        held = (used == 0.0).astype(float)
        full = evidence.fit(found.keys, used)
        without = evidence.fit(rest, used, fixed=keys)
        difference = evidence.held_out(full.x, held) - evidence.held_out(without.x, held)
        # Stretches beside a held-out one are left out by two folds.
        total += float(difference.sum()) * len(used) / (len(parts) * max(float(held.sum()), 1.0))
    return total


def _held_out_residual(point: Linearised, keys: Sequence[str], parts: Sequence[Array]) -> Complex:
    """Residual (B, F, C), fitted on the other stretches: causes freely, the rest by tolerance."""
    result = point.residual.copy()
    for used in parts:
        fit: Fit = point.evidence.fit(keys, used)
        held = np.flatnonzero(used == 0.0)
        result[held] = point.residual[held] - point.columns[held] @ fit.x.astype(np.float32)
    return result


def _log_likelihood(point: Linearised, residual: Complex) -> Array:
    """Of each stretch, but for constants; (B,)."""
    said = weighted(residual, point.present, point.noise)
    return np.asarray(-0.5 * np.real(np.sum(said.conj() * residual, axis=(1, 2))), dtype=float)


def _rms(residual: Complex, present: NDArray[np.bool_], i: int) -> float:
    """Root mean square of a signal's residual in the compared band."""
    power = np.abs(residual[present[:, i], :, i]) ** 2
    if not len(power):
        return math.nan
    twice = np.full(power.shape[1], 2.0)
    twice[0] = 1.0
    return float(np.sqrt(np.mean(power @ twice) / BLOCK))
