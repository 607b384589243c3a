"""Test the residuals after the search, without a known cause.

The tests find signals with the opposite sign of their prediction, a residual that is too large, a
common motion in the residuals of two equations without a common sensor, and a line in a spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.stats import gamma

from imucald.core.arrays import Array, Index
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import UNITS, Forward
from imucald.diagnosis.fit.blocks import CARRIED, EQUATIONS, MEDIAN_SQUARE, late_signals
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.fit.score import losses, one_in_fifteen
from imucald.diagnosis.left_over.remains import DRIVEN, LEAST_SEGMENTS, Remains, Spectra
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import CHANCE, DRIVING_MPS, STEP_S, Mask
from imucald.model.sensors import BUTTERWORTH_S_HZ

OPPOSITE = 0.4
"""Negative correlation of a signal with its prediction above which a sign is wrong."""
LEAST_ROWS = 300
HANN_BINS = 1.5
"""Number of neighbouring frequency bins that count as one: noise bandwidth of a Hann window (Harris
1978)."""
BANDS_HZ = ((0.1, 0.3), (0.3, 0.6))
AIR = 0.5 * 1.2 * 2.2 * 2.3 / 1500.0
"""Lateral acceleration from the air, per square of the speed and per angle of attack [1/m]: half
the density, 2.2 m^2, 2.3 per radian, 1500 kg (a passenger car; Hucho, Aerodynamics of Road
Vehicles, ch. 5)."""
CALM, GUSTY = 0.02, 0.10
"""Lateral turbulence on roads, relative to the speed: smallest and largest value (Wordley and
Saunders, On-road Turbulence, SAE 2008-01-0475)."""
EDDY_M = 10.0
"""Length scale of the lateral turbulence [m] (same source)."""
MOST_LEFT_MPS2 = GUSTY * AIR * 30.0**2
"""Limit of the lateral residual after a fit of all parameters within their tolerances [m/s^2]: the
effect of gusty air on a car on a motorway, 0.18 m/s^2. The accelerometer's own noise is added to
this limit."""
BAND_HZ = 0.25, 4.5
"""Range of tested frequencies [Hz]. Lower frequencies are absorbed by the tilt of a segment. The
upper limit is below half of the grid's rate."""
PEAK = 4.0
"""Smallest ratio of a line to its surroundings in the spectrum."""
NEAR, FAR = 3, 9
"""Nearest and farthest frequency bin on each side with which a line is compared. The bins are
outside the spread of a Hann window, and near enough to follow the spectrum's slope (0.1 to 0.3 Hz
in segments of 30 s)."""


def goes_against(forwards: Sequence[Forward]) -> Iterator[Answer]:
    """Test for signals that have the opposite sign of their prediction. The reason is a wrong sign
    in the configuration."""
    f = max(forwards, key=lambda f: f.blocks)
    measured, masks = f.measured(), f.usable()
    residual = f.level(f.residuals({}), masks)
    for name in ("accel_x", "accel_y", "gyro_z", "yaw_rate", "lateral_accel"):
        if name not in residual or name not in masks:
            continue
        good = masks[name].ravel()
        if good.sum() < LEAST_ROWS:
            continue
        y = measured[name][good]
        p = y - residual[name].ravel()[good]
        if np.std(y) == 0.0 or np.std(p) == 0.0:
            continue
        r = float(np.corrcoef(y, p)[0, 1])
        text = f"measured and predicted values have opposite signs (correlation {r:.2f})"
        yield Answer(name, -r, OPPOSITE, 0.0, text, shown=-r)


def too_much(left: Remains) -> Iterator[Answer]:
    """Test for a residual of the sideways force that is larger than in any measured car. With such
    a residual, a cause is missing, and no fit without this cause can be trusted."""
    name, table = "accel_y", left.table
    if not {name, "gyro_x"} <= set(table.plain):
        return
    power = np.sort(2.0 * losses(table.plain[name].sum(axis=1), left.problem.fit()))
    power = power[power > 0.0]
    # Single blocks must not decide: a block in which the sensor is knocked has no fixed mount.
    power = power[: len(power) - one_in_fifteen(len(power))]
    most = float(np.sqrt(power[-1])) if len(power) else 0.0
    limit = float(np.hypot(MOST_LEFT_MPS2, _noise(left.state, table.top_hz[name])))
    text = (
        f"in one of fifteen segments, at least {most:.2g} m/s^2 of the sideways force is left "
        f"after every fit; gusts and the noise of the accelerometer leave {limit:.2g}. The "
        "sensor is not fixed to the vehicle, or something acts on it that speed and turning "
        "do not show"
    )
    yield Answer(name, most, limit, 0.0, text)


def _noise(state: State, top_hz: float) -> float:
    """Return the accelerometer's own lateral noise up to a frequency [m/s^2], assuming white noise:
    the noise density is computed from the differences of successive samples."""
    across = mount_of(state.model)[1]
    found = []
    for drive in state.drives:
        accel = drive.channels["accel"]
        steps = np.diff(accel.values @ across)
        # A difference contains the noise twice.
        power = float(np.median(steps**2)) / MEDIAN_SQUARE / 2.0
        found.append(np.sqrt(power * min(2.0 * top_hz * accel.period_s, 1.0)))
    return float(max(found))


def as_loud(z: Spectra) -> Spectra:
    """Return the spectra with all blocks scaled to equal power."""
    loud = np.sqrt(np.mean(np.abs(z[:, 2:]) ** 2, axis=1, keepdims=True))
    return np.asarray(z / np.maximum(loud, 1e-30))


def shared(left: Remains) -> Iterator[Answer]:
    """Test for a common motion in the residuals of two equations without a common sensor.

    The test uses the partial coherence. Everything that is linear in steering and turning is
    removed from both residuals, for any dynamics (Bendat and Piersol, Random Data, ch. 7), so an
    error of the handling model does not count as a motion. A reported coherence exceeds chance, 1 -
    p^(1/(n - 1)) for n segments. The motion must also exceed the effect of calm air at this speed,
    as a lateral push or as the acceleration v r of the resulting turn.
    """
    forwards, spectra = left.state.forwards, left.spectra
    drive = forwards[0].drive
    if not (drive.has("gyro") and drive.has("yaw_rate")):
        return
    v = np.concatenate([f.drive.knots.values for f in forwards])
    calm, fast = _calm(v), float(np.sqrt(np.mean(v[np.abs(v) > DRIVING_MPS] ** 2)))
    hz = np.fft.rfftfreq(forwards[0].rows, STEP_S)
    first, second = "accel_y", "yaw_rate"
    if not {first, second, "_steering"} <= set(spectra):
        return
    known = np.stack([spectra["_steering"], spectra["_turning"]], axis=2)
    a, b = spectra[first], spectra[second]
    good = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0]) & np.isfinite(known[:, 0]).all(axis=1)
    if good.sum() < LEAST_SEGMENTS:
        return
    bands = [(hz >= x) & (hz < y) for x, y in BANDS_HZ]
    pushed = [_common(a[good], b[good], known[good], band) for band in bands]
    turned = [_common(fast * b[good], a[good], known[good], band) for band in bands]
    sure = [share for share, _, chance in pushed if share > chance]
    total = max(
        float(np.sqrt(sum(moved**2 for share, moved, chance in each if share > chance)))
        for each in (pushed, turned)
    )
    share = max(sure, default=0.0)
    text = (
        f"between {BANDS_HZ[0][0]} and {BANDS_HZ[-1][1]} Hz, up to {100 * share:.0f} "
        f"% of the residual ({total:.2g} m/s^2) is also in the residual of "
        f"{second.replace('_', ' ')}, although they have no sensor in common: "
        "something moves the vehicle that speed and steering do not show"
    )
    yield Answer(first, total, calm, CHANCE, text, shown=share)


def _common(a: Spectra, b: Spectra, known: Spectra, band: Mask) -> tuple[float, float, float]:
    """Return the partial coherence in a band, the size of the coherent part of `a` [its unit], and
    the coherence by chance."""
    one = a[:, band]
    size = float(np.sqrt(np.sum(np.abs(one) ** 2, axis=1).mean()))
    u = left_of_known(as_loud(a)[:, band], known[:, band])
    w = left_of_known(as_loud(b)[:, band], known[:, band])
    cross = abs(np.sum(u * w.conj())) ** 2
    share = float(cross / (np.sum(np.abs(u) ** 2) * np.sum(np.abs(w) ** 2)))
    segments = (len(a) - known.shape[2]) * band.sum() / HANN_BINS
    chance = 1.0 - (CHANCE / len(BANDS_HZ)) ** (1.0 / max(segments - 1.0, 1.0))
    return share, size * float(np.sqrt(share)), float(chance)


def _calm(v: Array) -> float:
    """Return the rms acceleration of a car by calm air in the tested bands [m/s^2]. v: (N,) speed
    [m/s]."""
    v = np.abs(v[np.abs(v) > DRIVING_MPS])
    low, high = BANDS_HZ[0][0], BANDS_HZ[-1][1]
    travel = 2.0 * np.pi * EDDY_M / v
    # Share of the band in a spectrum 1/(1 + (2 pi f L/v)^2) (Dryden).
    part = (np.arctan(high * travel) - np.arctan(low * travel)) / (0.5 * np.pi)
    return CALM * AIR * float(np.sqrt(np.mean(part * v**4)))


def left_of_known(z: Spectra, known: Spectra) -> Spectra:
    """Return the spectra (B, F) minus the part that is linear in the inputs (B, F, 2), frequency by
    frequency."""
    left = z.copy()
    for i in range(z.shape[1]):
        left[:, i] -= known[:, i] @ np.linalg.lstsq(known[:, i], z[:, i], rcond=None)[0]
    return left


def cut_offs(changes: Mapping[str, float]) -> list[tuple[str, float, float]]:
    """Return signals and frequency ranges [Hz] in which a low-pass filter may leave a peak if the
    filter was fitted as a delay x.

    The range is one octave around the cut-off frequency of the filter: 1/(2 pi x) for first order,
    sqrt 2/(2 pi x) for second order. Below this range, a delay fits equally well. Above this range,
    there is no motion."""
    made = []
    for key, x in changes.items():
        if key.endswith("delay_s") and abs(x) > PARAMETERS[key].tolerance:
            band = 0.5 / (2.0 * np.pi * abs(x)), 2.0 * BUTTERWORTH_S_HZ / abs(x)
            made += [(signal, *band) for signal in late_signals(key, x)]
    return made


# lines -------------------------------------------------------------------------------------------


def lines(left: Remains) -> Iterator[Answer]:
    """Yield one answer for each equation, about the strongest line in its spectrum: does anything
    oscillate?

    Everything that is linear in the vehicle's accelerations is removed first, because driving may
    be periodic. A body on its springs oscillates in a band of half a hertz, and a road excites the
    whole band. A narrower line has another source: a fan, a pump, or a supply ripple.
    """
    spectra = left.spectra
    for name, equation in EQUATIONS.items():
        if not equation.zero or name not in spectra or not set(DRIVEN) <= set(spectra):
            continue
        known = np.stack([spectra[each] for each in DRIVEN], axis=2)
        z = spectra[name]
        good = np.isfinite(z[:, 0]) & np.isfinite(known[:, 0]).all(axis=1)
        if good.sum() < LEAST_SEGMENTS:
            continue
        z = left_of_known(z[good], known[good])
        hz = np.arange(z.shape[1]) / (2.0 * (z.shape[1] - 1) * STEP_S)
        to_hz = BAND_HZ[1]
        if "speed" in equation.takes:
            # The slope of the speed shows no more than the sample rate of the speed allows.
            periods = (d.channels["speed"].period_s for d in left.state.drives)
            to_hz = min(to_hz, *(CARRIED / period for period in periods))
        asked = (hz >= BAND_HZ[0]) & (hz <= to_hz)
        for s, low, high in cut_offs(left.state.changes):
            if s in equation.takes:
                asked &= (hz < low) | (hz > high)
        if asked.any():
            yield _of_line(name, z, hz, np.flatnonzero(asked), PARAMETERS[equation.zero].tolerance)


def _of_line(name: str, z: Spectra, hz: Array, asked: Index, tau: float) -> Answer:
    """Return the answer about the strongest line of an equation. z: (B, F) spectra of segments.
    asked: indices of the tested frequencies. tau: smallest amplitude of a line."""
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
    sure = size if ratio[best] > PEAK else 0.0
    return Answer(name, size, tau, p, text, sure=sure, shown=float(ratio[best]))


def _beside(power: Array, i: int) -> float:
    """Return the higher of the levels on both sides of a line. A slope or a broad rise of the
    spectrum therefore does not count as a line."""
    sides = power[max(i - FAR, 1) : i - NEAR + 1], power[i + NEAR : i + FAR + 1]
    return max(float(np.median(side)) for side in sides if len(side))
