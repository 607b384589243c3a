"""Measured drives with the shipped configurations: what must hold of each.

The figures themselves are printed by ``python -m benchmarks.real_drives``.
"""

from __future__ import annotations

import gzip
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucald.can.logs.log_reader import LogReader
from imucald.core.rotations import vector_from_rotation
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import MountEstimate
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine, open_config
from imucald.runtime.timebase import TimeBase

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent.parent
DATA = ROOT.parent / "shared" / "data"
CONFIGS = ROOT / "benchmarks" / "measured_drives"
ESTIMATORS = ("full", "published")
DRIVES = (
    "css_canmod_164", "kingston_2008", "neu_circles", "quat_orient_21",
    "vehsense_2017_10_23_2245", "vehsense_2017_10_25_1829", "wrx_sti",
)  # fmt: skip


def log_of(drive: str) -> Path:
    path = DATA / drive / "drive.log.gz"
    if not path.exists():
        pytest.skip(f"the measured drive {drive} is not here ({path})")
    return path


@cache
def replayed(drive: str, estimator: str, log: Path) -> tuple[dict[str, Any], MountEstimate]:
    loaded = open_config(CONFIGS / f"{drive}.yaml")
    calibration = replace(loaded.config.calibration, estimator=estimator)
    loaded.config = replace(loaded.config, calibration=calibration)
    engine = make_engine(loaded)
    result = Replay(engine, LogReader([log], engine.router.matches)).run()
    return result, engine.pipeline.estimator.estimate()


def of(drive: str, estimator: str) -> tuple[dict[str, Any], MountEstimate]:
    return replayed(drive, estimator, log_of(drive))


@pytest.mark.parametrize("drive", DRIVES)
def test_every_frame_decodes(drive):
    """No frame of a measured drive is damaged; a few samples of one sit at the sensor's end."""
    result, _ = of(drive, "published")
    rejected = result["frames"]["rejected"]
    assert set(rejected) <= {"saturated"}
    assert sum(rejected.values()) <= 3
    assert result["frames"]["used"] > 1000
    assert {"accel", "speed"} <= set(result["signals"])


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_kingston_forward_axis_is_that_of_the_ins(estimator):
    _, estimate = of("kingston_2008", estimator)
    truth = np.array([0.0039, 0.9998, 0.0155])
    truth /= np.linalg.norm(truth)
    forward = estimate.R_vehicle_from_sensor[0]
    assert math.degrees(math.acos(min(1.0, float(forward @ truth)))) < 1.0


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_circles_give_no_usable_yaw_and_say_what_is_waited_for(estimator):
    result, _ = of("neu_circles", estimator)
    assert result["first_usable_s"] is None
    if estimator == "published":
        assert "straight acceleration" in result["waiting_for"]["yaw"]


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_halves_of_one_drive_agree(estimator, tmp_path):
    lines = gzip.decompress(log_of("css_canmod_164").read_bytes()).splitlines(keepends=True)
    stamps = np.array([float(line[1 : line.index(b")")]) for line in lines])
    middle = int(np.searchsorted(stamps, 0.5 * (stamps[0] + stamps[-1])))
    rotations = []
    for name, part in (("first", lines[:middle]), ("second", lines[middle:])):
        path = tmp_path / f"{name}.log"
        path.write_bytes(b"".join(part))
        _, estimate = replayed("css_canmod_164", estimator, path)
        rotations.append(estimate.R_vehicle_from_sensor)
    apart = vector_from_rotation(rotations[0] @ rotations[1].T)
    assert math.degrees(float(np.linalg.norm(apart))) < 3.0


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_aligned_sensor_is_recognised(estimator):
    _, estimate = of("wrx_sti", estimator)
    assert abs(math.degrees(estimate.angles[2])) < 3.0


@pytest.mark.parametrize("drive", [d for d in DRIVES if d.startswith("vehsense")])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_loosely_held_phone_is_never_called_fine(drive, estimator):
    """Gravity creeps by 2 to 6 degrees within these drives."""
    result, estimate = of(drive, estimator)
    assert result["state"] != "fine"
    assert estimate.std is None or math.degrees(max(estimate.std[:2])) > 0.3


def test_signs_of_the_stability_control_signals():
    """The outer wheels are faster; v r and dv/dt are felt by the accelerometer."""
    log = log_of("wrx_sti")
    router = compile_router(open_config(CONFIGS / "wrx_sti.yaml"))
    base, parts = TimeBase(), []
    for chunk in LogReader([log], router.matches):
        for segment in base.segments(chunk.t):
            parts.append(router.columns(segment.t, chunk.take(slice(segment.start, segment.stop))))
    t = np.arange(1.0, 88.0, 0.2)

    def smooth(channel: str, column: int | None = None) -> np.ndarray:
        times = np.concatenate([p.samples[channel].t for p in parts if channel in p.samples])
        values = np.concatenate([p.samples[channel].values for p in parts if channel in p.samples])
        values = values if column is None else values[:, column]
        sums = np.concatenate([[0.0], np.cumsum(values)])
        low, high = np.searchsorted(times, t - 0.2), np.searchsorted(times, t + 0.2)
        return (sums[high] - sums[low]) / (high - low)

    speed, rate = smooth("speed"), smooth("yaw_rate")
    turning = (
        smooth("wheel_speeds", 1) + smooth("wheel_speeds", 3)
        - smooth("wheel_speeds", 0) - smooth("wheel_speeds", 2)
    )  # fmt: skip
    moving = speed > 3.0
    for a, b, least in (
        (rate, turning, 0.8),
        (smooth("steering"), rate, 0.8),
        (smooth("accel", 1), speed * rate, 0.7),
        (smooth("accel", 0), np.gradient(speed, 0.2), 0.9),
    ):
        assert np.corrcoef(a[moving], b[moving])[0, 1] > least
