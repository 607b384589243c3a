"""Does the residual go with an input in a way that no cause of the catalogue has?

Each probe is a plain function of an input (level of vibration, speed, ...) put into one signal. Its
coefficient is fitted beside all parameters of the catalogue, each free within its wide prior, so
that whatever the catalogue can explain is not counted. The error is that between stretches (White's
sandwich, HAC for neighbours that overlap), and what an offset within its tolerance may do is
allowed for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucald.diagnosis.forward import UNITS, Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.linear import Linearised
from imucald.diagnosis.spectra import OVERLAP_WEIGHT, Complex, alike, bands, transform

LOWEST_BINS = 20
"""Frequencies looked at: up to 0.4 Hz. Dependences on slow inputs live there."""
NEIGHBOURS = 1.6
"""Stretches overlap by half: so many times more do their sums scatter than if they did not."""
ALLOWED: Mapping[str, float] = {"m/s^2": 0.05, "rad/s": 0.0015}
"""What may change over a drive without being worth a word, by unit: what an offset in a good model
file is wrong by, twice over (temperature, wander)."""
INPUTS: Mapping[str, tuple[str, ...]] = {
    "vibration": ("accel_x", "accel_y", "accel_z"),
    "rotational vibration": ("gyro_x", "gyro_y", "gyro_z"),
    "temperature": ("accel_x", "accel_y", "accel_z"),
    "speed": ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"),
    "turning": ("accel_x", "accel_z", "gyro_y"),
    "time": ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "lateral_accel"),
}
"""Input to the signals in which a dependence on it is looked for."""
WORDS: Mapping[str, str] = {
    "vibration": "the vibration's mean square",
    "rotational vibration": "the mean square of the rotational vibration",
    "temperature": "the temperature",
    "speed": "the square of the speed",
    "turning": "how hard the vehicle turns, either way",
    "time": "time",
}


@dataclass(frozen=True)
class Dependence:
    """A signal's residual against an input."""

    signal: str
    source: str
    change: float
    """What the input's range (5 to 95 %) changes in the signal."""
    std: float
    sigma: float
    """By how many standard deviations that is beyond what is allowed."""


def looks(names: Sequence[str]) -> int:
    """Number of dependences that are looked for."""
    return sum(signal in names for signals in INPUTS.values() for signal in signals)


def dependences(forwards: Sequence[Forward], point: Linearised) -> list[Dependence]:
    """Test every input on every signal of its list."""
    names = forwards[0].names
    weights = _Weights(point)
    found = []
    for source, signals in INPUTS.items():
        inputs = [_input(source, f) for f in forwards]
        chosen = [names.index(s) for s in signals if s in names]
        known = [u for u in inputs if u is not None]
        if len(known) < len(inputs) or not chosen:
            continue
        spread = _range(
            np.concatenate([u[~f.track.standing] for f, u in zip(forwards, known, strict=True)])
        )
        if spread <= 0.0:
            continue
        blocks = np.concatenate(
            [_blocks(u / spread, f) for f, u in zip(forwards, known, strict=True)]
        )
        for c in chosen:
            found.append(_tested(names[c], source, c, blocks, weights))
    return found


def _tested(signal: str, source: str, c: int, blocks: Complex, weights: _Weights) -> Dependence:
    change, std = weights.coefficient(c, blocks[:, :, c])
    beyond = max(abs(change) - ALLOWED[UNITS[signal]], 0.0)
    return Dependence(signal, source, change, std, beyond / std if std > 0.0 else 0.0)


class _Weights:
    """The fit of all parameters, and the weights of slow frequencies, for tests beside it."""

    def __init__(self, point: Linearised) -> None:
        F = min(LOWEST_BINS, point.residual.shape[1])
        evidence = point.evidence
        fit = evidence.fit(evidence.keys)
        self._inverse = fit.covariance
        self._columns = point.columns[:, :F]
        self._left = point.residual[:, :F] - self._columns @ fit.x.astype(np.float32)
        self._W = _inverse_noise(point, F)
        self._present = point.present

    def coefficient(self, c: int, probe: Complex) -> tuple[float, float]:
        """Coefficient of a probe (B, F) in signal c and its standard deviation."""
        probe = probe * self._present[:, c, None]
        weighed = self._W[:, :, c, :].conj() * probe[..., None]
        # Score and information by stretch; the parameters' part is projected out of the probe.
        score = np.real(np.einsum("bfc,bfc->b", weighed.conj(), self._left))
        own = np.real(np.sum(np.abs(probe) ** 2 * self._W[:, :, c, c], axis=1))
        cross = np.real(np.einsum("bfc,bfcp->bp", weighed.conj(), self._columns))
        direction = self._inverse @ cross.sum(axis=0)
        information = own - cross @ direction
        total = float(information.sum())
        if total <= 1e-6 * float(own.sum()) or total <= 0.0:
            return 0.0, math.inf
        taken = self._parameter_scores() @ direction
        score = score - taken
        value = float(score.sum()) / total
        left = score - value * information
        sandwich = math.sqrt(NEIGHBOURS * float(left @ left)) / total
        return value, max(sandwich, 1.0 / math.sqrt(total))

    def _parameter_scores(self) -> Array:
        """(B, P) scores of the parameters at the fit."""
        weighed = np.einsum("bfij,bfj->bfi", self._W, self._left)
        made: Array = np.real(np.einsum("bfi,bfip->bp", weighed.conj(), self._columns))
        return made


def _inverse_noise(point: Linearised, F: int) -> Complex:
    """(B, F, C, C) inverse noise as the normal equations weigh it; absent signals weigh nothing."""
    B, _, C = point.residual.shape
    result = np.zeros((B, F, C, C), dtype=np.complex64)
    edges = bands(point.residual.shape[1])
    for blocks, c in alike(point.present):
        for i, band in enumerate(edges):
            if band.start >= F:
                break
            weight = OVERLAP_WEIGHT * (1.0 if band.start == 0 else 2.0)
            W = weight * np.linalg.inv(point.noise.matrices(i, blocks, c))
            for f in range(band.start, min(band.stop, F)):
                result[np.ix_(blocks, np.array([f]), c, c)] = W[:, None]
    return result


def _blocks(u: Array, forward: Forward) -> Complex:
    """Probe (N,) in every signal: (B, F, C)."""
    C = len(forward.names)
    columns = np.broadcast_to(u.astype(np.float32), (1, C, len(u)))
    made = transform(columns, forward.usable, forward.track.top_hz).values[..., 0]
    return made[:, :LOWEST_BINS]


def _input(source: str, forward: Forward) -> Array | None:
    """Values of an input along a drive (N,)."""
    track = forward.track
    speed = track.scalars["speed"]
    if source == "vibration":
        return np.asarray(track.level["accel"] ** 2, dtype=float)
    if source == "rotational vibration":
        level = track.level.get("gyro")
        return None if level is None else np.asarray(level**2, dtype=float)
    if source == "temperature":
        return track.scalars.get("temperature")
    if source == "speed":
        return np.asarray(speed * speed, dtype=float)
    if source == "time":
        return np.asarray(track.t - track.t[0], dtype=float)
    yaw = track.scalars.get("yaw_rate")
    return None if yaw is None else np.asarray(np.abs(speed * yaw), dtype=float)


def _range(u: Array) -> float:
    if not len(u):
        return 0.0
    low, high = np.quantile(u, (0.05, 0.95))
    return float(high - low)
