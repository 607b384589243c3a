"""Numbers for the report's pictures: residual against time, its driver and frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imucald.diagnosis.forward import UNITS, Forward
from imucald.diagnosis.grid import GRID_HZ, Array
from imucald.diagnosis.linear import residual_blocks
from imucald.diagnosis.result import SignalPicture
from imucald.diagnosis.roads import RoadFinding, road_added
from imucald.diagnosis.search import Search
from imucald.diagnosis.spectra import BLOCK_S, Complex
from imucald.diagnosis.trial import Found


def pictures_of(
    search: Search, found: Found, roads: Sequence[RoadFinding]
) -> tuple[SignalPicture, ...]:
    """One picture a signal, the drives one after another."""
    forwards = search.forwards
    keys = set(found.keys)
    extended = {k: v if k in keys or k.startswith("_shift") else search.base[k]
                for k, v in found.point.values.items()}  # fmt: skip
    before = [f.predict(search.base) for f in forwards]
    after = [f.predict(extended) + road_added(f, roads, i) for i, f in enumerate(forwards)]
    times, start = [], 0.0
    for f in forwards:
        times.append(start + np.arange(len(f.track.t)) / GRID_HZ)
        start = float(times[-1][-1]) + 1.0 / GRID_HZ
    t = np.concatenate(times)
    drivers = _drivers(forwards, t)
    blocks_before = np.concatenate([residual_blocks(f, search.base) for f in forwards])
    blocks_after = np.concatenate([residual_blocks(f, extended) for f in forwards])
    free = found.point.evidence.fit(found.point.evidence.keys).x.astype(np.float32)
    blocks_floor = found.point.residual - found.point.columns @ free
    frequency = np.arange(blocks_before.shape[1]) / BLOCK_S
    made = []
    for i, name in enumerate(forwards[0].names):
        measured = np.concatenate([_shown(f.measured[i], f.usable[i]) for f in forwards])
        left = measured - np.concatenate([b[i] for b in before])
        driver = _closest(left, drivers)
        made.append(
            SignalPicture(
                signal=name,
                unit=UNITS[name],
                t=t,
                measured=measured,
                predicted_before=np.concatenate([b[i] for b in before]),
                predicted_after=np.concatenate([a[i] for a in after]),
                driver_name=driver,
                driver=drivers[driver],
                frequency=frequency[1:],
                spectrum_before=_density(blocks_before, i),
                spectrum_after=_density(blocks_after, i),
                spectrum_floor=_density(blocks_floor, i),
            )
        )
    return tuple(made)


def _shown(x: Array, usable: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Array:
    return np.where(usable, x, np.nan)


def _density(blocks: Complex, i: int) -> Array:
    """One-sided power density of a signal's residual without its mean [unit^2/Hz]."""
    return np.asarray(2.0 * np.mean(np.abs(blocks[:, 1:, i]) ** 2, axis=0) / GRID_HZ, dtype=float)


def _drivers(forwards: Sequence[Forward], t: Array) -> Mapping[str, Array]:
    """Inputs that a residual may go with."""

    def whole(name: str) -> Array:
        return np.concatenate([f.track.scalars[name] for f in forwards])

    speed = whole("speed")
    made = {"speed [m/s]": speed, "dv/dt [m/s^2]": np.gradient(speed) * GRID_HZ, "time [s]": t}
    scalars = forwards[0].track.scalars
    if "yaw_rate" in scalars:
        yaw = whole("yaw_rate")
        made |= {"yaw rate [rad/s]": yaw, "v r [m/s^2]": speed * yaw}
    elif forwards[0].track.gyro is not None:
        yaw = np.concatenate([(f.R_vehicle_from_sensor @ f.track.gyro)[2]
                              for f in forwards if f.track.gyro is not None])  # fmt: skip
        made |= {"yaw rate [rad/s]": yaw, "v r [m/s^2]": speed * yaw}
    if "steering" in scalars:
        made["steering [rad]"] = whole("steering")
    if "temperature" in scalars:
        made["temperature [degC]"] = whole("temperature")
    return made


def _closest(residual: Array, drivers: Mapping[str, Array]) -> str:
    """The input whose correlation with the residual is largest."""
    fine = np.isfinite(residual)
    best, most = next(iter(drivers)), -1.0
    for name, x in drivers.items():
        if fine.sum() < 10 or float(np.std(x[fine])) == 0.0 or float(np.std(residual[fine])) == 0.0:
            continue
        said = abs(float(np.corrcoef(x[fine], residual[fine])[0, 1]))
        if said > most:
            best, most = name, said
    return best
