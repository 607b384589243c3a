"""Find a line in a residual's spectrum: something oscillates at one frequency.

Periodic driving, as in a slalom, is removed first: everything linear in the vehicle's
accelerations, for any dynamics (frequency by frequency; Bendat and Piersol, ch. 7). A body on its
springs oscillates in a band whose width depends on its damping (0.2 of critical at 1.2 Hz: half a
hertz), and a road excites the whole band. A narrower line has another source: a fan, a pump, or a
supply ripple that is sampled too slowly.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import gamma

from imucald.core.arrays import Array
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import UNITS
from imucald.diagnosis.fit.blocks import CARRIED, OF_SPEED, TAKES, NDArrayInt
from imucald.diagnosis.fit.chance import Question
from imucald.diagnosis.fit.score import one_in_fifteen
from imucald.diagnosis.left_over.adequacy import (
    DRIVEN,
    LEAST_BLOCKS,
    Spectra,
    as_loud,
    cut_offs,
    left_of_known,
)
from imucald.diagnosis.result import Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import STEP_S

BAND_HZ = 0.25, 4.5
"""Tested frequencies: from above those that a segment's tilt absorbs to below half the grid's
rate."""
PEAK = 4.0
"""A line is at least this many times as strong as its surroundings."""
NEAR, FAR = 3, 9
"""Bins on each side of a line with which it is compared: outside the spread of a Hann window, and
near enough to follow the spectrum's slope (0.1 to 0.3 Hz in segments of 30 s)."""
ZEROS: Mapping[str, str] = {
    "accel_x": "accel.bias.x", "accel_y": "accel.bias.y", "accel_z": "accel.bias.z",
    "gyro_x": "gyro.bias.x", "gyro_y": "gyro.bias.y", "gyro_z": "gyro.bias.z",
    "yaw_rate": "yaw_rate.offset", "lateral_accel": "lateral_accel.offset",
    "longitudinal_accel": "longitudinal_accel.offset",
}  # fmt: skip
"""Zero error that a correct file may have: a smaller oscillation is not reported."""


def lines(state: State, spectra: Mapping[str, Spectra]) -> list[Question]:
    """One question for each equation, about its strongest line."""
    made = []
    for name, tau in ZEROS.items():
        if name not in spectra or not set(DRIVEN) <= set(spectra):
            continue
        known = np.stack([spectra[each] for each in DRIVEN], axis=2)
        z = spectra[name]
        good = np.isfinite(z[:, 0]) & np.isfinite(known[:, 0]).all(axis=1)
        if good.sum() < LEAST_BLOCKS:
            continue
        z = left_of_known(z[good], known[good])
        hz = np.arange(z.shape[1]) / (2.0 * (z.shape[1] - 1) * STEP_S)
        asked = (hz >= BAND_HZ[0]) & (hz <= _to_hz(name, state))
        for s, low, high in cut_offs(state.changes):
            if s in TAKES[name]:
                asked &= (hz < low) | (hz > high)
        if asked.any():
            made.append(_question(name, z, hz, np.flatnonzero(asked), PARAMETERS[tau].tolerance))
    return made


def _to_hz(name: str, state: State) -> float:
    """Upper frequency for an equation: between two samples of the speed nothing is known."""
    if name not in OF_SPEED:
        return BAND_HZ[1]
    return min(BAND_HZ[1], *(CARRIED / d.channels["speed"].period_s for d in state.drives))


def _question(name: str, z: Spectra, hz: Array, asked: NDArrayInt, tau: float) -> Question:
    """z: (B, F) spectra of segments; asked: indices of frequencies."""
    # One segment in fifteen must not decide.
    kept = len(z) - one_in_fifteen(len(z))
    power, loud = (np.sort(np.abs(x) ** 2, axis=0)[:kept].mean(axis=0) for x in (as_loud(z), z))
    beside = np.array([_beside(power, int(i)) for i in asked])
    count = kept - len(DRIVEN)
    ratio = power[asked] / beside
    best = int(np.argmax(ratio))
    i = int(asked[best])
    # For normal noise a segment's power is exponentially distributed, and the mean of B segments
    # gamma distributed.
    p = min(len(asked) * float(gamma.sf(ratio[best] * count, count)), 1.0)
    own = slice(i - 1, i + 2)
    rest = loud[own].sum() - 3.0 * _beside(loud, i)
    size = float(np.sqrt(2.0 * max(rest, 0.0)))
    text = (
        f"a line at {hz[i]:.2f} Hz, {ratio[best]:.0f} times as strong as its surroundings, "
        f"with an amplitude of {size:.2g} {UNITS[name]}"
    )
    return Question(p, bool(ratio[best] > PEAK and size > tau),
                    Structure(name, "peak", float(ratio[best]), text))  # fmt: skip


def _beside(power: Array, i: int) -> float:
    """The higher of the levels on both sides, so that a slope or a broad rise does not count as a
    line."""
    sides = power[max(i - FAR, 1) : i - NEAR + 1], power[i + NEAR : i + FAR + 1]
    return max(float(np.median(side)) for side in sides if len(side))
