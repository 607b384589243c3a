"""Simulated drives beside measured ones: how lively, how rough, how noisy are they?

    python benchmarks/simulation_realism.py [--seeds N] [--minutes M] [--json]

Every drive, measured or simulated, goes the same way: mean acceleration and rate in tenths of a
second, 0.7 Hz low-pass, speed shifted by its best delay, and the three levelled axes fitted by
least squares on (dv/dt, v r, 1). Accelerations in m/s^2. `residual` is what the fit leaves: slope,
bank, suspension, bumps; its split at 0.05 Hz tells slope from the rest. `gain` is the fitted
factor of dv/dt forward and of v r sideways.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.measured import DATA, MEASURED_DRIVES, is_here, nothing_measured
from imucald.can.logs.log_reader import LogReader
from imucald.config import load_config
from imucald.core.rotations import Matrix3, levelling_rotation
from imucald.core.samples import Samples, Series
from imucald.inputs.wiring import compile_router
from imucald.simulation import random_model, simulate

Array = NDArray[np.float64]
RATE = 10.0
SMOOTH_S = 0.6
"""Width of a Hann window with a -3 dB point near 0.7 Hz is twice this."""
SLOW_S = 20.0
MEASURED: dict[str, tuple[Path, Path, list[list[float]]]] = {
    # Rough axes by hand (rows: forward, left, up); levelled by gravity afterwards.
    "kingston_2008": (
        DATA / "kingston_2008" / "drive.log.gz",
        MEASURED_DRIVES / "kingston_2008.yaml",
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    ),
    "css_canmod_164": (
        DATA / "css_canmod_164" / "drive.log.gz",
        MEASURED_DRIVES / "css_canmod_164.yaml",
        [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
    ),
}


def smoothed(x: Array, width_s: float) -> Array:
    """Low-pass by a Hann window, zero phase."""
    window = np.hanning(round(2.0 * width_s * RATE) + 3)
    half = len(window) // 2
    padded = np.pad(x, (half, half), mode="edge")
    result: Array = np.convolve(padded, window / window.sum(), mode="valid")[: len(x)]
    return result


def gridded(series: Series, t: Array) -> Array:
    """Means of a three-axis series in the tenths of a second that end at t."""
    index = np.searchsorted(t, series.t)
    counts = np.maximum(np.bincount(index, minlength=len(t) + 1), 1)
    columns = [np.bincount(index, series.values[:, i], len(t) + 1) / counts for i in range(3)]
    out = np.column_stack(columns)[: len(t)]
    missing = np.bincount(index, minlength=len(t) + 1)[: len(t)] == 0
    for i in range(3):
        out[missing, i] = np.interp(t[missing], t[~missing], out[~missing, i])
    return out


def figures(samples: Samples, R: Matrix3) -> dict[str, float]:
    """Return the figures of one drive. R: rough rotation from sensor to vehicle axes."""
    accel, gyro, speed = samples["accel"], samples["gyro"], samples["speed"]
    good = np.all(np.abs(accel.values) < 30.0, axis=1)
    accel = Series(accel.t[good], accel.values[good])
    t = np.arange(max(accel.t[0], speed.t[0]) + 1.0, min(accel.t[-1], speed.t[-1]) - 1.0, 1 / RATE)
    level = levelling_rotation(np.median(accel.values, axis=0) @ R.T) @ R
    a, w = gridded(accel, t) @ level.T, gridded(gyro, t) @ level.T
    y = np.column_stack([smoothed(a[:, i], SMOOTH_S) for i in range(3)])
    best = min(
        (_fitted(t, y, w, speed, delay) for delay in np.arange(-0.5, 0.51, 0.1)),
        key=lambda fit: float(fit["residual_x"] + fit["residual_y"]),
    )
    quick = np.diff(accel.values @ level.T, axis=0)
    moving = np.interp(accel.t[1:], speed.t, speed.values) > 5.0
    for i, axis in enumerate("xyz"):
        best[f"shake_{axis}"] = float(np.std(quick[moving, i]) / np.sqrt(2.0))
    return best


def _fitted(t: Array, y: Array, w: Array, speed: Series, delay: float) -> dict[str, float]:
    v = smoothed(np.interp(t + delay, speed.t, speed.values), SMOOTH_S)
    dv = np.gradient(v) * RATE
    still = v < 0.1
    rates = np.column_stack([smoothed(w[:, i], SMOOTH_S) for i in range(3)])
    zero = np.median(rates[still], axis=0) if still.sum() > 50 else np.median(rates, axis=0)
    rates = np.degrees(rates - zero)
    vr = v * np.radians(rates[:, 2])
    moving = v > 1.0
    X = np.column_stack([dv, vr, np.ones(len(v))])
    B = np.linalg.lstsq(X[moving], y[moving], rcond=None)[0]
    left = y - X @ B
    slow = np.column_stack([smoothed(left[:, i], SLOW_S) for i in range(3)])
    out = {
        "standing": float(np.mean(still)),
        "speed": float(np.mean(v[moving])),
        "dvdt": float(np.std(dv[moving])),
        "vr": float(np.std(vr[moving])),
        "gain_x": float(B[0, 0]),
        "gain_y": float(B[1, 1]),
        "roll_rate": float(np.std(rates[moving, 0])),
        "pitch_rate": float(np.std(rates[moving, 1])),
    }
    for i, axis in enumerate("xyz"):
        out[f"residual_{axis}"] = float(np.std(left[moving, i]))
        out[f"quick_{axis}"] = float(np.std((left - slow)[moving, i]))
    return out


def measured_samples(log: Path, config: Path) -> Samples:
    """Samples of a log through its example configuration."""
    router = compile_router(load_config(config))
    found: dict[str, list[Series]] = {}
    start: float | None = None
    for frames in LogReader([log], router.matches):
        start = float(frames.t[0]) if start is None else start
        for channel, series in router.columns(frames.t - start, frames).samples.items():
            found.setdefault(channel, []).append(series)
    return {
        channel: Series(
            np.maximum.accumulate(np.concatenate([part.t for part in parts])),
            np.concatenate([part.values for part in parts]),
        )
        for channel, parts in found.items()
    }


def simulated(kind: str, seed: int, minutes: float) -> dict[str, float]:
    """Figures of a simulated drive with a speed as coarse as the measured ones' (1 Hz)."""
    model = random_model(seed, kind).with_changes(  # type: ignore[arg-type]
        {"speed.rate_hz": 1.0, "mount.roll_deg": 0.0, "mount.pitch_deg": 0.0, "mount.yaw_deg": 0.0}
    )
    return figures(simulate(model, seed, minutes).samples, np.eye(3))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if absent := [name for name in MEASURED if not is_here(name)]:
        return nothing_measured(*absent)
    rows: dict[str, dict[str, float]] = {}
    for name, (log, config, axes) in MEASURED.items():
        rows[name] = figures(measured_samples(log, config), np.array(axes, dtype=float))
    for kind in ("city", "mixed", "motorway"):
        drives = [simulated(kind, seed, options.minutes) for seed in range(options.seeds)]
        for label, pick in (("low", np.min), ("median", np.median), ("high", np.max)):
            rows[f"{kind} {label}"] = {
                key: float(pick([drive[key] for drive in drives])) for key in drives[0]
            }
    if options.json:
        print(json.dumps(rows, indent=2))
        return 0
    print("| drive | " + " | ".join(next(iter(rows.values()))) + " |")
    print("|---|" + "---|" * len(next(iter(rows.values()))))
    for name, row in rows.items():
        print(f"| {name} | " + " | ".join(f"{value:.3g}" for value in row.values()) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
