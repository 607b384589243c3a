"""Structure in the residual's spectra: humps that no road makes, motion that no input asked for.

A *hump* is power in a narrow band above the bands on both sides. The body's own modes are excited
by every road, so only what lies below them counts.

*Pushed sideways*: the measured yaw rate departs from what the steering asks for, and the lateral
acceleration from what the measured yaw rate asks for, both together. No error of a sensor does
that: one of the yaw rate shows in the gyroscope beside it, one of the steering or of the
accelerometer stays in its own signal, and a banked road shows in the roll rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.spectra import BLOCK_S, ERROR_STEADY, Complex, transform

Mask = NDArray[np.bool_]

HUMP_HZ, FLANK_HZ = 0.08, 0.12
"""Widths of a hump and of the bands beside it that it is compared with,"""
FLANK_SHARE, LEAST_FLANK_HZ = 0.35, 0.16
"""which lie this share of its frequency (at least so much) away."""
LOWEST_HZ = 0.3
LEVEL_HZ = (0.2, 1.3)
"""Band in which stretches are compared in loudness."""
MODE_SHARE = 0.8
"""Humps count up to this share of the body's lowest mode."""
LOUD_WEIGHT = 4.0
"""A stretch counts as if so many times the usual power were added to its own: loud ones do not
decide alone, quiet ones do not blur."""
OVERLAP = 1.4
"""By how much more the mean of half-overlapping stretches varies than of separate ones."""
FEWEST_STRETCHES = 8
"""Fewer say too little about themselves."""
TINY = 1e-30
WINDOW_HZ = 0.2
"""Width of the bands in which coherence is taken,"""
PUSH_HZ = (0.12, 1.1)
"""between these frequencies."""
ERROR_TOLD_PER_HZ = 0.25
"""Error of the forward model per hertz that a residual may show without being told of."""
OWN_MOTION = 0.25
"""Share of the yaw rate's residual that the gyroscope may show against it: more, and it is one of
the two sensors that errs, not the vehicle that moves."""


@dataclass(frozen=True)
class Humps:
    """Log ratio of power in narrow bands to that beside them."""

    hz: Array
    """(K,)"""
    each: Array
    """(K, signals)"""
    together: Array
    """(K,) mean over the signals,"""
    std: Array
    """(K,) and its standard deviation, from how the stretches scatter."""


@dataclass(frozen=True)
class Push:
    """Lateral motion that no input asked for."""

    hz: float
    coherence: float
    """Share of power that yaw rate's and lateral acceleration's residuals have in common."""
    excess: float
    """Power of the yaw rate's residual over what sensor and model may leave."""
    signals: tuple[str, ...]


class Spectra:
    """Averaged residual spectra of some drives.

    residual, predicted: (B, F, C) transformed stretches; present: (B, C).
    """

    def __init__(
        self, names: Sequence[str], residual: Complex, predicted: Complex, present: Mask
    ) -> None:
        self.names = list(names)
        self.residual, self.predicted, self.present = residual, predicted, present
        self.power = _mean_power(residual, present)
        # For humps loud stretches count only as much as usual ones.
        even = residual / np.sqrt(_stretch_weight(residual, present))[:, None, :]
        self._even = np.where(present[:, None, :], np.abs(even) ** 2, 0.0)

    def _index(self, name: str) -> int | None:
        return self.names.index(name) if name in self.names else None

    # humps -----------------------------------------------------------------------------------

    def humps(self, names: Sequence[str], top_hz: float) -> Humps | None:
        """Bands against those beside them, in all of some signals together; None: too little."""
        chosen = [self.names.index(name) for name in names]
        there = self.present[:, chosen].all(axis=1)
        width, flank = _bins(HUMP_HZ), _bins(FLANK_HZ)
        firsts = np.arange(_bins(LOWEST_HZ), _bins(top_hz) - width)
        away = np.maximum(_bins(LEAST_FLANK_HZ), np.rint(FLANK_SHARE * firsts).astype(int))
        low, high = firsts - away - flank // 2, firsts + width + away - flank // 2
        inside = (low >= 1) & (high + flank <= self.residual.shape[1])
        firsts, low, high = firsts[inside], low[inside], high[inside]
        if there.sum() < FEWEST_STRETCHES or not len(firsts):
            return None
        power = self._even[there][:, :, chosen]
        sums = np.concatenate([np.zeros_like(power[:, :1]), np.cumsum(power, axis=1)], axis=1)

        def mean(at: NDArray[np.int64], n: int) -> tuple[Array, Array]:
            part = (sums[:, at + n] - sums[:, at]) / n
            whole = part.sum(axis=0)
            return np.log(whole + TINY), np.log(whole - part + TINY)

        here, low_side, high_side = mean(firsts, width), mean(low, flank), mean(high, flank)
        log_ratio = here[0] - 0.5 * (low_side[0] + high_side[0])
        # Each stretch left out in turn (jackknife); they overlap by half.
        without = (here[1] - 0.5 * (low_side[1] + high_side[1])).mean(axis=2)
        std = np.sqrt(OVERLAP * (len(without) - 1) * without.var(axis=0))
        hz = (firsts + 0.5 * (width - 1)) / BLOCK_S
        return Humps(hz, log_ratio, log_ratio.mean(axis=1), std)

    # pushed sideways -------------------------------------------------------------------------

    def pushes(self) -> list[Push]:
        """Coherent yaw and lateral residuals, band by band."""
        yaw = self._index("yaw_rate")
        side = self._index("lateral_accel")
        side = self._index("accel_y") if side is None else side
        if yaw is None or side is None:
            return []
        there = self.present[:, yaw] & self.present[:, side]
        if there.sum() < 4:
            return []
        width = _bins(WINDOW_HZ)
        found = []
        for first in range(_bins(PUSH_HZ[0]), _bins(PUSH_HZ[1]) - width + 1, width // 2):
            band = slice(first, first + width)
            if band.stop <= self.residual.shape[1]:
                found.append(self._push(yaw, side, there, band))
        return found

    def _push(self, yaw: int, side: int, there: Mask, band: slice) -> Push:
        hz = 0.5 * (band.start + band.stop - 1) / BLOCK_S
        e = self.residual[there][:, band]
        coherence = _coherence(e[:, :, yaw], e[:, :, side])
        floor = float(np.min(self.power[-_bins(WINDOW_HZ) :, yaw]))
        share = math.hypot(ERROR_STEADY, ERROR_TOLD_PER_HZ * hz)
        asked = float(np.mean(np.abs(self.predicted[there][:, band, yaw]) ** 2))
        own = float(np.mean(np.abs(e[:, :, yaw]) ** 2))
        excess = own / max(floor + share**2 * asked, TINY)
        gyro = self._index("gyro_z")
        if gyro is not None:
            disagree = float(np.mean(np.abs(e[:, :, gyro]) ** 2))
            if disagree > OWN_MOTION * own:
                coherence = 0.0
        touched = [
            self.names[c]
            for c in range(len(self.names))
            if c in (yaw, side)
            or (self.names[c] in ("accel_y", "lateral_accel", "gyro_x")
                and _coherence(e[:, :, yaw], e[:, :, c]) > 0.4)
        ]  # fmt: skip
        return Push(hz, coherence, excess, tuple(touched))


def stretch_levels(spectra: Spectra) -> Array:
    """Log power (B, C) of each stretch over the usual one and the model's error in it; nan: absent.

    What the model may be wrong by grows with what is driven, so hard driving is no event.
    """
    band = slice(_bins(PUSH_HZ[0]), _bins(PUSH_HZ[1]))
    residual, predicted = spectra.residual[:, band], spectra.predicted[:, band]
    # A slow input ends the spectra below the band's top.
    hz = (band.start + np.arange(residual.shape[1]))[None, :, None] / BLOCK_S
    share = ERROR_STEADY**2 + (ERROR_TOLD_PER_HZ * hz) ** 2
    own = np.mean(np.abs(residual) ** 2, axis=1)
    asked = np.mean(share * np.abs(predicted) ** 2, axis=1)
    own = np.where(spectra.present, own, np.nan)
    made = np.full(own.shape, np.nan)
    for c in np.flatnonzero(spectra.present.sum(axis=0) >= 4):
        usual = np.nanmedian(own[:, c])
        made[:, c] = np.log(np.maximum(own[:, c], TINY) / max(usual, TINY))
        made[:, c] -= np.log1p(asked[:, c] / max(usual, TINY))
    return made


def predicted_blocks(forwards: Sequence[Forward], predicted: Sequence[Array]) -> Complex:
    """Predicted signals without their means, transformed: (B, F, C)."""
    made = [
        transform((p - p.mean(axis=1, keepdims=True))[None].astype(np.float32),
                  f.usable, f.track.top_hz).values[..., 0]
        for f, p in zip(forwards, predicted, strict=True)
    ]  # fmt: skip
    return np.concatenate(made)


def _coherence(a: Complex, b: Complex) -> float:
    """Coherence of (B, f) with (B, f); loud stretches count only as much as usual ones."""
    pa, pb = np.mean(np.abs(a) ** 2, axis=1), np.mean(np.abs(b) ** 2, axis=1)
    wa, wb = 1.0 / (pa + np.median(pa) + TINY), 1.0 / (pb + np.median(pb) + TINY)
    cross = np.sum(np.sqrt(wa * wb)[:, None] * a * b.conj())
    own = np.sum(wa[:, None] * np.abs(a) ** 2) * np.sum(wb[:, None] * np.abs(b) ** 2)
    return float(np.abs(cross) ** 2 / max(float(own), TINY))


def _mean_power(residual: Complex, present: Mask) -> Array:
    """(F, C)"""
    power = np.where(present[:, None, :], np.abs(residual) ** 2, 0.0).sum(axis=0)
    made: Array = power / np.maximum(present.sum(axis=0), 1)
    return made


def _stretch_weight(residual: Complex, present: Mask) -> Array:
    """(B, C) power of each stretch plus the usual one."""
    power = np.mean(np.abs(residual[:, _band(LEVEL_HZ, residual.shape[1])]) ** 2, axis=1)
    known = np.where(present, power, np.nan)
    usual = np.array([np.nanmedian(x) if np.isfinite(x).any() else 1.0 for x in known.T])
    return np.asarray(power + LOUD_WEIGHT * usual + TINY)


def _bins(hz: float) -> int:
    return max(1, round(hz * BLOCK_S))


def _band(hz: tuple[float, float], frequencies: int) -> slice:
    """Frequencies between two, or the upper half of those that there are."""
    stop = min(_bins(hz[1]), frequencies)
    return slice(min(_bins(hz[0]), stop // 2), stop)
