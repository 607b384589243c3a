"""Numbers for the pictures of the report page: residual over time, over the input on which it
depends most, and over frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import welch

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import UNITS, Forward
from imucald.diagnosis.result import SignalPicture
from imucald.diagnosis.signals import STEP_S

SEGMENT = 256


def pictures_of(before: Sequence[Forward], after: Sequence[Forward]) -> tuple[SignalPicture, ...]:
    """Return one picture for each signal. The drives are drawn one after another."""
    parts = [_one(a, b) for a, b in zip(before, after, strict=True)]
    starts = np.concatenate([[0.0], np.cumsum([f.t[-1] - f.t[0] + STEP_S for f in before])])
    t = np.concatenate([f.t - f.t[0] + s for f, s in zip(before, starts, strict=False)])
    drivers = _drivers(before, t)
    made = []
    for name in parts[0]:
        if any(name not in part for part in parts):
            continue
        measured, old, new = (np.concatenate([part[name][i] for part in parts]) for i in range(3))
        driver = _closest(old, drivers)
        f, power = _spectrum(old)
        _, power_new = _spectrum(new)
        made.append(
            SignalPicture(
                signal=name, unit=UNITS[name], t=t, measured=measured,
                predicted_before=measured - old, predicted_after=measured - new,
                driver_name=driver, driver=drivers[driver], frequency=f,
                spectrum_before=power, spectrum_after=power_new,
            )
        )  # fmt: skip
    return tuple(made)


def _one(before: Forward, after: Forward) -> Mapping[str, tuple[Array, Array, Array]]:
    """Return, by equation, the measured signal, the residual before and the residual after, (N,)
    each. NaN where the signal is not present."""
    masks = before.usable()
    measured = before.measured()
    old, new = (f.level(f.residuals({}), f.usable()) for f in (before, after))
    made = {}
    for name, x in old.items():
        if name in new and name in measured:
            gone = ~masks[name].ravel()
            columns = [np.where(gone, np.nan, v.ravel()) for v in (measured[name], x, new[name])]
            made[name] = (columns[0], columns[1], columns[2])
    return made


def _spectrum(x: Array) -> tuple[Array, Array]:
    """Return the one-sided spectral density [unit^2/Hz]. Gaps are filled with zeros."""
    good = np.isfinite(x)
    if good.sum() < SEGMENT:
        return np.array([0.1, 1.0]), np.full(2, np.nan)
    f, power = welch(np.where(good, x, 0.0), 1.0 / STEP_S, nperseg=SEGMENT, detrend=False)
    return f[1:], power[1:] / float(good.mean())


def _drivers(forwards: Sequence[Forward], t: Array) -> Mapping[str, Array]:
    """Return the inputs on which a residual may depend."""
    speed = np.concatenate([np.interp(f.t, f.knots, f.drive.knots.values) for f in forwards])
    made = {"speed [m/s]": speed, "dv/dt [m/s^2]": np.gradient(speed, STEP_S), "time [s]": t}
    if all(f.has_turning for f in forwards):
        rate = np.concatenate([f.yaw_rate() for f in forwards])
        made |= {"yaw rate [rad/s]": rate, "v r [m/s^2]": speed * rate}
    for name, title in (("steering", "steering [rad]"), ("temperature", "temperature [degC]")):
        if all(f.drive.has(name) for f in forwards):
            made[title] = np.concatenate([f.drive.channels[name].means(f.t) for f in forwards])
    return made


def _closest(residual: Array, drivers: Mapping[str, Array]) -> str:
    """Return the input whose correlation with the residual is largest."""
    fine = np.isfinite(residual)
    best, most = next(iter(drivers)), -1.0
    for name, x in drivers.items():
        if fine.sum() < 10 or np.std(x[fine]) == 0.0 or np.std(residual[fine]) == 0.0:
            continue
        goes_with = abs(float(np.corrcoef(x[fine], residual[fine])[0, 1]))
        if goes_with > most:
            best, most = name, goes_with
    return best
