"""Every measured drive with its shipped configuration: what comes out beside what is known.

    python -m benchmarks.real_drives [--estimator joint|published] [--only NAME]

The drives lie beside the project (../shared/data); those that are absent are named.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from benchmarks.integrity.force import ENTRIES, Response, left_over, stated
from benchmarks.measured import DATA, FOLDER, MEASURED_DRIVES, is_here, nothing_measured, verdict
from imucald.can.logs.log_reader import LogReader
from imucald.config import LoadedConfig
from imucald.core.rotations import Matrix3, times, vector_from_rotation
from imucald.core.samples import Series
from imucald.inputs.column_samples import Routed
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import Correction, MountEstimate
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine, open_config
from imucald.runtime.timebase import TimeBase

ESTIMATORS = ("joint", "published")
KINGSTON_FORWARD = np.array([0.0039, 0.9998, 0.0155])
"""Forward in sensor axes, from the INS."""
GRID_S = 0.2
"""Signals are compared on a grid of this step [s]."""


@dataclass(frozen=True)
class Result:
    """One replay: the estimate, the summary's dictionary."""

    estimate: MountEstimate
    summary: dict[str, Any]

    @property
    def rotation(self) -> Matrix3 | None:
        """R_vehicle_from_sensor."""
        return self.estimate.R_vehicle_from_sensor

    @property
    def is_usable(self) -> bool:
        """Whether corrected values were ever sent."""
        return self.summary["first_usable_s"] is not None


def config_of(drive: str, estimator: str) -> LoadedConfig:
    loaded = open_config(MEASURED_DRIVES / f"{drive}.yaml")
    calibration = replace(loaded.config.calibration, estimator=estimator)
    loaded.config = replace(loaded.config, calibration=calibration)
    return loaded


def replayed(drive: str, estimator: str, log: Path | None = None) -> Result:
    loaded = config_of(drive, estimator)
    engine = make_engine(loaded)
    reader = LogReader([log or DATA / drive / "drive.log.gz"], engine.router.matches)
    summary = Replay(engine, reader).run()
    return Result(engine.pipeline.estimator.estimate(), summary)


# What is known of each drive -------------------------------------------------------------------


def kingston(estimator: str) -> Iterator[str]:
    result = replayed("kingston_2008", estimator)
    yield describe(result)
    R = result.rotation
    if R is None:
        yield f"  forward axis: none (bar 1.0 deg: {verdict(False)})"
        return
    truth = KINGSTON_FORWARD / np.linalg.norm(KINGSTON_FORWARD)
    forward = R @ truth  # is (1, 0, 0) where all is right
    error = angle_between(R[0], truth)
    yield f"  forward axis {error:.2f} deg from the INS's (bar 1.0: {verdict(error <= 1.0)})"
    std = result.estimate.std
    if std is not None:
        pitch, yaw = -math.degrees(forward[2]), math.degrees(forward[1])
        yield (
            f"  pitch {pitch:+.2f} deg ({abs(pitch) / math.degrees(std[1]):.1f} sd),"
            f" yaw {yaw:+.2f} deg ({abs(yaw) / math.degrees(std[2]):.1f} sd); INS +-0.3"
        )
    applied = result.estimate.correction
    if applied is not None:  # what a sensor without errors of its own answers to dv/dt with
        sent = times(applied.force, truth.tolist())
        known = {"yx": math.degrees(sent[1]), "zx": math.degrees(sent[2])}
        yield from left_over_lines(known, result.estimate)


def quat_orient(estimator: str) -> Iterator[str]:
    result = replayed("quat_orient_21", estimator)
    yield describe(result)
    angles = result.estimate.angles
    if angles is None:
        yield f"  yaw: none (bar 4 deg: {verdict(False)})"
        return
    yaw, std = math.degrees(angles[2]), result.estimate.std
    own = "" if std is None else f", {abs(yaw) / math.degrees(std[2]):.1f} sd"
    yield f"  yaw {yaw:+.2f} deg from by-eye truth +-3{own} (bar 4: {verdict(abs(yaw) <= 4.0)})"
    yield from aligned(result.estimate)


def css(estimator: str) -> Iterator[str]:
    drive = "css_canmod_164"
    result = replayed(drive, estimator)
    yield describe(result)
    halves = [replayed(drive, estimator, half) for half in in_halves(drive)]
    for name, half in zip(("first half", "second half"), halves, strict=True):
        yield f"  {name}: {describe(half)}"
    first, second = (half.rotation for half in halves)
    if first is None or second is None:
        yield f"  halves: no estimate (bar 3 deg: {verdict(False)})"
        return
    between = vector_from_rotation(first @ second.T)
    angle = math.degrees(float(np.linalg.norm(between)))
    own = sds_apart(between, halves)
    usable = result.is_usable and all(half.is_usable for half in halves)
    yield f"  halves {angle:.2f} deg apart{own} (bar 3: {verdict(usable and angle <= 3.0)})"
    one, other = (half.estimate.correction for half in halves)
    if one is not None and other is not None:
        yield from left_over_lines(between_halves(one, other), *(h.estimate for h in halves))


def wrx(estimator: str) -> Iterator[str]:
    drive = "wrx_sti"
    result = replayed(drive, estimator)
    yield describe(result)
    angles = result.estimate.angles
    if angles is None:
        yield f"  yaw: none (bar 3 deg: {verdict(False)})"
    else:
        yaw = math.degrees(angles[2])
        usable = "usable" if result.is_usable else "never usable in these 90 s"
        met = verdict(abs(yaw) <= 3.0)
        yield f"  yaw {yaw:+.2f} deg of an aligned sensor (bar 3: {met}), {usable}"
        yield from aligned(result.estimate)
    for text, correlation in wrx_signs():
        yield f"  {text}: correlation {correlation:+.2f} (bar > 0: {verdict(correlation > 0.0)})"


def wrx_signs() -> list[tuple[str, float]]:
    """Correlations that are positive where every sign is right."""
    samples = decoded("wrx_sti")
    t = np.arange(1.0, float(samples["speed"].t[-1]) - 1.0, GRID_S)
    speed, rate = on_grid(samples["speed"], t), on_grid(samples["yaw_rate"], t)
    accel = samples["accel"]
    forward, left = (on_grid(Series(accel.t, accel.values[:, i]), t) for i in range(2))
    steering = on_grid(samples["steering"], t)
    wheels = samples["wheel_speeds"]
    right_minus_left = wheels.values[:, [1, 3]].sum(axis=1) - wheels.values[:, [0, 2]].sum(axis=1)
    turning = on_grid(Series(wheels.t, right_minus_left), t)
    moving = speed > 3.0
    return [
        (what, float(np.corrcoef(a[moving], b[moving])[0, 1]))
        for what, a, b in (
            ("yaw rate with the wheels' difference", rate, turning),
            ("lateral acceleration with v r", left, speed * rate),
            ("longitudinal acceleration with dv/dt", forward, np.gradient(speed, GRID_S)),
            ("steering angle with yaw rate", steering, rate),
        )
    ]


def neu_circles(estimator: str) -> Iterator[str]:
    result = replayed("neu_circles", estimator)
    yield describe(result)
    yield f"  never a usable yaw (bar): {verdict(not result.is_usable)}"
    yield f"  yaw waits for: {result.summary['waiting_for'].get('yaw', 'nothing')}"


def vehsense(drive: str) -> Callable[[str], Iterator[str]]:
    def known(estimator: str) -> Iterator[str]:
        result = replayed(drive, estimator)
        yield describe(result)
        std = result.estimate.std
        tilt = math.inf if std is None else math.degrees(max(std[:2]))
        claims = result.summary["state"] == "fine" or tilt < 0.3
        yield f"  gravity creeps 2-6 deg: no fine state, tilt sd >= 0.3 deg: {verdict(not claims)}"

    return known


DRIVES: dict[str, Callable[[str], Iterator[str]]] = {
    "kingston_2008": kingston,
    "quat_orient_21": quat_orient,
    "css_canmod_164": css,
    "wrx_sti": wrx,
    "neu_circles": neu_circles,
    "vehsense_2017_10_23_2245": vehsense("vehsense_2017_10_23_2245"),
    "vehsense_2017_10_25_1829": vehsense("vehsense_2017_10_25_1829"),
}


# Helpers ---------------------------------------------------------------------------------------


def describe(result: Result) -> str:
    """State, angles with their standard deviations, first usable, what was rejected."""
    summary = result.summary
    parts = [summary["state"]]
    mount = summary["mount"]
    if mount["roll_deg"] is not None:
        for angle, axis in zip(("roll", "pitch", "yaw"), "xyz", strict=True):
            std = mount["std_deg"][axis]
            own = "" if std is None else f"+-{std:.2f}"
            parts.append(f"{angle} {mount[f'{angle}_deg']:+.2f}{own}")
    usable = summary["first_usable_s"]
    parts.append("never usable" if usable is None else f"usable after {usable:.0f} s")
    rejected = summary["frames"]["rejected"]
    if rejected:
        parts.append("rejected " + json.dumps(rejected))
    return ", ".join(parts)


def aligned(estimate: MountEstimate) -> Iterator[str]:
    """Cross-talk of forward and left, of a sensor that is level to a few degrees and aligned."""
    if estimate.correction is not None:
        found = left_over(estimate.correction, Response(), np.eye(3), np.eye(3))
        yield from left_over_lines(
            dict(zip(ENTRIES[:2], found[:2].tolist(), strict=True)), estimate
        )


def between_halves(one: Correction, other: Correction) -> dict[str, float]:
    """What the one leaves in samples of a unit that the other is right for."""
    W, V = (np.reshape(rows, (3, 3)) for rows in (other.force, other.rate))
    unit = Response(np.linalg.inv(W), np.linalg.inv(V), np.linalg.solve(W, other.force_offset))
    return dict(zip(ENTRIES, left_over(one, unit, np.eye(3), np.eye(3)).tolist(), strict=True))


def left_over_lines(left: Mapping[str, float], *estimates: MountEstimate) -> Iterator[str]:
    """What is left in a consumer's samples (`ENTRIES`), in deviations of all estimates together."""
    sent = [estimate.sent for estimate in estimates]
    known = [one for one in sent if one is not None]
    if len(known) < len(sent):
        return
    stds = dict(zip(ENTRIES, np.sqrt(sum(stated(one) ** 2 for one in known)), strict=True))
    parts = [f"{name} {v:+.2f} ({abs(v) / stds[name]:.1f} sd)" for name, v in left.items()]
    yield f"  left in what is sent: {', '.join(parts)}"


def sds_apart(between: NDArray[np.float64], halves: list[Result]) -> str:
    """How far apart two estimates are, in their own standard deviations, about each axis."""
    if any(half.estimate.covariance is None for half in halves):
        return ""
    both = sum(np.diag(half.estimate.covariance) for half in halves)
    sds = np.abs(between) / np.sqrt(both)
    return " (" + ", ".join(f"{a} {s:.1f} sd" for a, s in zip("xyz", sds, strict=True)) + ")"


def angle_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Degrees between two unit vectors."""
    cross = float(np.linalg.norm(np.cross(a, b)))
    return math.degrees(math.atan2(cross, float(a @ b)))


def in_halves(drive: str) -> list[Path]:
    """The drive's log as two files, cut at half its time."""
    FOLDER.mkdir(exist_ok=True)
    with gzip.open(DATA / drive / "drive.log.gz", "rb") as file:
        lines = file.read().splitlines(keepends=True)
    stamps = np.array([float(line[1 : line.index(b")")]) for line in lines])
    cut = int(np.searchsorted(stamps, 0.5 * (stamps[0] + stamps[-1])))
    paths = []
    for name, part in (("first", lines[:cut]), ("second", lines[cut:])):
        paths.append(FOLDER / f"{drive}-{name}.log")
        paths[-1].write_bytes(b"".join(part))
    return paths


def decoded(drive: str) -> dict[str, Series]:
    """All samples of a drive, as its configuration decodes them."""
    router = compile_router(open_config(MEASURED_DRIVES / f"{drive}.yaml"))
    base = TimeBase()
    parts: list[Routed] = []
    for chunk in LogReader([DATA / drive / "drive.log.gz"], router.matches):
        for segment in base.segments(chunk.t):
            parts.append(router.columns(segment.t, chunk.take(slice(segment.start, segment.stop))))
    channels = {channel for part in parts for channel in part.samples}
    return {
        channel: Series(
            np.concatenate([p.samples[channel].t for p in parts if channel in p.samples]),
            np.concatenate([p.samples[channel].values for p in parts if channel in p.samples]),
        )
        for channel in channels
    }


def on_grid(series: Series, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over 2 GRID_S around each time: what two sensors of different noise can share."""
    sums = np.concatenate([[0.0], np.cumsum(series.values)])
    low, high = (np.searchsorted(series.t, t + s) for s in (-GRID_S, GRID_S))
    means: NDArray[np.float64] = (sums[high] - sums[low]) / np.maximum(high - low, 1)
    return means


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--estimator", choices=ESTIMATORS, help="only this one")
    parser.add_argument("--only", choices=tuple(DRIVES), help="only this drive")
    options = parser.parse_args()
    asked = [drive for drive in DRIVES if options.only in (None, drive)]
    if not any(map(is_here, asked)):
        return nothing_measured(*asked)
    missed = 0
    for drive in asked:
        if not is_here(drive):
            print(f"{drive}: absent ({DATA / drive}), not measured")
            continue
        for estimator in [options.estimator] if options.estimator else ESTIMATORS:
            print(f"{drive}, {estimator}:")
            for line in DRIVES[drive](estimator):
                print(f"  {line}", flush=True)
                missed += "NOT MET" in line
    print(f"{missed} bars not met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
